// How the foil is held and looked at. Parallel projection, as in the microscope: at tilt a a point lands at
// x = X cos a + Z sin a, so that the tilt slider shows what the goniometer would.

import type { Model } from "./data";

export type Vector = [number, number, number];

export interface Box {
  low: Vector;
  high: Vector;
}

export interface Pose {
  /** Turn about the tilt axis (vertical), rad: tilt from the mid view, and what dragging adds. */
  tilt: number;
  yaw: number;
  /** Turn about the screen's horizontal, rad. */
  pitch: number;
  /** Last turn, about the screen's vertical: that of an eye. Rows stay rows, as eyes need it. */
  eye?: number;
  /** Screen px per unit. */
  zoom: number;
  /** Place of the middle of the box on the screen, px from its centre. */
  panX: number;
  panY: number;
}

export type Orientation = "beam" | "side" | "edge";

/** Turns of the named views: along the beam (x right, y down); along x (z right); along the tilt axis (z down). */
export const ORIENTATIONS: Record<Orientation, { yaw: number; pitch: number }> = {
  beam: { yaw: 0, pitch: 0 },
  side: { yaw: Math.PI / 2, pitch: 0 },
  edge: { yaw: 0, pitch: -Math.PI / 2 },
};

/** Rows of the rotation: screen right, screen down, away from the viewer. */
export function rotation({ tilt, yaw, pitch, eye = 0 }: Pose): [Vector, Vector, Vector] {
  const [c, s] = [Math.cos(tilt + yaw), Math.sin(tilt + yaw)];
  const [cp, sp] = [Math.cos(pitch), Math.sin(pitch)];
  const right: Vector = [c, 0, s];
  const away: Vector = [-s * cp, sp, c * cp];
  const [ce, se] = [Math.cos(eye), Math.sin(eye)];
  return [
    right.map((value, axis) => ce * value + se * away[axis]) as Vector,
    [s * sp, cp, -c * sp],
    away.map((value, axis) => ce * value - se * right[axis]) as Vector,
  ];
}

/** What is shown: the field of the left image, and the depths of nearly all points and of the surfaces. */
export function boxOf(model: Model): Box {
  const { frame, views, measures } = model.report;
  const cosHalf = Math.cos((((model.report.tilts_deg[1] - model.report.tilts_deg[0]) / 2) * Math.PI) / 180);
  const xs = views[0].corners.map(([x]) => ((x - frame.centre_px[0]) / cosHalf) * frame.pixel);
  const ys = views[0].corners.map(([, y]) => (y - frame.centre_px[1]) * frame.pixel);
  let [near, far] = [0, 0];
  const depths = Float64Array.from({ length: model.pointCount }, (_, point) => model.position[3 * point + 2]).sort();
  if (depths.length > 0) {
    near = depths[Math.floor(0.002 * (depths.length - 1))];
    far = depths[Math.ceil(0.998 * (depths.length - 1))];
  }
  const box: Box = { low: [Math.min(...xs), Math.min(...ys), near], high: [Math.max(...xs), Math.max(...ys), far] };
  if ("known" in measures.foil) {
    for (const corner of surfaceCorners(box, measures.foil.known.surfaces).flat()) {
      box.low[2] = Math.min(box.low[2], corner[2]);
      box.high[2] = Math.max(box.high[2], corner[2]);
    }
  }
  const spare = Math.max(0.06 * (box.high[2] - box.low[2]), 2 * frame.pixel);
  box.low[2] -= spare;
  box.high[2] += spare;
  return box;
}

/** Corners of the near and the far surface of the foil over the field. */
export function surfaceCorners(
  box: Box,
  surfaces: { slope_x: number; slope_y: number; z_near: number; z_far: number },
): [Vector[], Vector[]] {
  const at = (z: number) =>
    [0, 1, 2, 3].map((corner): Vector => {
      const x = corner === 0 || corner === 3 ? box.low[0] : box.high[0];
      const y = corner < 2 ? box.low[1] : box.high[1];
      return [x, y, surfaces.slope_x * x + surfaces.slope_y * y + z];
    });
  return [at(surfaces.z_near), at(surfaces.z_far)];
}

export function middle(box: Box): Vector {
  return [0, 1, 2].map((axis) => (box.low[axis] + box.high[axis]) / 2) as Vector;
}

/** The eight corners; bit k of the index says low or high of axis k. */
export function corners(box: Box): Vector[] {
  return Array.from({ length: 8 }, (_, index) =>
    [0, 1, 2].map((axis) => ((index >> axis) & 1 ? box.high[axis] : box.low[axis])) as Vector,
  );
}

/** Places points on the screen, px from its top left corner. */
export class Projector {
  private readonly rows: [Vector, Vector, Vector];
  private readonly centre: Vector;

  constructor(
    readonly pose: Pose,
    box: Box,
    readonly width: number,
    readonly height: number,
  ) {
    this.rows = rotation(pose);
    this.centre = middle(box);
  }

  place(x: number, y: number, z: number): [number, number] {
    const [right, down] = this.rows;
    const [cx, cy, cz] = this.centre;
    const { zoom, panX, panY } = this.pose;
    return [
      this.width / 2 + panX + zoom * (right[0] * (x - cx) + right[1] * (y - cy) + right[2] * (z - cz)),
      this.height / 2 + panY + zoom * (down[0] * (x - cx) + down[1] * (y - cy) + down[2] * (z - cz)),
    ];
  }

  /** x, y of each point. */
  placeAll(position: Float32Array, screen: Float32Array): void {
    const [right, down] = this.rows;
    const { zoom } = this.pose;
    const [r0, r1, r2] = right.map((value) => zoom * value);
    const [d0, d1, d2] = down.map((value) => zoom * value);
    const [x0, y0] = this.place(0, 0, 0);
    for (let point = 0; 2 * point < screen.length; point += 1) {
      const [x, y, z] = [position[3 * point], position[3 * point + 1], position[3 * point + 2]];
      screen[2 * point] = x0 + r0 * x + r1 * y + r2 * z;
      screen[2 * point + 1] = y0 + d0 * x + d1 * y + d2 * z;
    }
  }
}

/** Zoom at which the whole box fits in a pose. */
export function fittingZoom(pose: Pose, box: Box, width: number, height: number): number {
  const projector = new Projector({ ...pose, zoom: 1, panX: 0, panY: 0 }, box, 0, 0);
  const [w, h] = corners(box).reduce(
    ([w, h], corner) => {
      const [x, y] = projector.place(...corner);
      return [Math.max(w, 2 * Math.abs(x)), Math.max(h, 2 * Math.abs(y))];
    },
    [1e-9, 1e-9],
  );
  return Math.min((width - 150) / w, (height - 110) / h);
}
