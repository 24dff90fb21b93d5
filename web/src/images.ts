// Both rectified images with one zoom: what was detected, matched and measured drawn over them, and a line across
// both under the pointer, since a point and its match lie on the same row.

import { type Rgb, css } from "./colour";
import type { Model } from "./data";
import { choice, fitted, h, onFrame, s, tick } from "./dom";
import { ticks } from "./format";
import { drawRing, drawScaleBar, nearest } from "./overlay";
import { type Store, token } from "./store";
import { labelled } from "./viewer";

type Layout = "both" | "blink";
type Overlay = "probability" | "lines" | "curves" | "matches" | "disparity";

const BLINK_MS = 700;
const REACH_PX = 9;
/** Colours that a scale is cut into, so that a thousand curves are a few dozen strokes. */
const SHADES = 48;
/** Points of a curve between two bars of disparity. */
const DISPARITY_STEP = 8;
/** Screen px a curve's line is wide. */
const LINE_PX = 2;

const OVERLAYS: { key: Overlay; text: string }[] = [
  { key: "curves", text: "Curves" },
  { key: "lines", text: "Detected lines" },
  { key: "probability", text: "Line probability" },
  { key: "matches", text: "Point matches" },
  { key: "disparity", text: "Disparity" },
];

/** Colours over grey images: with all of them, no two are only told apart by red and green. */
const DETECTED = "#ffffff";
const UNMATCHED = "#ffb000";
const PROBABLE: Rgb = [255, 140, 26];
const MATCH = "#ffd75e";
const [NEARER, FARTHER] = ["#6fb7f0", "#f1a340"];
/** What an overlay shows, with the colour that means it; curves have the colour bar. */
const KEYS: Record<Overlay, { colour: string; text: string }[]> = {
  curves: [],
  lines: [
    { colour: DETECTED, text: "detected in this image" },
    { colour: UNMATCHED, text: "without a match" },
  ],
  probability: [{ colour: css(PROBABLE), text: "line probability" }],
  matches: [{ colour: MATCH, text: "point matches of the rectification" }],
  disparity: [
    { colour: NEARER, text: "disparity below zero, at its length" },
    { colour: FARTHER, text: "above zero" },
  ],
};

/** Curves of one colour: lines that were measured, and those that were not. */
interface Shade {
  colour: string;
  sound: Path2D;
  doubtful: Path2D;
}

export class Images {
  readonly element: HTMLElement;
  /** Screen px per rectified px, and the rectified point in the middle of a panel. */
  readonly view = { zoom: 1, x: 0, y: 0 };
  layout: Layout = "both";
  private readonly model: Model;
  private readonly shown: Record<Overlay, boolean> = { curves: true, lines: false, probability: false, matches: false, disparity: false };
  private opacity = 0.9;
  private readonly panels: Panel[];
  private readonly row: HTMLElement;
  private readonly key = h("div", { class: "key" });
  private readonly readout = h("div", { class: "readout", role: "status" });
  /** Row and column under the pointer, rectified px. */
  private pointer: { x: number; y: number } | null = null;
  private blinkShowsRight = false;
  private blinking = 0;
  private fittedToPanel = true;
  readonly redraw = onFrame(() => this.panels.forEach((panel) => panel.draw()));

  constructor(private readonly store: Store) {
    this.model = store.model;
    this.panels = [0, 1].map((side) => new Panel(this, store, side));
    this.row = h("div", { class: "panels" }, ...this.panels.map((panel) => panel.element));
    this.element = h("div", { class: "images" }, this.toolbar(), this.row, h("div", { class: "below" }, this.readout, this.key));
    this.showKey();
    store.on(["colour"], () => {
      this.showKey();
      this.panels.forEach((panel) => panel.recolour());
      this.redraw();
    });
    store.on(["selection", "hover"], () => this.redraw());
    new ResizeObserver(() => {
      if (this.fittedToPanel) this.fit();
      this.redraw();
    }).observe(this.row);
    this.say();
  }

