// One of the rectified images: a canvas with what was detected, matched and measured drawn over it.

import { type Rgb, css } from "./colour";
import { fitted, h } from "./dom";
import type { Images } from "./images";
import { drawRing, drawScaleBar } from "./overlay";
import { type Store, token } from "./store";

/** Colours that a scale is cut into, so that a thousand curves are a few dozen strokes. */
const SHADES = 48;
/** Points of a curve between two bars of disparity. */
const DISPARITY_STEP = 8;
/** Screen px a curve's line is wide. */
const LINE_PX = 2;

/** Colours over grey images: with all of them, no two are only told apart by red and green. */
export const DETECTED = "#ffffff";
export const UNMATCHED = "#ffb000";
export const PROBABLE: Rgb = [255, 140, 26];
export const MATCH = "#ffd75e";
export const [NEARER, FARTHER] = ["#6fb7f0", "#f1a340"];
/** Curves of one colour: lines that were measured, and those that were not. */
interface Shade {
  colour: string;
  sound: Path2D;
  doubtful: Path2D;
}

/** One of both images. */
export class Panel {
  readonly element: HTMLElement;
  private readonly canvas: HTMLCanvasElement;
  private readonly image = new Image();
  private probability: HTMLCanvasElement | null = null;
  private readonly outline = new Path2D();
  private shades: Shade[] = [];
  private readonly lines = new Path2D();
  private readonly unmatched = new Path2D();
  private readonly whole: Path2D[] = [];
  private readonly places: Float64Array;

  constructor(
    private readonly images: Images,
    private readonly store: Store,
    readonly side: number,
  ) {
    const { model } = store;
    const view = model.report.views[side];
    const name = side === 0 ? "left" : "right";
    const tilt = model.report.tilts_deg[side];
    const text = `${side === 0 ? "Left" : "Right"}, ${tilt > 0 ? "+" : ""}${tilt}°`.replace("-", "\u2212");
    this.canvas = h("canvas", {
      tabindex: 0,
      role: "img",
      "aria-label": `Rectified ${name} image with ${model.curveCount} curves. Arrow keys move, plus and minus zoom, 0 fits.`,
    });
    this.element = h("figure", { class: "panel" }, this.canvas, h("figcaption", {}, text));
    this.image.addEventListener("load", images.redraw);
    this.image.src = `data:image/jpeg;base64,${view.image}`;
    view.corners.forEach(([x, y], k) => (k === 0 ? this.outline.moveTo(x, y) : this.outline.lineTo(x, y)));
    this.outline.closePath();
    for (const [path, lines] of [
      [this.lines, view.lines],
      [this.unmatched, view.unmatched],
    ] as const) {
      for (const line of lines) for (let k = 0; k < line.length; k += 2) k === 0 ? path.moveTo(line[0], line[1]) : path.lineTo(line[k], line[k + 1]);
    }
    this.places = new Float64Array(2 * model.pointCount);
    for (let point = 0; point < model.pointCount; point += 1) {
      this.places[2 * point] = model.x[point] + side * model.disparity[point];
      this.places[2 * point + 1] = model.y[point];
    }
    this.whole = model.report.curves.map(() => new Path2D());
    model.segmentCurve.forEach((curve, segment) => this.add(this.whole[curve], segment));
    this.recolour();
    this.listen();
  }

  /** Points of the curves on this image, rectified px. */
  screen(): Float64Array {
    return this.places;
  }

  size(): [number, number] {
    return [this.canvas.clientWidth, this.canvas.clientHeight];
  }

  private add(path: Path2D, segment: number): void {
    const { segments } = this.store.model;
    const [a, b] = [segments[2 * segment], segments[2 * segment + 1]];
    path.moveTo(this.places[2 * a], this.places[2 * a + 1]);
    path.lineTo(this.places[2 * b], this.places[2 * b + 1]);
  }

  recolour(): void {
    const { model, scale } = this.store;
    const count = scale.classes ? scale.classes.length : SHADES;
    const at = (shade: number) => (scale.classes ? shade : scale.low + ((shade + 0.5) / SHADES) * (scale.high - scale.low));
    this.shades = Array.from({ length: count }, (_, shade) => ({ colour: css(scale.colour(at(shade))), sound: new Path2D(), doubtful: new Path2D() }));
    model.segmentCurve.forEach((curve, segment) => {
      const point = model.segments[2 * segment];
      const value = scale.value(point, curve);
      const fraction = (value - scale.low) / (scale.high - scale.low);
      const shade = scale.classes ? value : Math.min(SHADES - 1, Math.max(0, Math.floor(fraction * SHADES)));
      this.add(model.flag[point] === 0 ? this.shades[shade].sound : this.shades[shade].doubtful, segment);
    });
  }

