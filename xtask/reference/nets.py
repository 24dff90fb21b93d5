"""Detector, matcher and losses in PyTorch: the same definitions as crates/tiltline-nets, written from the papers they cite.

parity OUT          writes weights, inputs, outputs, losses and gradients of small networks to OUT (safetensors)
speed KIND WORK N   prints the seconds of N runs of the default networks as JSON; KIND detector|matcher, WORK forward|step
"""

import json
import resource
import struct
import sys
import time

import numpy as np
import torch
import torch.nn.functional as F

EPS = 1e-5
MOMENTUM = 0.02


def conv_norm(p, name, x, conv, relu=True, train=True):
    y = conv(x, p[name + ".conv.weight"], None)
    gamma, beta = p[name + ".norm.gamma"], p[name + ".norm.beta"]
    mean, var = p.get(name + ".norm.running_mean"), p.get(name + ".norm.running_var")
    y = F.batch_norm(y, mean, var, gamma, beta, training=train, momentum=MOMENTUM, eps=EPS)
    return F.relu(y) if relu else y


def same(stride=1):
    def conv(x, w, b):
        f = F.conv2d if w.dim() == 4 else F.conv3d
        return f(x, w, b, stride=stride, padding=1)
    return conv


def double(x, w, b):
    if w.dim() == 4:
        return F.conv_transpose2d(x, w, b, stride=2)
    return F.conv_transpose3d(x, w, b, stride=2, padding=1, output_padding=1)


def detector(p, c, x, train=True):
    def level(name, x):
        x = conv_norm(p, name + ".first", x, same(), train=train)
        return conv_norm(p, name + ".second", x, same(), train=train)
    kept = []
    for i in range(c["depth"] + 1):
        if i > 0:
            x = F.max_pool2d(x, 2)
        x = level(f"down.{i}", x)
        kept.append(x)
    kept.pop()
    for i in range(c["depth"]):
        up = double(x, p[f"up.{i}.weight"], p[f"up.{i}.bias"])
        x = level(f"joined.{i}", torch.cat([kept.pop(), up], 1))
    return F.conv2d(x, p["head.weight"], p["head.bias"]), x


def shifted(right, c):
    reach = c["levels"] // 2
    padded = F.pad(right, (reach, reach))
    return torch.stack([padded[..., i:i + right.shape[-1]] for i in range(c["levels"])], 2)


