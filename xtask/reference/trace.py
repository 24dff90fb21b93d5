"""Thinning and graph by scikit-image and skan on masks that xtask wrote: trace.py MASK.npy SKELETON.npy ...

Prints a list of JSON objects, one a pair of files: agreement of the skeletons, and the counts of the graph of each.
"""

import json
import sys

import numpy as np
from scipy.ndimage import convolve, distance_transform_edt, label
from skan import Skeleton, summarize
from skimage.morphology import skeletonize

EIGHT = np.ones((3, 3), dtype=int)


def within_one(of, others):
    """Share of the pixels of `of` that lie within one pixel (8 neighbours) of `others`."""
    distance = distance_transform_edt(~others)
    return float((distance[of] < 1.5).mean()) if of.any() else 1.0


def graph(skeleton):
    neighbours = convolve(skeleton.astype(int), EIGHT, mode="constant") - 1
    junctions = label(skeleton & (neighbours >= 3), EIGHT)[1]
    framed = np.pad(~skeleton, 1, constant_values=True)
    table = summarize(Skeleton(skeleton), separator="-")
    # Branches inside a clump of junction pixels are steps of a pixel or so, not branches.
    branches = table[table["branch-distance"] > 1.5]
    return {
        "pixels": int(skeleton.sum()),
        "components": int(label(skeleton, EIGHT)[1]),
        "holes": int(label(framed)[1]) - 1,
        "junctions": int(junctions),
        "branches": int(len(branches)),
        "length": float(table["branch-distance"].sum()),
    }


results = []
for mask_path, ours_path in zip(sys.argv[1::2], sys.argv[2::2]):
    mask = np.load(mask_path) > 0.5
    ours = np.load(ours_path) > 0.5
    theirs = skeletonize(mask)
    results.append(
        {
            "ours_near_theirs": within_one(ours, theirs),
            "theirs_near_ours": within_one(theirs, ours),
            "mask_holes": int(label(np.pad(~mask, 1, constant_values=True))[1]) - 1,
            "mask_components": int(label(mask, EIGHT)[1]),
            "theirs": graph(theirs),
            "ours": graph(ours),
        }
    )
print(json.dumps(results))
