"""OpenCV's SIFT: sift.py LEFT.npy RIGHT.npy MAX REACH_PX a b c d e f, with the map right = [[a b c] [d e f]] left."""

import json
import statistics
import sys
import time

import cv2
import numpy as np

left, right = (np.rint(np.load(path) * 255).astype(np.uint8) for path in sys.argv[1:3])
most, reach = int(sys.argv[3]), float(sys.argv[4])
warp = np.array(sys.argv[5:11], dtype=float).reshape(2, 3)
sift = cv2.SIFT_create(nfeatures=most)

times = []
for turn in range(4):
    start = time.perf_counter()
    sift.detectAndCompute(left, None)
    if turn > 0:
        times.append(time.perf_counter() - start)

found = [sift.detectAndCompute(image, None) for image in (left, right)]
places = [np.array([point.pt for point in points]) for points, _ in found]


def forward(points):
    return points @ warp[:, :2].T + warp[:, 2]


def backward(points):
    return (points - warp[:, 2]) @ np.linalg.inv(warp[:, :2]).T


def inside(points):
    height, width = left.shape
    return np.all((points >= 0) & (points <= [width - 1, height - 1]), axis=1)


there = forward(np.unique(places[0], axis=0))
there = there[inside(there)]
here = np.unique(places[1], axis=0)
here = here[inside(backward(here))]
distance = np.sqrt(((there[:, None] - here[None]) ** 2).sum(2))
repeatability = np.mean(distance.min(axis=1) < reach) * len(there) / min(len(there), len(here))

# RootSIFT, ratio test and mutual check, as ours.
roots = [np.sqrt(d / np.maximum(d.sum(1, keepdims=True), 1e-9)) for _, d in found]


def nearest(a, b):
    square = np.maximum(2 - 2 * a @ b.T, 0)
    two = np.argpartition(square, 1, axis=1)[:, :2]
    values = np.take_along_axis(square, two, axis=1)
    order = np.argsort(values, axis=1)
    two, values = np.take_along_axis(two, order, axis=1), np.take_along_axis(values, order, axis=1)
    return np.where(values[:, 0] < 0.64 * values[:, 1], two[:, 0], -1)


ahead, back = nearest(roots[0], roots[1]), nearest(roots[1], roots[0])
pairs = {
    (*places[0][i], *places[1][j]) for i, j in enumerate(ahead) if j >= 0 and back[j] == i
}
pairs = np.array(sorted(pairs)).reshape(-1, 4)
correct = int((np.linalg.norm(forward(pairs[:, :2]) - pairs[:, 2:], axis=1) < reach).sum())

print(
    json.dumps(
        {
            "left": len(places[0]),
            "right": len(places[1]),
            "repeatability": float(repeatability),
            "matches": len(pairs),
            "correct": correct,
            "time_ms": statistics.median(times) * 1e3,
        }
    )
)