  private toolbar(): HTMLElement {
    const layouts = choice<Layout>(
      "Layout",
      [
        { value: "both", text: "Side by side" },
        { value: "blink", text: "Blink" },
      ],
      "both",
      (layout) => {
        layouts.show(layout);
        this.setLayout(layout);
      },
    );
    const ticks = OVERLAYS.map(({ key, text }) =>
      tick(text, this.shown[key], (checked) => {
        this.shown[key] = checked;
        this.showKey();
        this.redraw();
      }),
    );
    const slider = h("input", { type: "range", id: "opacity", min: 0, max: 1, step: 0.05, value: this.opacity });
    slider.addEventListener("input", () => {
      this.opacity = Number(slider.value);
      this.redraw();
    });
    const zoomed = (factor: number) => () => this.zoom(factor, this.view.x, this.view.y);
    return h(
      "div",
      { class: "toolbar" },
      labelled("Layout", layouts.element),
      labelled(
        "Zoom",
        h("button", { type: "button", "aria-label": "Zoom out", onclick: zoomed(1 / 1.5) }, "\u2212"),
        h("button", { type: "button", "aria-label": "Zoom in", onclick: zoomed(1.5) }, "+"),
        h("button", { type: "button", onclick: () => this.fit() }, "Fit"),
      ),
      h("div", { class: "ticks" }, ...ticks),
      h("div", { class: "labelled" }, h("label", { class: "label", for: "opacity" }, "Opacity"), slider),
    );
  }

  /** What the colours mean. */
  private showKey(): void {
    const parts: Node[] = OVERLAYS.filter(({ key }) => this.shown[key]).flatMap(({ key }) =>
      KEYS[key].map(({ colour, text }) => {
        const line = s("line", { x1: 1, x2: 19, y1: 5, y2: 5, "stroke-width": 3, stroke: colour });
        const sample = s("svg", { width: 20, height: 10, "aria-hidden": "true" }, s("rect", { width: 20, height: 10, rx: 2, fill: "#565b61" }), line);
        return h("span", { class: "sample" }, sample, text);
      }),
    );
    if (this.shown.curves) parts.push(colourStrip(this.store));
    this.key.replaceChildren(...parts);
  }

  private setLayout(layout: Layout): void {
    this.layout = layout;
    this.row.classList.toggle("blink", layout === "blink");
    window.clearInterval(this.blinking);
    this.blinkShowsRight = false;
    const flip = () => {
      this.panels.forEach((panel) => (panel.element.hidden = layout === "blink" && (panel.side === 1) !== this.blinkShowsRight));
      this.redraw();
    };
    flip();
    if (layout === "blink") {
      this.blinking = window.setInterval(() => {
        this.blinkShowsRight = !this.blinkShowsRight;
        flip();
      }, BLINK_MS);
    }
    this.fit();
  }

  isShown(overlay: Overlay): boolean {
    return this.shown[overlay] && this.opacity > 0;
  }

  get overlayOpacity(): number {
    return this.opacity;
  }

  get rowUnderPointer(): number | null {
    return this.pointer?.y ?? null;
  }

  /** Shows the whole of both images. */
  fit(): void {
    const panel = this.panels.find((panel) => !panel.element.hidden) ?? this.panels[0];
    const [rows, columns] = this.model.report.rectification.shape;
    const [width, height] = panel.size();
    if (width === 0) return;
    this.fittedToPanel = true;
    Object.assign(this.view, { zoom: Math.min(width / columns, height / rows), x: (columns - 1) / 2, y: (rows - 1) / 2 });
    this.redraw();
  }

  zoom(factor: number, x: number, y: number): void {
    const { view } = this;
    const bounded = Math.min(40, Math.max(0.05, view.zoom * factor)) / view.zoom;
    view.zoom *= bounded;
    // The point (x, y) stays where it is.
    view.x = x + (view.x - x) / bounded;
    view.y = y + (view.y - y) / bounded;
    this.fittedToPanel = false;
    this.redraw();
  }

