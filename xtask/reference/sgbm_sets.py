"""OpenCV's StereoSGBM on fixed sets, with the rectification known.

usage: sgbm_sets.py SET...; each is the folder of a data set (pairs with truth.json). Prints, for each set and block size,
{"set", "block", "coverage", "epe", "bad": [bad-1, bad-3, bad-5]}; every true left point that is visible in both views counts the
length of line it stands for, errors are along the row in px of the left image, and a point without a value is bad: the paper's protocol
(docs/truth.md), but for points whose row the right line does not meet near by, which are left out here. Series are left out.
"""

import json
import os
import sys
from pathlib import Path

os.environ["OPENCV_LOG_LEVEL"] = "ERROR"  # it warns of TIFF tags it does not know

import cv2  # noqa: E402
import numpy as np  # noqa: E402

BLOCKS = (5, 9, 15, 21)
LOW, COUNT = -64, 128


def rectified(item, view, centre):
    """The image on the grid of the specimen's projection (px of the left image), and the map of points onto it."""
    image = cv2.imread(str(item / view["name"]), cv2.IMREAD_UNCHANGED).astype(np.float32)
    low, high = np.percentile(image, [0.5, 99.5])
    image = np.clip((image - low) / max(high - low, 1e-12), 0, 1)
    place, px = view["input_from_projection"], view["left_scale"]
    angle, ratio = np.radians(place["axis_deg"]), px / place["scale_px"]
    turn = ratio * np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    shift = np.array(centre) - turn @ np.array(place["origin_px"])
    matrix = np.column_stack([turn, shift])
    size = (view["width"], view["height"])
    image = cv2.warpAffine(image, matrix, size, flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
    return (np.clip(image, 0, 1) * 255).round().astype(np.uint8), lambda points: points @ turn.T + shift


def true_points(truth, maps):
    """Left points, true disparities and lengths of what is visible in both views."""
    points, disparities, lengths = [], [], []
    views = [{curve["label"]: curve for curve in view["curves"]} for view in truth["views"]]
    for label, left in views[0].items():
        if label not in views[1]:
            continue
        right = views[1][label]
        a, b = maps[0](np.array(left["contrast"])), maps[1](np.array(right["contrast"]))
        seen = np.array(left["visible"]) & np.array(right["visible"])
        step = np.linalg.norm(np.diff(a, axis=0), axis=1)
        weight = np.zeros(len(a))
        weight[:-1] += step / 2
        weight[1:] += step / 2
        for index in np.flatnonzero(seen):
            # Where the right contrast meets the row of the left one, within a few points of its own index.
            near = np.arange(max(index - 12, 0), min(index + 13, len(b)))
            rows = b[near, 1] - a[index, 1]
            crossing = np.flatnonzero(np.sign(rows[:-1]) * np.sign(rows[1:]) <= 0)
            if len(crossing) == 0:
                continue
            k = crossing[np.argmin(np.abs(near[crossing] - index))]
            share = rows[k] / (rows[k] - rows[k + 1]) if rows[k] != rows[k + 1] else 0.0
            x = b[near[k], 0] * (1 - share) + b[near[k + 1], 0] * share
            points.append(a[index])
            disparities.append(x - a[index, 0])
            lengths.append(weight[index])
    return np.array(points).reshape(-1, 2), np.array(disparities), np.array(lengths)


def main():
    cv2.setNumThreads(2)
    scores = []
    for folder in map(Path, sys.argv[1:]):
        sums = {block: np.zeros(6) for block in BLOCKS}
        for file in sorted(folder.glob("*/truth.json")):
            truth = json.loads(file.read_text())
            if len(truth["views"]) != 2:
                continue
            left_scale = truth["views"][0]["input_from_projection"]["scale_px"]
            centre = truth["views"][0]["input_from_projection"]["origin_px"]
            for view in truth["views"]:
                view["left_scale"] = left_scale
            pair = [rectified(file.parent, view, centre) for view in truth["views"]]
            points, disparities, lengths = true_points(truth, [pair[0][1], pair[1][1]])
            height, width = pair[0][0].shape
            at = points.round().astype(int)
            inside = (at >= 0).all(axis=1) & (at[:, 0] < width) & (at[:, 1] < height)
            at, disparities, lengths = at[inside], disparities[inside], lengths[inside]
            padded = [cv2.copyMakeBorder(image, 0, 0, COUNT, COUNT, cv2.BORDER_REPLICATE) for image, _ in pair]
            for block in BLOCKS:
                # P1 and P2 as OpenCV's documentation recommends; speckles taken out as in its samples.
                matcher = cv2.StereoSGBM_create(
                    minDisparity=LOW, numDisparities=COUNT, blockSize=block, P1=8 * block**2, P2=32 * block**2,
                    disp12MaxDiff=1, uniquenessRatio=10, speckleWindowSize=100, speckleRange=2,
                )
                raw = matcher.compute(*padded)[:, COUNT:-COUNT][at[:, 1], at[:, 0]]
                known = raw >= LOW * 16
                error = np.abs(-raw / 16 - disparities)
                bad = [((error > limit) | ~known) @ lengths for limit in (1, 3, 5)]
                sums[block] += [lengths.sum(), known @ lengths, (error * known) @ lengths, *bad]
        for block, (total, found, error, *bad) in sums.items():
            if total == 0:
                continue
            scores.append({
                "set": folder.parent.name, "block": block, "coverage": found / total, "epe": error / found if found else None,
                "bad": [100 * value / total for value in bad],
            })
    print(json.dumps({"version": cv2.__version__, "scores": scores}))


main()