  private listen(): void {
    const { canvas, images } = this;
    const place = (event: { clientX: number; clientY: number }) => {
      const rect = canvas.getBoundingClientRect();
      const [width, height] = this.size();
      const { zoom, x, y } = images.view;
      return { x: x + (event.clientX - rect.left - width / 2) / zoom, y: y + (event.clientY - rect.top - height / 2) / zoom };
    };
    const pointers = new Map<number, { x: number; y: number }>();
    let travelled = 0;
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      pointers.set(event.pointerId, { x: event.clientX, y: event.clientY });
      travelled = pointers.size > 1 ? Infinity : 0;
    });
    canvas.addEventListener("pointermove", (event) => {
      const from = pointers.get(event.pointerId);
      if (from) {
        const [dx, dy] = [event.clientX - from.x, event.clientY - from.y];
        travelled += Math.hypot(dx, dy);
        // Each of two fingers moves the image by half; how far they come apart zooms about their middle.
        const other = [...pointers].find(([id]) => id !== event.pointerId)?.[1];
        images.move(dx / pointers.size, dy / pointers.size);
        if (other) {
          const apart = (x: number, y: number) => Math.max(1, Math.hypot(x - other.x, y - other.y));
          const middle = place({ clientX: (event.clientX + other.x) / 2, clientY: (event.clientY + other.y) / 2 });
          images.zoom(apart(event.clientX, event.clientY) / apart(from.x, from.y), middle.x, middle.y);
        }
        pointers.set(event.pointerId, { x: event.clientX, y: event.clientY });
      }
      images.pointAt(place(event), this.side);
    });
    canvas.addEventListener("pointerup", (event) => {
      if (pointers.has(event.pointerId) && travelled <= 3) {
        images.pointAt(place(event), this.side);
        this.store.select(this.store.hover?.curve ?? null);
      }
      pointers.delete(event.pointerId);
    });
    canvas.addEventListener("pointercancel", (event) => pointers.delete(event.pointerId));
    canvas.addEventListener("pointerleave", () => images.pointAt(null, this.side));
    canvas.addEventListener(
      "wheel",
      (event) => {
        event.preventDefault();
        const { x, y } = place(event);
        images.zoom(Math.exp(-event.deltaY * (event.deltaMode === 1 ? 0.05 : 0.0015)), x, y);
      },
      { passive: false },
    );
    canvas.addEventListener("keydown", (event) => {
      const arrow = { ArrowLeft: [1, 0], ArrowRight: [-1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] }[event.key];
      if (arrow) images.move(40 * arrow[0], 40 * arrow[1]);
      else if (event.key === "+" || event.key === "=") images.zoom(1.3, images.view.x, images.view.y);
      else if (event.key === "-") images.zoom(1 / 1.3, images.view.x, images.view.y);
      else if (event.key === "0") images.fit();
      else return;
      event.preventDefault();
    });
  }

  draw(): void {
    const { canvas, images, store } = this;
    const [width, height] = this.size();
    if (width === 0 || height === 0) return;
    const ratio = fitted(canvas, width, height);
    const context = canvas.getContext("2d")!;
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.fillStyle = token("void");
    context.fillRect(0, 0, width, height);
    const { zoom, x, y } = images.view;
    const inverse = 1 / zoom;
    context.save();
    context.translate(width / 2 - x * zoom, height / 2 - y * zoom);
    context.scale(zoom, zoom);
    context.save();
    context.clip(this.outline);
    context.imageSmoothingEnabled = zoom < 4;
    // Pixel centres are at integers.
    if (this.image.complete && this.image.naturalWidth > 0) context.drawImage(this.image, -0.5, -0.5);
    context.globalAlpha = images.overlayOpacity;
    if (images.isShown("probability")) context.drawImage(this.tinted(), -0.5, -0.5);
    context.restore();
    context.lineCap = "round";
    context.lineJoin = "round";
    const stroke = (path: Path2D, colour: string, px: number, alpha = 1) => {
      context.globalAlpha = alpha * images.overlayOpacity;
      context.strokeStyle = colour;
      context.lineWidth = px * inverse;
      context.stroke(path);
    };
    if (images.isShown("lines")) {
      stroke(this.lines, DETECTED, 1.2, 0.85);
      stroke(this.unmatched, UNMATCHED, 1.8);
    }
    if (images.isShown("curves")) this.drawCurves(context, stroke, inverse);
    if (images.isShown("disparity")) this.drawDisparity(stroke);
    if (images.isShown("matches")) this.drawMatches(context, inverse);
    if (store.selected !== null) {
      stroke(this.whole[store.selected], token("mark"), 6);
      const middle = (store.model.offset[store.selected] + store.model.offset[store.selected + 1]) >> 1;
      stroke(this.whole[store.selected], css(store.scale.colour(store.scale.value(middle, store.selected))), LINE_PX);
    }
    context.globalAlpha = 1;
    context.restore();
    const row = images.rowUnderPointer;
    if (row !== null) {
      const at = height / 2 + (row - y) * zoom;
      context.setLineDash([6, 4]);
      for (const [colour, lineWidth] of [["rgba(0,0,0,0.55)", 3], ["#ffffff", 1]] as const) {
        context.strokeStyle = colour;
        context.lineWidth = lineWidth;
        context.beginPath();
        context.moveTo(0, at);
        context.lineTo(width, at);
        context.stroke();
      }
      context.setLineDash([]);
    }
    if (store.hover) {
      const at = 2 * store.hover.point;
      drawRing(context, width / 2 + (this.places[at] - x) * zoom, height / 2 + (this.places[at + 1] - y) * zoom);
    }
    if (this.side === 0 || images.layout === "blink") {
      const { frame } = store.model.report;
      drawScaleBar(context, zoom / frame.pixel, frame.unit, 20, height - 18, 130, token("paper"));
    }
  }

  private drawCurves(context: CanvasRenderingContext2D, stroke: (path: Path2D, colour: string, px: number, alpha?: number) => void, inverse: number): void {
    for (const path of this.whole) stroke(path, "#ffffff", LINE_PX + 1.6, 0.55);
    for (const { colour, sound } of this.shades) stroke(sound, colour, LINE_PX);
    // Where the disparity was not measured well.
    for (const { colour, doubtful } of this.shades) {
      stroke(doubtful, "#ffffff", LINE_PX);
      context.setLineDash([0.1 * inverse, 3.5 * inverse]);
      stroke(doubtful, colour, LINE_PX);
      context.setLineDash([]);
    }
  }

  /** From a point of the left image to where it is in the right one: as long as the disparity. */
  private drawDisparity(stroke: (path: Path2D, colour: string, px: number) => void): void {
    const { model } = this.store;
    const [towards, away] = [new Path2D(), new Path2D()];
    for (let curve = 0; curve < model.curveCount; curve += 1) {
      for (let point = model.offset[curve]; point < model.offset[curve + 1]; point += DISPARITY_STEP) {
        const path = model.disparity[point] < 0 ? towards : away;
        path.moveTo(model.x[point], model.y[point]);
        path.lineTo(model.x[point] + model.disparity[point], model.y[point]);
      }
    }
    stroke(towards, NEARER, 1.6);
    stroke(away, FARTHER, 1.6);
  }

  private drawMatches(context: CanvasRenderingContext2D, inverse: number): void {
    const { x, y, disparity, row } = this.store.model.report.point_matches;
    context.globalAlpha = this.images.overlayOpacity;
    context.lineWidth = 1.4 * inverse;
    context.strokeStyle = MATCH;
    context.beginPath();
    x.forEach((column, k) => {
      const [cx, cy] = [column + this.side * disparity[k], y[k] + this.side * row[k]];
      context.moveTo(cx + 3.2 * inverse, cy);
      context.arc(cx, cy, 3.2 * inverse, 0, 2 * Math.PI);
    });
    context.stroke();
  }

  /** The line probability as a tint whose opacity it is. */
  private tinted(): HTMLCanvasElement {
    if (this.probability) return this.probability;
    const [rows, columns] = this.store.model.report.rectification.shape;
    const canvas = h("canvas", { width: columns, height: rows });
    this.probability = canvas;
    const image = new Image();
    image.addEventListener("load", () => {
      const context = canvas.getContext("2d")!;
      context.drawImage(image, 0, 0);
      const pixels = context.getImageData(0, 0, columns, rows);
      for (let at = 0; at < pixels.data.length; at += 4) {
        const probability = pixels.data[at];
        pixels.data.set([...PROBABLE, probability < 12 ? 0 : probability], at);
      }
      context.putImageData(pixels, 0, 0);
      this.images.redraw();
    });
    image.src = `data:image/jpeg;base64,${this.store.model.report.views[this.side].probability}`;
    return canvas;
  }
}
