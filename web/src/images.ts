// Both rectified images with one zoom: what was detected, matched and measured drawn over them, and a line across
// both under the pointer, since a point and its match lie on the same row.

import { css } from "./colour";
import type { Model } from "./data";
import { choice, h, onFrame, s, tick } from "./dom";
import { ticks } from "./format";
import { nearest } from "./overlay";
import { DETECTED, FARTHER, MATCH, NEARER, PROBABLE, Panel, UNMATCHED } from "./panel";
import type { Store } from "./store";
import { labelled } from "./viewer";

type Layout = "both" | "blink";
type Overlay = "probability" | "lines" | "curves" | "matches" | "disparity";

const BLINK_MS = 700;
const REACH_PX = 9;

const OVERLAYS: { key: Overlay; text: string }[] = [
  { key: "curves", text: "Curves" },
  { key: "lines", text: "Detected lines" },
  { key: "probability", text: "Line probability" },
  { key: "matches", text: "Point matches" },
  { key: "disparity", text: "Disparity" },
];

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