  move(dx: number, dy: number): void {
    this.view.x -= dx / this.view.zoom;
    this.view.y -= dy / this.view.zoom;
    this.fittedToPanel = false;
    this.redraw();
  }

  pointAt(pointer: { x: number; y: number } | null, side: number): void {
    this.pointer = pointer;
    this.store.point(pointer ? nearest(this.model, this.panels[side].screen(), pointer.x, pointer.y, REACH_PX / this.view.zoom) : null);
    this.say();
    this.redraw();
  }

  private say(): void {
    const { hover } = this.store;
    if (!this.pointer) {
      this.readout.textContent = "Move the pointer over an image: the line marks the same row in both.";
      return;
    }
    const place = `column ${Math.round(this.pointer.x)}, row ${Math.round(this.pointer.y)}`;
    if (!hover) {
      this.readout.textContent = place;
      return;
    }
    const z = this.model.position[3 * hover.point + 2];
    const text = `curve ${hover.curve}: disparity ${this.model.disparity[hover.point].toFixed(2)} ± ${this.model.sigmaDisparity[hover.point].toFixed(2)} px, z ${z.toFixed(1)} ± ${this.model.sigmaZ[hover.point].toFixed(1)} ${this.model.unit}`;
    this.readout.textContent = `${place}; ${text.replace(/-(\d)/g, "\u2212$1")}`;
  }
}

/** The colours of the curves along a line, with their ends in figures. */
function colourStrip({ scale }: Store): HTMLElement {
  if (scale.classes) {
    const samples = scale.classes.map(({ colour, text }) =>
      h("span", { class: "sample" }, s("svg", { width: 20, height: 10, "aria-hidden": "true" }, s("rect", { width: 20, height: 10, rx: 2, fill: css(colour) })), text),
    );
    return h("span", { class: "sample" }, ...samples);
  }
  const [width, count] = [130, 40];
  const x = (value: number) => (width * (value - scale.low)) / (scale.high - scale.low);
  const bar = Array.from({ length: count }, (_, k) => {
    const colour = scale.colour(scale.low + ((k + 0.5) / count) * (scale.high - scale.low));
    return s("rect", { x: (k * width) / count, y: 2, width: width / count + 0.5, height: 9, fill: css(colour) });
  });
  const marks = ticks(scale.low, scale.high, 3).map(({ value, text }) => s("text", { x: x(value), y: 23, "text-anchor": "middle" }, text));
  const strip = s("svg", { width: width + 40, height: 26, viewBox: `-20 0 ${width + 40} 26`, role: "img", "aria-label": `Colour bar: ${scale.title}` }, ...bar, ...marks);
  return h("span", { class: "sample" }, scale.title, strip);
}

/** One image. */
class Panel {
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
    const place = (event: MouseEvent) => {
      const rect = canvas.getBoundingClientRect();
      const [width, height] = this.size();
      const { zoom, x, y } = images.view;
      return { x: x + (event.clientX - rect.left - width / 2) / zoom, y: y + (event.clientY - rect.top - height / 2) / zoom };
    };
    let from: { x: number; y: number } | null = null;
    let travelled = 0;
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      from = { x: event.clientX, y: event.clientY };
      travelled = 0;
    });
    canvas.addEventListener("pointermove", (event) => {
      if (from) {
        travelled += Math.hypot(event.clientX - from.x, event.clientY - from.y);
        images.move(event.clientX - from.x, event.clientY - from.y);
        from = { x: event.clientX, y: event.clientY };
      }
      images.pointAt(place(event), this.side);
    });
    canvas.addEventListener("pointerup", (event) => {
      if (from && travelled <= 3) {
        images.pointAt(place(event), this.side);
        this.store.select(this.store.hover?.curve ?? null);
      }
      from = null;
    });
    canvas.addEventListener("pointercancel", () => (from = null));
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
