// What stands over the foil in sharp type: axes with ticks and units, the scale bar, the point under the pointer.

import type { Model } from "./data";
import { digits, roundDown, ticks } from "./format";
import { type Box, type Projector, corners } from "./pose";
import { type Hover, token } from "./store";

export const LABEL_FONT = '12px system-ui, "Segoe UI", Roboto, "Helvetica Neue", Arial, sans-serif';
const NAMES = ["x", "y", "z"];
/** Shortest edge, px, that gets ticks. */
const SHORTEST_AXIS_PX = 46;

/** Draws axes on those edges of the box that lie on its outline, at the bottom or left where there is a choice. */
export function drawAxes(context: CanvasRenderingContext2D, projector: Projector, box: Box, model: Model): void {
  context.font = LABEL_FONT;
  context.fillStyle = token("muted");
  context.strokeStyle = token("muted");
  context.lineWidth = 1;
  const points = corners(box);
  const placed = points.map((corner) => projector.place(...corner));
  const centre = placed.reduce(([sx, sy], [x, y]) => [sx + x / 8, sy + y / 8], [0, 0]);
  const taken: [number, number][] = [];
  for (const axis of [0, 1, 2]) {
    const edges = points
      .map((_, a) => a)
      .filter((a) => !(a & (1 << axis)))
      .map((a) => {
        const [p, q] = [placed[a], placed[a | (1 << axis)]];
        const [mx, my] = [(p[0] + q[0]) / 2 - centre[0], (p[1] + q[1]) / 2 - centre[1]];
        const along = [q[0] - p[0], q[1] - p[1]];
        const length = Math.hypot(along[0], along[1]);
        // How far out the edge lies across its own direction; below and to the left are liked better.
        const out = length > 0 ? Math.abs(mx * along[1] - my * along[0]) / length : 0;
        const crowded = taken.some(([x, y]) => Math.hypot(x - mx, y - my) < 1);
        return { a, p, q, mx, my, along, length, rank: out + 0.3 * (my - mx) - (crowded ? 1e4 : 0) };
      })
      .sort((a, b) => b.rank - a.rank);
    const { p, q, mx, my, along, length } = edges[0];
    if (length < SHORTEST_AXIS_PX) continue;
    taken.push([mx, my]);
    const across: [number, number] = [-along[1] / length, along[0] / length];
    if (across[0] * mx + across[1] * my < 0) across.forEach((value, k) => (across[k] = -value));
    const [low, high] = [box.low[axis], box.high[axis]];
    const found = ticks(low, high, Math.max(2, length / 80));
    context.textAlign = across[0] > 0.5 ? "left" : across[0] < -0.5 ? "right" : "center";
    context.textBaseline = across[1] > 0.5 ? "top" : across[1] < -0.5 ? "bottom" : "middle";
    let widest = 0;
    for (const { value, text } of found) {
      const t = (value - low) / (high - low);
      const [x, y] = [p[0] + t * along[0], p[1] + t * along[1]];
      context.beginPath();
      context.moveTo(x, y);
      context.lineTo(x + 5 * across[0], y + 5 * across[1]);
      context.stroke();
      context.fillText(text, x + 9 * across[0], y + 9 * across[1]);
      widest = Math.max(widest, context.measureText(text).width);
    }
    // The name stands beyond the ticks' numbers at the middle of the edge, along it where it is steep.
    const name = `${NAMES[axis]} (${model.unit})${axis === 2 && length > 170 ? ", away from viewer" : ""}`;
    const reach = 14 + Math.abs(across[0]) * (widest + 8) + Math.abs(across[1]) * 16;
    context.save();
    context.translate((p[0] + q[0]) / 2 + reach * across[0], (p[1] + q[1]) / 2 + reach * across[1]);
    const angle = Math.atan2(along[1], along[0]);
    context.rotate(angle > Math.PI / 2 + 0.01 ? angle - Math.PI : angle < -Math.PI / 2 + 0.01 ? angle + Math.PI : angle);
    context.textAlign = "center";
    context.textBaseline = "middle";
    context.fillStyle = token("ink");
    context.fillText(name, 0, 0);
    context.restore();
  }
}

/** A bar of a round length: in a parallel projection it holds everywhere in the plane of the screen. */
export function drawScaleBar(context: CanvasRenderingContext2D, zoom: number, unit: string, x: number, y: number, maxPx: number, ground = ""): void {
  const length = roundDown(maxPx / zoom);
  const width = length * zoom;
  const text = `${digits(length, 1)} ${unit}`;
  context.font = `600 ${LABEL_FONT}`;
  context.textAlign = "center";
  context.textBaseline = "bottom";
  if (ground) {
    const wide = Math.max(width, context.measureText(text).width) + 20;
    context.fillStyle = ground;
    context.globalAlpha = 0.84;
    context.beginPath();
    context.roundRect(x + width / 2 - wide / 2, y - 27, wide, 34, 4);
    context.fill();
    context.globalAlpha = 1;
  }
  context.fillStyle = token("ink");
  context.fillRect(x, y - 3, width, 3);
  context.fillText(text, x + width / 2, y - 7);
}

/** A ring about the point under the pointer. */
export function drawRing(context: CanvasRenderingContext2D, x: number, y: number): void {
  for (const [width, colour] of [
    [4, token("paper")],
    [2, token("mark")],
  ] as const) {
    context.strokeStyle = colour;
    context.lineWidth = width;
    context.beginPath();
    context.arc(x, y, 7, 0, 2 * Math.PI);
    context.stroke();
  }
}

/** The nearest place to (x, y) on the segments between screen points, within `reach` px; `null` if there is none. */
export function nearest(model: Model, screen: ArrayLike<number>, x: number, y: number, reach: number): Hover | null {
  let best = reach * reach;
  let hover: Hover | null = null;
  const { segments, segmentCurve } = model;
  for (let segment = 0; segment < segmentCurve.length; segment += 1) {
    const [a, b] = [segments[2 * segment], segments[2 * segment + 1]];
    const [ax, ay] = [screen[2 * a], screen[2 * a + 1]];
    const [dx, dy] = [screen[2 * b] - ax, screen[2 * b + 1] - ay];
    const square = dx * dx + dy * dy;
    const t = square > 0 ? Math.min(1, Math.max(0, ((x - ax) * dx + (y - ay) * dy) / square)) : 0;
    const [ex, ey] = [ax + t * dx - x, ay + t * dy - y];
    const distance = ex * ex + ey * ey;
    if (distance < best) {
      best = distance;
      hover = { curve: segmentCurve[segment], point: t < 0.5 ? a : b };
    }
  }
  return hover;
}