def matcher(p, c, left, right, train=True):
    n = left.shape[0]
    x = torch.cat([left, right])
    strides = [2, 1, 2 if c["downscale"] == 4 else 1]
    for i, s in enumerate(strides):
        x = conv_norm(p, f"encoder.layers.{i}", x, same(s), train=train)
    y = conv_norm(p, "encoder.residual.0", x, same(), train=train)
    y = conv_norm(p, "encoder.residual.1", y, same(), relu=False, train=train)
    f = same()(F.relu(x + y), p["encoder.last.weight"], p["encoder.last.bias"])
    parts = []
    if c["concatenated"]:
        g = F.conv2d(f, p["narrow.weight"], p["narrow.bias"]) if "narrow.weight" in p else f
        wide = g[:n].unsqueeze(2).expand(-1, -1, c["levels"], -1, -1)
        parts.append(torch.cat([wide, shifted(g[n:], c)], 1))
    if c["groups"]:
        product = f[:n].unsqueeze(2) * shifted(f[n:], c)
        shape = (n, c["groups"], c["features"] // c["groups"]) + product.shape[2:]
        parts.append(product.reshape(shape).mean(2))
    x = torch.cat(parts, 1)
    for i in range(2):
        x = conv_norm(p, f"entry.{i}", x, same(), train=train)
    costs = []
    for h in range(c["hourglasses"]):
        name = f"hourglasses.{h}"
        half = conv_norm(p, name + ".down.0", x, same(2), train=train)
        half = conv_norm(p, name + ".same.0", half, same(), train=train)
        quarter = conv_norm(p, name + ".down.1", half, same(2), train=train)
        quarter = conv_norm(p, name + ".same.1", quarter, same(), train=train)
        half = F.relu(conv_norm(p, name + ".up.0", quarter, double, relu=False, train=train) + half)
        x = F.relu(conv_norm(p, name + ".up.1", half, double, relu=False, train=train) + x)
        own = same()(conv_norm(p, f"heads.{h}", x, same(), train=train), p[f"costs.{h}.weight"], None)[:, 0]
        costs.append(own + costs[-1] if costs else own)
    return costs


def levels(c):
    first = -(c["levels"] // 2) * c["downscale"]
    return torch.arange(first, first + (c["levels"] - 1) * c["downscale"] + 1, dtype=torch.float32)


def at_levels(cost, c):
    """[N, d, h, w] to [N, H, W, D]: linear in the image, Catmull-Rom between levels."""
    x = F.interpolate(cost, scale_factor=c["downscale"], mode="bilinear", align_corners=False).permute(0, 2, 3, 1)
    d, f = c["levels"], c["downscale"]
    to = torch.arange(f * (d - 1) + 1)
    base, t = to // f, (to % f).float() / f
    def value(offset):
        return x[..., (base + offset).clamp(0, d - 1)]
    a, b, e, g = value(-1), value(0), value(1), value(2)
    return b + 0.5 * t * (e - a + t * (2 * a - 5 * b + 4 * e - g + t * (3 * (b - e) + g - a)))


def losses(c, costs, logits, batch):
    """Those of the last cost volume, and of the detector on the left images."""
    truth, lines = batch["disparity"], batch["left_lines"]
    known = ~torch.isnan(truth)
    fine = at_levels(costs[-1], c)
    probability = torch.softmax(-fine, -1)
    level = levels(c)
    disparity = (probability * level).sum(-1)
    d, t = disparity[known], truth[known]
    out = {"disparity": F.smooth_l1_loss(d, t)}
    out["variance"] = (probability[known] * (level - t[:, None]) ** 2).sum(-1).mean()
    below = (t - level[0]).floor().long().clamp(0, len(level) - 2)
    share = (t - level[0]) - below
    log = torch.log_softmax(-fine[known], -1)
    rows = torch.arange(len(t))
    out["entropy"] = -((1 - share) * log[rows, below] + share * log[rows, below + 1]).mean()
    n, h, w = truth.shape
    right = torch.sigmoid(logits[n:, 0])
    x = torch.arange(w) + disparity
    grid = torch.stack([2 * x / (w - 1) - 1, (2 * torch.arange(h) / (h - 1) - 1)[None, :, None].expand(n, h, w)], -1)
    # Zero outside, as a whole pixel and not by interpolation towards zero.
    padded = F.grid_sample(right[:, None], grid, padding_mode="zeros", align_corners=True)[:, 0]
    mask = ~torch.isnan(lines)
    p = padded.clamp(1e-6, 1 - 1e-6)[mask]
    out["warp"] = F.binary_cross_entropy(p, lines[mask])
    out["detection"] = F.binary_cross_entropy_with_logits(logits[:n, 0][mask], lines[mask], pos_weight=torch.tensor(3.0))
    # With a weight on lines PyTorch too divides by the number of pixels.
    return out


def weights(shapes, generator):
    p = {}
    for name, shape in shapes.items():
        if name.endswith("running_mean"):
            p[name] = torch.zeros(shape)
        elif name.endswith("running_var"):
            p[name] = torch.ones(shape)
        elif name.endswith("gamma"):
            p[name] = 1 + 0.2 * torch.randn(shape, generator=generator)
        elif len(shape) == 1:
            p[name] = 0.1 * torch.randn(shape, generator=generator)
        else:
            fan = int(np.prod(shape[1:]))
            p[name] = torch.randn(shape, generator=generator) * (2 / fan) ** 0.5
    return p


def norm_shapes(name, weight, channels):
    return {name + ".conv.weight": weight, **{f"{name}.norm.{k}": (channels,) for k in ("gamma", "beta", "running_mean", "running_var")}}


def detector_shapes(c):
    b, s = c["channels"], {}
    def level(name, a, o):
        s.update(norm_shapes(name + ".first", (o, a, 3, 3), o))
        s.update(norm_shapes(name + ".second", (o, o, 3, 3), o))
    for i in range(c["depth"] + 1):
        level(f"down.{i}", 1 if i == 0 else b << (i - 1), b << i)
    for k, i in enumerate(reversed(range(c["depth"]))):
        s[f"up.{k}.weight"], s[f"up.{k}.bias"] = (b << (i + 1), b << i, 2, 2), (b << i,)
        level(f"joined.{k}", 2 * (b << i), b << i)
    s["head.weight"], s["head.bias"] = (1, b, 1, 1), (1,)
    return s


def matcher_shapes(c):
    f, h, ch, s = c["features"], -(-c["features"] // 2), c["channels"], {}
    for i, (a, o) in enumerate([(c["input_channels"], h), (h, h), (h, f)]):
        s.update(norm_shapes(f"encoder.layers.{i}", (o, a, 3, 3), o))
    for i in range(2):
        s.update(norm_shapes(f"encoder.residual.{i}", (f, f, 3, 3), f))
    s["encoder.last.weight"], s["encoder.last.bias"] = (f, f, 3, 3), (f,)
    if c["concatenated"] and c["concatenated"] != f:
        s["narrow.weight"], s["narrow.bias"] = (c["concatenated"], f, 1, 1), (c["concatenated"],)
    for i, a in enumerate([2 * c["concatenated"] + c["groups"], ch]):
        s.update(norm_shapes(f"entry.{i}", (ch, a, 3, 3, 3), ch))
    for k in range(c["hourglasses"]):
        g = f"hourglasses.{k}"
        s.update(norm_shapes(g + ".down.0", (2 * ch, ch, 3, 3, 3), 2 * ch))
        s.update(norm_shapes(g + ".down.1", (2 * ch, 2 * ch, 3, 3, 3), 2 * ch))
        for i in range(2):
            s.update(norm_shapes(g + f".same.{i}", (2 * ch, 2 * ch, 3, 3, 3), 2 * ch))
        s.update(norm_shapes(g + ".up.0", (2 * ch, 2 * ch, 3, 3, 3), 2 * ch))
        s.update(norm_shapes(g + ".up.1", (2 * ch, ch, 3, 3, 3), ch))
        s.update(norm_shapes(f"heads.{k}", (ch, ch, 3, 3, 3), ch))
        s[f"costs.{k}.weight"] = (1, ch, 3, 3, 3)
    return s


def save(path, tensors, metadata):
    header, data = {"__metadata__": metadata}, b""
    for name, value in sorted(tensors.items()):
        raw = np.ascontiguousarray(value.detach().numpy().astype("<f4")).tobytes()
        header[name] = {"dtype": "F32", "shape": list(value.shape), "data_offsets": [len(data), len(data) + len(raw)]}
        data += raw
    text = json.dumps(header).encode()
    text += b" " * (-len(text) % 8)
    with open(path, "wb") as file:
        file.write(struct.pack("<Q", len(text)) + text + data)


DETECTOR = {"channels": 3, "depth": 2}
MATCHER = {"input_channels": 2, "features": 6, "downscale": 4, "concatenated": 3, "groups": 2, "channels": 4, "hourglasses": 2, "levels": 8}


def parity(out):
    g = torch.Generator().manual_seed(3)
    d, m = weights(detector_shapes(DETECTOR), g), weights(matcher_shapes(MATCHER), g)
    n, h, w = 2, 32, 48
    left, right = (torch.randn((n, 1, h, w), generator=g) for _ in range(2))
    lines = (torch.rand((n, h, w), generator=g) < 0.2).float()
    lines[torch.rand((n, h, w), generator=g) < 0.1] = float("nan")
    truth = torch.full((n, h, w), float("nan"))
    labelled = torch.rand((n, h, w), generator=g) < 0.15
    truth[labelled] = (torch.rand((int(labelled.sum()),), generator=g) - 0.55) * 24
    batch = {"disparity": truth, "left_lines": lines}
    tensors = {"input.left": left, "input.right": right, "input.left_lines": lines, "input.disparity": truth}
    tensors.update({f"detector.{k}": v.clone() for k, v in d.items()})
    tensors.update({f"matcher.{k}": v.clone() for k, v in m.items()})
    for p in (d, m):
        for k, v in p.items():
            if "running" not in k:
                v.requires_grad_()
    logits, features = detector(d, DETECTOR, torch.cat([left, right]))
    inputs = torch.cat([torch.cat([left, right]), torch.sigmoid(logits)], 1)
    costs = matcher(m, MATCHER, inputs[:n], inputs[n:])
    tensors.update({"output.logits": logits, "output.features": features})
    tensors.update({f"output.cost.{i}": c for i, c in enumerate(costs)})
    terms = losses(MATCHER, costs, logits, batch)
    for name, value in terms.items():
        tensors[f"loss.{name}"] = value.reshape(1)
    sum(terms.values()).backward()
    for prefix, p in (("detector", d), ("matcher", m)):
        for k, v in p.items():
            if v.requires_grad:
                tensors[f"gradient.{prefix}.{k}"] = v.grad
            else:
                tensors[f"after.{prefix}.{k}"] = v
    save(out, tensors, {"torch": torch.__version__, "detector": json.dumps(DETECTOR), "matcher": json.dumps(MATCHER)})


def speed(kind, work, count):
    g = torch.Generator().manual_seed(1)
    train = work == "step"
    if kind == "detector":
        c = {"channels": 12, "depth": 4}
        p = weights(detector_shapes(c), g)
        x = torch.randn((4, 1, 224, 224) if train else (1, 1, 512, 512), generator=g)
        run = lambda: detector(p, c, x, train)[0]
    else:
        c = dict(input_channels=2, features=32, downscale=4, concatenated=8, groups=8, channels=16, hourglasses=2, levels=16)
        p = weights(matcher_shapes(c), g)
        x = [torch.randn((2, 2, 256, 256) if train else (1, 2, 512, 512), generator=g) for _ in range(2)]
        run = lambda: matcher(p, c, *x, train)[-1]
    learned = [v for k, v in p.items() if "running" not in k]
    for v in learned:
        v.requires_grad_(train)
    optimiser = torch.optim.Adam(learned, lr=1e-4) if train else None
    def once():
        if not train:
            with torch.no_grad():
                return run()
        optimiser.zero_grad()
        run().square().mean().backward()
        optimiser.step()
    once()
    seconds = []
    for _ in range(count):
        start = time.perf_counter()
        once()
        seconds.append(time.perf_counter() - start)
    print(json.dumps({"seconds": seconds, "peak_mib": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024}))


if __name__ == "__main__":
    if sys.argv[1] == "parity":
        parity(sys.argv[2])
    else:
        speed(sys.argv[2], sys.argv[3], int(sys.argv[4]))
