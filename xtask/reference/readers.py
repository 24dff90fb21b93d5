"""Writes images in many types with tifffile and mrcfile, and says what they read back.

    readers.py make FOLDER             writes the files, prints their names as JSON
    readers.py compare FOLDER          compares FOLDER/NAME.npy (pixels as Tiltline read them, float32) with what
                                       tifffile or mrcfile reads from FOLDER/NAME: largest difference and pixel size
"""

import json
import pathlib
import sys

import mrcfile
import numpy as np
import tifffile

ROWS, COLUMNS = 97, 131


def image(kind, seed):
    """Noise over the range that float32 holds exactly."""
    random = np.random.default_rng(seed)
    if np.dtype(kind).kind == "f":
        return random.normal(scale=100, size=(ROWS, COLUMNS)).astype(kind)
    limits = np.iinfo(kind)
    low, high = max(limits.min, -(2**24)), min(limits.max, 2**24)
    return random.integers(low, high, size=(ROWS, COLUMNS), endpoint=True).astype(kind)


def make(folder):
    names = []

    def add(name, write, *args, **options):
        write(folder / name, *args, **options)
        names.append(name)

    for seed, kind in enumerate(["u1", "i1", "u2", "i2", "u4", "i4", "f2", "f4", "f8"]):
        for order in "<>":
            word = "le" if order == "<" else "be"
            add(f"{kind}_{word}.tif", tifffile.imwrite, image(kind, seed), byteorder=order, metadata=None)
        add(f"{kind}_tiles.tif", tifffile.imwrite, image(kind, seed), tile=(32, 48), metadata=None)
        add(f"{kind}_zlib.tif", tifffile.imwrite, image(kind, seed), compression="zlib", rowsperstrip=10, metadata=None)
    options = {"imagej": True, "resolution": (400, 400), "metadata": {"unit": "um"}}
    add("imagej.tif", tifffile.imwrite, image("u2", 20), **options)
    for seed, kind in enumerate(["i1", "i2", "u2", "f2", "f4"]):
        add(f"{kind}.mrc", write_mrc, image(kind, seed))
    return names


def write_mrc(path, data):
    with mrcfile.new(path, overwrite=True) as file:
        file.set_data(data)
        file.voxel_size = 25


def compare(folder):
    results = {}
    for path in sorted([*folder.glob("*.tif"), *folder.glob("*.mrc")]):
        ours = np.load(folder / f"{path.name}.npy").astype("f8")
        if path.suffix == ".tif":
            theirs = tifffile.imread(path)
        else:
            with mrcfile.open(path) as file:
                theirs = file.data[::-1]
        same_shape = ours.shape == theirs.shape
        difference = np.abs(ours - theirs.astype("f4").astype("f8")).max() if same_shape else float("inf")
        results[path.name] = {"type": str(theirs.dtype), "difference": float(difference)}
    return results


if __name__ == "__main__":
    task, folder = sys.argv[1], pathlib.Path(sys.argv[2])
    print(json.dumps(make(folder) if task == "make" else compare(folder)))
