// What the program embeds in the page (docs/report.md), and the typed columns that the views draw from.

export type Known<T> = { known: T } | { unknown: string };
export type Unit = "nm" | "px";

export interface Source {
  path: string;
  sha256: string;
}

export interface Similarity {
  isometry: { rotation: [number, number]; translation: [number, number] };
  scaling: number;
}

export interface Foil {
  thickness: number;
  thickness_interval: [number, number];
  normal_tilt_deg: number;
  surfaces: { slope_x: number; slope_y: number; z_near: number; z_far: number };
  ends_on_surfaces: [number, number];
  ends: number;
}

export interface Density {
  value: number;
  low: number;
  high: number;
  unit: string;
  note: string;
}

export interface CurveMeasures {
  length: number;
  direction: [number, number, number] | null;
  mean_curvature: number | null;
  min_z: number;
  max_z: number;
  sigma_z: number;
}

export interface Report {
  format_version: number;
  program: string;
  sources: [Source, Source];
  tilts_deg: [number, number];
  frame: {
    unit: Unit;
    pixel: number;
    centre_px: [number, number];
    depth_gain: number;
    median_z: number;
    depth_flipped: boolean;
    relative_tilt_error: number;
  };
  rectification: {
    rectified_from_left: Similarity;
    rectified_from_right: Similarity;
    shape: [number, number];
    inliers: number;
    matches: number;
    rms_row_error_px: number;
    sigma_row_px: number;
    axis_deg: number;
    axis_sigma_deg: number;
    axis_held_by_prior: boolean;
    relative_rotation_deg: number;
    relative_scale: number;
    disparity_range_px: [number, number];
  };
  point_matches: { x: number[]; y: number[]; disparity: number[]; row: number[] };
  views: [View, View];
  curves: Curve[];
  measures: {
    curves: number;
    total_length: number;
    total_length_sigma: number;
    doubtful_share: number;
    depth: { low: number; high: number; sigma_z: number } | null;
    foil: Known<Foil>;
    density: Known<Density>;
    per_curve: CurveMeasures[];
  };
  warnings: { stage: string; message: string }[];
  run: string;
  series?: Series;
}

/** The other views of the series that the pair is of. */
export interface Series {
  path: string;
  fitted: boolean;
  views: SeriesView[];
  checks: string[];
  warnings?: { stage: string; message: string }[];
  pictures: ViewPicture[];
  tomogram?: Tomogram;
}

export interface SeriesView {
  tilt_deg: number;
  in_pair: boolean;
  supported: boolean;
  distances: { points: number; median_px: number; percent95_px: number; within_2px: number; within_5px: number; chance_within_3px: number } | null;
  tilt_error_deg?: [number, number];
}

export type Row = [number, number, number, number];

export interface ViewPicture {
  tilt_deg: number;
  size_px: [number, number];
  image: string;
  step_px: number;
  projection: [Row, Row];
  lines: number[][];
}

export interface Tomogram {
  method: string;
  comparison: {
    threshold: number;
    share: number;
    result: [number, number];
    tomogram: [number, number];
    reach_px: [number, number];
    depth_px: [number, number] | null;
  };
  size: [number, number, number];
  above: string;
  edge: string;
  step: [number, number];
  voxels: [Row, Row, Row];
}

export interface View {
  image: string;
  probability: string;
  corners: [number, number][];
  lines: number[][];
  unmatched: number[][];
  length_px: [number, number];
}

export interface Curve {
  closed: boolean;
  ends: [string, string];
  x: number[];
  y: number[];
  disparity: number[];
  sigma: number[];
  flags: string;
}

/** Words of the flags, by their digit. */
export const FLAGS = ["ok", "ill_conditioned", "bridged"] as const;
export const FLAG_TEXTS = ["Measured in both images", "Runs along the rows", "Bridged from its neighbours"] as const;

/** All points of all curves as columns; curve c has the points from offset[c] to offset[c + 1]. */
export interface Model {
  report: Report;
  unit: Unit;
  curveCount: number;
  pointCount: number;
  offset: Uint32Array;
  /** Rectified left image, px. */
  x: Float64Array;
  y: Float64Array;
  disparity: Float64Array;
  sigmaDisparity: Float64Array;
  /** x, y, z a point, in the unit: x right, y down, z away from the viewer. */
  position: Float32Array;
  sigmaZ: Float32Array;
  flag: Uint8Array;
  /** First and last point of each segment, and its curve. */
  segments: Uint32Array;
  segmentCurve: Uint32Array;
  /** Length along the beam's projection that each point stands for, in the unit: weights of the histograms. */
  weight: Float32Array;
}

