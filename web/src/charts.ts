// Histograms and maps as SVG: axes with units, no more ink than needed.

import { type Rgb, css } from "./colour";
import { s } from "./dom";
import { digits, ticks } from "./format";

const MARGIN = { left: 56, right: 14, top: 12, bottom: 42 };
const WIDTH = 560;
const HEIGHT = 250;

export interface Bins {
  low: number;
  step: number;
  heights: number[];
}

/** Weights of values in bins of a round width over a range; what lies outside is left out. */
export function histogram(values: ArrayLike<number>, weights: ArrayLike<number> | null, low: number, high: number, count: number): Bins {
  const heights = new Array<number>(count).fill(0);
  const step = (high - low) / count;
  for (let k = 0; k < values.length; k += 1) {
    const bin = Math.floor((values[k] - low) / step);
    if (bin >= 0 && bin < count) heights[bin] += weights ? weights[k] : 1;
  }
  return { low, step, heights };
}

interface Axes {
  plot: SVGElement;
  x: (value: number) => number;
  y: (value: number) => number;
}

function axes(label: string, xRange: [number, number], yRange: [number, number], xTitle: string, yTitle: string, height: number, field: [number, number] | null = null): Axes {
  const [right, bottom] = [WIDTH - MARGIN.right, height - MARGIN.bottom];
  const x = (value: number) => MARGIN.left + ((right - MARGIN.left) * (value - xRange[0])) / (xRange[1] - xRange[0] || 1);
  const y = (value: number) => bottom + ((MARGIN.top - bottom) * (value - yRange[0])) / (yRange[1] - yRange[0] || 1);
  const [yLow, yHigh] = [Math.min(...yRange), Math.max(...yRange)];
  const plot = s(
    "svg",
    { viewBox: `0 0 ${WIDTH} ${height}`, role: "img", "aria-label": label, class: "chart" },
    ...ticks(yLow, yHigh, 4).flatMap(({ value, text }) => [
      !field && s("line", { x1: MARGIN.left, x2: right, y1: y(value), y2: y(value), class: "grid" }),
      s("text", { x: (field ? x(field[0]) : MARGIN.left) - 8, y: y(value), dy: "0.35em", "text-anchor": "end" }, text),
    ]),
    ...ticks(...(field ?? xRange), 7).flatMap(({ value, text }) => [
      s("line", { x1: x(value), x2: x(value), y1: bottom, y2: bottom + 5, class: "axis" }),
      s("text", { x: x(value), y: bottom + 18, "text-anchor": "middle" }, text),
    ]),
    !field && s("line", { x1: MARGIN.left, x2: right, y1: bottom, y2: bottom, class: "axis" }),
    s("text", { x: (MARGIN.left + right) / 2, y: height - 6, "text-anchor": "middle", class: "axis-title" }, xTitle),
    s("text", { transform: `translate(${(field ? x(field[0]) : MARGIN.left) - 42} ${(MARGIN.top + bottom) / 2}) rotate(-90)`, "text-anchor": "middle", class: "axis-title" }, yTitle),
  );
  return { plot, x, y };
}

/** Bars, each in a colour of its own, with marks (a value and its words) across them. */
export function bars(label: string, bins: Bins, colour: (value: number) => Rgb, xTitle: string, yTitle: string, marks: { value: number; text: string }[] = []): SVGElement {
  const high = bins.low + bins.step * bins.heights.length;
  const top = Math.max(...bins.heights, 1e-9) * (marks.length > 0 ? 1.2 : 1.06);
  const { plot, x, y } = axes(label, [bins.low, high], [0, top], xTitle, yTitle, HEIGHT);
  bins.heights.forEach((height, k) => {
    if (height <= 0) return;
    const from = bins.low + k * bins.step;
    plot.append(
      s(
        "rect",
        { x: x(from) + 0.75, y: y(height), width: Math.max(0.5, x(from + bins.step) - x(from) - 1.5), height: y(0) - y(height), fill: css(colour(from + bins.step / 2)) },
        s("title", {}, `${digits(from)} to ${digits(from + bins.step)}: ${digits(height)}`),
      ),
    );
  });
  for (const { value, text } of marks) {
    const end = x(value) > WIDTH / 2;
    plot.append(
      s("line", { x1: x(value), x2: x(value), y1: MARGIN.top, y2: y(0), class: "mark" }),
      s("text", { x: x(value) + (end ? -6 : 6), y: MARGIN.top + 9, "text-anchor": end ? "end" : "start" }, text),
    );
  }
  return plot;
}

/** Points on the image plane, coloured; y runs down as in the image. */
export function map(label: string, points: { x: number; y: number; colour: Rgb; text: string }[], shape: [number, number]): SVGElement {
  const [rows, columns] = shape;
  const inner = WIDTH - MARGIN.left - MARGIN.right;
  const height = Math.min(336, (inner * rows) / columns + MARGIN.top + MARGIN.bottom);
  // Both axes at one scale.
  const scale = (height - MARGIN.top - MARGIN.bottom) / rows;
  const spare = (inner / scale - columns) / 2;
  const { plot, x, y } = axes(label, [-spare, columns + spare], [rows, 0], "column (px)", "row (px)", height, [0, columns]);
  plot.insertBefore(s("rect", { x: x(0), y: y(0), width: x(columns) - x(0), height: y(rows) - y(0), class: "field" }), plot.firstChild);
  for (const point of points) {
    plot.append(s("circle", { cx: x(point.x), cy: y(point.y), r: 3, fill: css(point.colour) }, s("title", {}, point.text)));
  }
  return plot;
}

/** A value at a place with a range above it; hollow where it is not a test. */
export interface Spot {
  x: number;
  y: number;
  /** Ends of a line through it. */
  low: number;
  high: number;
  hollow: boolean;
  text: string;
}

/** Values with ranges over x, with horizontal marks. What lies above the chart is drawn at its top. */
export function spots(label: string, found: Spot[], yRange: [number, number], xTitle: string, yTitle: string, marks: { value: number; text: string }[] = []): SVGElement {
  const xs = found.map((spot) => spot.x);
  const spare = 0.04 * (Math.max(...xs) - Math.min(...xs)) || 1;
  const { plot, x, y } = axes(label, [Math.min(...xs) - spare, Math.max(...xs) + spare], yRange, xTitle, yTitle, HEIGHT);
  const at = (value: number) => y(Math.min(Math.max(value, yRange[0]), yRange[1]));
  for (const { value, text } of marks) {
    plot.append(
      s("line", { x1: MARGIN.left, x2: WIDTH - MARGIN.right, y1: at(value), y2: at(value), class: "mark" }),
      s("text", { x: WIDTH - MARGIN.right - 4, y: at(value) - 5, "text-anchor": "end" }, text),
    );
  }
  for (const spot of found) {
    plot.append(
      s(
        "g",
        { class: spot.hollow ? "spot hollow" : "spot" },
        s("line", { x1: x(spot.x), x2: x(spot.x), y1: at(spot.low), y2: at(spot.high) }),
        s("circle", { cx: x(spot.x), cy: at(spot.y), r: 3.5 }),
        s("title", {}, spot.text),
      ),
    );
  }
  return plot;
}
