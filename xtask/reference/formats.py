"""Reads what Tiltline exported with pyvista (VTK) and tifffile and compares it with curves.csv."""

import csv
import json
import sys
from pathlib import Path

import numpy as np
import pyvista
import tifffile

folder = Path(sys.argv[1])
with open(folder / "curves.csv", newline="") as file:
    rows = list(csv.DictReader(file))
unit = "nm" if rows and "x_nm" in rows[0] else "px"
xyz = np.array([[float(row[f"{axis}_{unit}"]) for axis in "xyz"] for row in rows]).reshape(-1, 3)
ids = np.array([int(row["curve"]) for row in rows], int)
curves = len(set(ids))
details = json.loads((folder / "curves.json").read_text())
answer = {}


def judge(name, ok, what="same"):
    answer[name] = {"ok": bool(ok), "what": what if ok else "differs: " + what}


def same(points):
    # VTK keeps PLY and OBJ points in single precision.
    points = np.asarray(points).reshape(-1, 3)
    return len(points) == len(xyz) and np.allclose(points, xyz, rtol=1e-6, atol=1e-4)


mesh = pyvista.read(folder / "curves.vtp")
ok = same(mesh.points) and mesh.n_lines == curves
for column in ("disparity_px", "sigma_disparity_px", f"z_{unit}", f"sigma_z_{unit}"):
    ok &= np.allclose(mesh.point_data[column], [float(row[column]) for row in rows], atol=1e-9)
ok &= np.array_equal(mesh.point_data["curve"], ids)
ok &= ["ok ill_conditioned bridged".split()[flag] for flag in mesh.point_data["flag"]] == [row["flag"] for row in rows]
at = 0
lines = np.asarray(mesh.lines)
for curve in range(curves):
    count = lines[at]
    vertices = lines[at + 1 : at + 1 + count]
    ok &= set(ids[vertices]) == {curve}
    at += count + 1
judge("curves.vtp", ok, f"{mesh.n_points} points, {mesh.n_lines} lines" if not ok else "same")

if xyz.size:
    ply = pyvista.read(folder / "curves.ply")
    # VTK reads no edges from a PLY; they are compared in the file itself.
    text = (folder / "curves.ply").read_text().splitlines()
    edges = int(next(line for line in text if line.startswith("element edge")).split()[2])
    pairs = np.array([line.split() for line in text[len(text) - edges :]], int)
    inside = np.all(ids[pairs[:, 0]] == ids[pairs[:, 1]])
    judge("curves.ply", same(ply.points) and edges == len(xyz) - curves and inside)
    obj = pyvista.read(folder / "curves.obj")
    judge("curves.obj", same(obj.points) and obj.n_lines == curves, f"{obj.n_points} points, {obj.n_lines} lines" if not same(obj.points) or obj.n_lines != curves else "same")
else:
    for name in ("curves.ply", "curves.obj"):
        try:
            judge(name, pyvista.read(folder / name).n_points == 0)
        except Exception as error:  # noqa: BLE001
            judge(name, False, repr(error))

shape = tuple(details["rectification"]["shape"])
x = details["curves"][0]["points"]["x_left_px"] if details["curves"] else []
for name, column in (("disparity.tif", "disparity_px"), ("sigma.tif", "sigma_disparity_px")):
    with tifffile.TiffFile(folder / name) as tif:
        image = tif.asarray()
        tags = tif.pages[0].tags
        imagej = tif.imagej_metadata or {}
        resolution = tags["XResolution"].value if "XResolution" in tags else None
    ok = image.dtype == np.float32 and image.shape == shape
    if rows:
        values = np.array([float(row[column]) for row in rows])
        # The scene's rectification is the identity up to the given geometry, so that input px are rectified px here.
        column_px = np.array([float(row["x_left_px"]) for row in rows]).round().astype(int)
        row_px = np.array([float(row["y_left_px"]) for row in rows]).round().astype(int)
        painted = image[row_px, column_px]
        # Where curves cross, the other one may have been painted: nearly all must agree to half a pixel of line.
        agree = np.mean(np.abs(painted - values) < 0.1)
        ok &= np.all(np.isfinite(painted)) and agree > 0.97
        ok &= np.nanmin(image) >= values.min() - 1e-4 and np.nanmax(image) <= values.max() + 1e-4
    else:
        ok &= bool(np.all(np.isnan(image)))
    if unit == "nm":
        ok &= imagej.get("unit") == "nm"
        ok &= abs(resolution[1] / resolution[0] - details["frame"]["pixel"]) < 1e-8
    else:
        ok &= resolution is None or imagej.get("unit") == "pixel"
    judge(name, bool(ok), "same" if ok else f"{image.shape} {image.dtype} {imagej}")

for name in ("rectified_left.tif", "rectified_right.tif"):
    assert tifffile.imread(folder / name).shape == shape
print(json.dumps(answer))