export function readReport(): Report {
  const element = document.getElementById("report-data");
  return JSON.parse(element?.textContent ?? "") as Report;
}

export function modelOf(report: Report): Model {
  const { curves, frame, tilts_deg } = report;
  const offset = new Uint32Array(curves.length + 1);
  curves.forEach((curve, index) => (offset[index + 1] = offset[index] + curve.x.length));
  const pointCount = offset[curves.length];
  const segmentCount = curves.reduce((sum, curve) => sum + curve.x.length - 1 + Number(curve.closed), 0);
  const model: Model = {
    report,
    unit: frame.unit,
    curveCount: curves.length,
    pointCount,
    offset,
    x: new Float64Array(pointCount),
    y: new Float64Array(pointCount),
    disparity: new Float64Array(pointCount),
    sigmaDisparity: new Float64Array(pointCount),
    position: new Float32Array(3 * pointCount),
    sigmaZ: new Float32Array(pointCount),
    flag: new Uint8Array(pointCount),
    segments: new Uint32Array(2 * segmentCount),
    segmentCurve: new Uint32Array(segmentCount),
    weight: new Float32Array(pointCount),
  };
  const cosHalfPhi = Math.cos((((tilts_deg[1] - tilts_deg[0]) / 2) * Math.PI) / 180);
  const [cx, cy] = frame.centre_px;
  let segment = 0;
  curves.forEach((curve, index) => {
    const first = offset[index];
    for (let k = 0; k < curve.x.length; k += 1) {
      const point = first + k;
      const d = curve.disparity[k];
      model.x[point] = curve.x[k];
      model.y[point] = curve.y[k];
      model.disparity[point] = d;
      model.sigmaDisparity[point] = curve.sigma[k];
      model.position[3 * point] = ((curve.x[k] + d / 2 - cx) / cosHalfPhi) * frame.pixel;
      model.position[3 * point + 1] = (curve.y[k] - cy) * frame.pixel;
      model.position[3 * point + 2] = d * frame.depth_gain * frame.pixel - frame.median_z;
      model.sigmaZ[point] = curve.sigma[k] * Math.abs(frame.depth_gain) * frame.pixel;
      model.flag[point] = curve.flags.charCodeAt(k) - 48;
    }
    const steps = curve.x.length - 1 + Number(curve.closed);
    for (let k = 0; k < steps; k += 1) {
      const [a, b] = [first + k, first + ((k + 1) % curve.x.length)];
      model.segments.set([a, b], 2 * segment);
      model.segmentCurve[segment] = index;
      const half =
        Math.hypot(
          model.position[3 * b] - model.position[3 * a],
          model.position[3 * b + 1] - model.position[3 * a + 1],
        ) / 2;
      model.weight[a] += half;
      model.weight[b] += half;
      segment += 1;
    }
  });
  return model;
}

/** The curve a point belongs to. */
export function curveOf(model: Model, point: number): number {
  let [low, high] = [0, model.curveCount];
  while (high - low > 1) {
    const middle = (low + high) >> 1;
    if (model.offset[middle] <= point) low = middle;
    else high = middle;
  }
  return low;
}

/** Input px of a rectified point: the inverse of a similarity. */
export function inverse({ isometry, scaling }: Similarity, x: number, y: number): [number, number] {
  const [cos, sin] = isometry.rotation;
  const [dx, dy] = [x - isometry.translation[0], y - isometry.translation[1]];
  return [(cos * dx + sin * dy) / scaling, (cos * dy - sin * dx) / scaling];
}

/** The value below which so much of the weight lies; 0 without any. */
export function quantile(values: ArrayLike<number>, fraction: number): number {
  const sorted = Float64Array.from(values).sort();
  return sorted.length === 0 ? 0 : sorted[Math.min(sorted.length - 1, Math.floor(fraction * sorted.length))];
}

export function fileName(path: string): string {
  return path.replace(/[/\\]+$/, "").split(/[/\\]/).pop() || "image in memory";
}
