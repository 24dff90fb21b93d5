"""OpenCV's StereoSGBM at given pixels of rectified pairs.

usage: sgbm.py FOLDER COUNT; reads left-K.npy, right-K.npy (float32, 0..1) and points-K.npy (x, y per row) for K < COUNT;
prints {"version": ..., "disparity": [[...], ...]} with d = x_right - x_left (OpenCV's is x_left - x_right) or null.
"""

import json
import sys
from pathlib import Path

import cv2
import numpy as np

BLOCK, LOW, COUNT = 15, -32, 64


def to_bytes(image):
    return (np.clip(np.nan_to_num(image), 0, 1) * 255).round().astype(np.uint8)


folder, pairs = Path(sys.argv[1]), int(sys.argv[2])
# P1 and P2 as OpenCV's documentation recommends for one channel; the other values are its defaults.
matcher = cv2.StereoSGBM_create(
    minDisparity=LOW, numDisparities=COUNT, blockSize=BLOCK, P1=8 * BLOCK * BLOCK, P2=32 * BLOCK * BLOCK
)
result = []
for k in range(pairs):
    left, right = (to_bytes(np.load(folder / f"{name}-{k}.npy")) for name in ("left", "right"))
    # Without a border the first 32 and last 32 columns cannot be searched.
    pad = [cv2.copyMakeBorder(image, 0, 0, COUNT, COUNT, cv2.BORDER_REPLICATE) for image in (left, right)]
    raw = matcher.compute(*pad)[:, COUNT:-COUNT]
    points = np.load(folder / f"points-{k}.npy").round().astype(int)
    at = raw[points[:, 1], points[:, 0]]
    result.append([None if value < LOW * 16 else -float(value) / 16 for value in at])
print(json.dumps({"version": cv2.__version__, "disparity": result}))
