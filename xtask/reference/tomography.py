"""Tomography by scikit-image, the ASTRA toolbox, NumPy and SciPy, on what xtask wrote; prints JSON.

tomography.py phantom FOLDER        differences of our volumes from theirs and from the phantom
tomography.py speed KIND WIDTH VIEWS    seconds of one iteration of one row of voxels and one view, by threads of this machine
"""

import json
import os
import sys
import time
from concurrent.futures import ThreadPoolExecutor

import astra
import mrcfile
import numpy as np
from skimage.transform import iradon, iradon_sart

THREADS = len(os.sched_getaffinity(0))
LANES = 32


def astra_geometry(tilts_deg, width, depth):
    # ASTRA has y up and s = x cos t + y sin t; our z counts down the rows: t = -a.
    angles = -np.deg2rad(tilts_deg)
    return astra.create_vol_geom(depth, width), astra.create_proj_geom("parallel", 1.0, width, angles)


class AstraSirt:
    """SIRT of one slice, on one thread."""

    def __init__(self, sinogram, tilts_deg, depth, kernel, non_negative):
        volume, views = astra_geometry(tilts_deg, sinogram.shape[1], depth)
        self.result = astra.data2d.create("-vol", volume, 0)
        config = astra.astra_dict("SIRT")
        config["ProjectorId"] = astra.create_projector(kernel, views, volume)
        config["ProjectionDataId"] = astra.data2d.create("-sino", views, sinogram)
        config["ReconstructionDataId"] = self.result
        if non_negative:
            config["option"] = {"MinConstraint": 0.0}
        self.algorithm = astra.algorithm.create(config)

    def run(self, iterations):
        astra.algorithm.run(self.algorithm, iterations)
        return astra.data2d.get(self.result)


def overlap_matrix(tilts_deg, width, depth):
    """The projector by its definition: the share of each voxel's shadow that lies over a bin."""
    x = np.arange(width) - (width - 1) / 2
    z = np.arange(depth) - (depth - 1) / 2
    edges = np.arange(width + 1) - width / 2
    rows = []
    for tilt in np.deg2rad(tilts_deg):
        m = max(abs(np.cos(tilt)), abs(np.sin(tilt)))
        centre = (x[None, :] * np.cos(tilt) + z[:, None] * np.sin(tilt)).ravel()
        low = np.maximum(centre - m / 2, edges[:-1, None])
        high = np.minimum(centre + m / 2, edges[1:, None])
        rows.append(np.clip(high - low, 0, None) / m)
    return np.concatenate(rows)


def numpy_sirt(matrix, views, iterations):
    inverse = lambda sums: np.where(sums > 1e-4, 1 / np.maximum(sums, 1e-30), 0)
    rows, columns = inverse(matrix.sum(1)), inverse(matrix.sum(0))
    volume = np.zeros(matrix.shape[1])
    for _ in range(iterations):
        volume = np.maximum(volume + columns * (matrix.T @ (rows * (views - matrix @ volume))), 0)
    return volume


def relative(a, b, inside=None):
    inside = np.ones(a.shape, bool) if inside is None else inside
    return float(np.sqrt(((a - b)[inside] ** 2).mean() / (b[inside] ** 2).mean()))


def phantom(folder):
    load = lambda name: np.load(os.path.join(folder, name + ".npy"))
    results = {}
    truth = load("truth")
    side = truth.shape[0]
    at = np.arange(side) - (side - 1) / 2
    circle = np.hypot(at[:, None], at[None, :]) < side / 2 - 2
    for name in ["half-turn", "wedge"]:
        sinogram, tilts = load(name + "-views"), load(name + "-tilts")[0]
        entry = {}
        if name == "half-turn":
            for window in ["ramp", "hamming"]:
                theirs = iradon(sinogram.T.astype(np.float64), -tilts, filter_name=window, circle=True)
                ours = load(f"{name}-{window}")
                entry[window] = {
                    "difference": relative(ours, theirs, circle),
                    "ours_from_truth": relative(ours, truth, circle),
                    "theirs_from_truth": relative(theirs, truth, circle),
                }
        ours = load(name + "-sirt")
        for kernel in ["linear", "strip"]:
            theirs = AstraSirt(sinogram, tilts, side, kernel, True).run(60)
            entry["sirt, ASTRA " + kernel] = {
                "difference": relative(ours, theirs, circle),
                "ours_from_truth": relative(ours, truth, circle),
                "theirs_from_truth": relative(theirs, truth, circle),
            }
        results[name] = entry
    views, tilts, ours = load("small-views"), load("small-tilts")[0], load("small-sirt")
    matrix = overlap_matrix(tilts, views.shape[1], ours.shape[0])
    results["numpy"] = {
        "projector": float(np.abs(load("small-projected").ravel() - matrix @ load("small-volume").ravel()).max()),
        "sirt": float(np.abs(ours.ravel() - numpy_sirt(matrix, views.ravel().astype(float), 20)).max()),
        "scale": float(ours.max()),
    }
    path = os.path.join(folder, "volume.mrc")
    with mrcfile.open(path) as file:
        shape = file.data.shape
        expected = load("volume").reshape(shape)
        results["mrc"] = {
            "valid": bool(mrcfile.validate(path, print_file=sys.stderr)),
            "volume": bool(file.is_volume()),
            "voxel_nm": float(file.voxel_size.z) / 10,
            "same": bool((file.data[::-1, ::-1] == expected).all()),
        }
    return results


def timed(work):
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


def speed(kind, width, views):
    tilts = np.linspace(-76, 76, views)
    random = np.random.default_rng(1)
    iterations = 2
    if kind.startswith("astra"):
        kernel = kind.split("-")[1]
        slices = [AstraSirt(random.random((views, width), np.float32), tilts, width, kernel, True) for _ in range(2 * THREADS)]
        with ThreadPoolExecutor(THREADS) as pool:
            list(pool.map(lambda each: each.run(1), slices))
            seconds = timed(lambda: list(pool.map(lambda each: each.run(iterations), slices)))
        work = len(slices) * iterations
    elif kind == "scipy":
        volume, geometry = astra_geometry(tilts, width, width)
        matrix = astra.matrix.get(astra.projector.matrix(astra.create_projector("linear", geometry, volume))).astype(np.float32)
        forward, back = matrix.tocsr(), matrix.T.tocsr()
        inverse = lambda sums: np.where(sums > 1e-4, 1 / np.maximum(sums, 1e-30), 0).astype(np.float32)[:, None]
        rows, columns = inverse(np.asarray(forward.sum(1)).ravel()), inverse(np.asarray(back.sum(1)).ravel())
        measured = [random.random((views * width, LANES), np.float32) for _ in range(THREADS)]

        def iterate(own):
            x = np.zeros((width * width, LANES), np.float32)
            for _ in range(iterations):
                x = np.maximum(x + columns * (back @ (rows * (own - forward @ x))), 0)

        with ThreadPoolExecutor(THREADS) as pool:
            list(pool.map(iterate, measured))
            seconds = timed(lambda: list(pool.map(iterate, measured)))
        work = THREADS * LANES * iterations
    else:
        sinograms = [random.random((width, views)).astype(np.float32) for _ in range(THREADS)]
        with ThreadPoolExecutor(THREADS) as pool:
            seconds = timed(lambda: list(pool.map(lambda own: iradon_sart(own, theta=-tilts), sinograms)))
        work = THREADS
    return {"seconds": seconds / (work * width * width * views)}


if sys.argv[1] == "phantom":
    print(json.dumps(phantom(sys.argv[2])))
else:
    print(json.dumps(speed(sys.argv[2], int(sys.argv[3]), int(sys.argv[4]))))
