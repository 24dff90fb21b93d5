// The 3D view: drag to turn, shift-drag to move, wheel to zoom, click to select, and the tilt slider.

import { MODES, type Mode, css } from "./colour";
import type { Model } from "./data";
import { choice, fitted, h, onFrame, s, tick } from "./dom";
import { degrees, ticks } from "./format";
import { drawAxes, drawRing, drawScaleBar, nearest } from "./overlay";
import { type Orientation, ORIENTATIONS, type Pose, Projector, boxOf, fittingZoom } from "./pose";
import { type Look, type Stage, type Stereo } from "./stage";
import { CanvasStage } from "./stage-canvas";
import { WebglStage } from "./stage-webgl";
import type { Store } from "./store";

const RADIAN = Math.PI / 180;
/** How near a click must be to a curve, px; fingers are wider. */
const REACH_PX = { mouse: 8, touch: 20 };
/** Turn between the eyes, degrees: that of the pair, but not so small that depth is lost nor so large that it hurts. */
const EYES_DEG = [3, 8];
/** Room for the colour bar at the right. */
const LEGEND_PX = 96;
/** Time for the tilt to go forth and back, ms. */
const ROCK_MS = 4000;

export class Viewer {
  readonly element: HTMLElement;
  readonly stage: Stage;
  readonly pose: Pose = { tilt: 0, yaw: 0, pitch: 0, zoom: 1, panX: 0, panY: 0 };
  readonly look: Look;
  /** Script time of the last frame, ms. */
  frameMs = 0;
  private readonly model: Model;
  private readonly box;
  private readonly overlay = h("canvas", { class: "overlay", "aria-hidden": "true" });
  private readonly legend = h("div", { class: "legend" });
  private readonly area = h("div", { class: "stage", tabindex: 0, role: "group", "aria-roledescription": "3D view" });
  private readonly redraw = onFrame(() => this.draw());
  private readonly screen: Float32Array;
  private screenIsOld = true;
  private width = 0;
  private height = 0;
  private fitted = true;
  private rocking = 0;
  private orientation: Orientation | null = "beam";

  constructor(private readonly store: Store) {
    this.model = store.model;
    this.box = boxOf(this.model);
    this.screen = new Float32Array(2 * this.model.pointCount);
    const input = { model: this.model, box: this.box };
    try {
      this.stage = new WebglStage(input, this.redraw);
    } catch {
      this.stage = new CanvasStage(input);
    }
    const [left, right] = this.model.report.tilts_deg;
    const between = Math.abs(right - left);
    const eyes = Math.min(EYES_DEG[1], Math.max(EYES_DEG[0], between));
    this.look = { stereo: "off", eyeAngle: (eyes / 2) * RADIAN, errorBars: false, foil: true, micrograph: true };
    this.area.setAttribute(
      "aria-label",
      `${this.model.curveCount} curves in the foil. Arrow keys turn, shift and arrow keys move, plus and minus zoom, 0 resets, page up and page down select a curve, escape selects none.`,
    );
    this.stage.canvas.setAttribute("aria-hidden", "true");
    this.area.append(this.stage.canvas, this.overlay, this.legend);
    this.element = h("div", { class: "viewer" }, this.toolbar(), this.area, this.tiltControls());
    this.listen();
    store.on(["colour"], () => {
      this.stage.recolour(store.scale);
      this.stage.emphasise(store.selected, store.hover?.curve ?? null);
      this.showLegend();
      this.redraw();
    });
    store.on(["selection", "hover"], () => {
      this.stage.emphasise(store.selected, store.hover?.curve ?? null);
      this.redraw();
    });
    this.stage.recolour(store.scale);
    this.showLegend();
    new ResizeObserver(() => this.resized()).observe(this.area);
  }

  private toolbar(): HTMLElement {
    const { store, look } = this;
    const colours = choice<Mode>("Colour by", MODES.map(({ mode, text }) => ({ value: mode, text })), store.mode, (mode) => store.colourBy(mode));
    store.on(["colour"], () => colours.show(store.mode));
    const views = choice<Orientation>(
      "Look along",
      [
        { value: "beam", text: "Beam" },
        { value: "side", text: "Side" },
        { value: "edge", text: "Edge on" },
      ],
      "beam",
      (orientation) => this.orient(orientation),
    );
    this.showOrientation = () => views.show((this.orientation ?? "") as Orientation);
    const noGlasses = this.stage.name === "canvas" ? "Needs WebGL, which this browser does not offer" : "";
    const stereo = choice<Stereo>(
      "Stereo",
      [
        { value: "off", text: "Off" },
        { value: "anaglyph", text: "Red-cyan", disabled: noGlasses },
        { value: "pair", text: "Side by side" },
      ],
      "off",
      (value) => {
        look.stereo = value;
        stereo.show(value);
        // Glasses take the colours away, and a pair needs the room.
        this.legend.hidden = value !== "off";
        if (this.fitted) this.fit();
        this.redraw();
      },
    );
    const toggle = (text: string, key: "errorBars" | "foil" | "micrograph", disabled = "") =>
      tick(text, look[key] && !disabled, (checked) => {
        look[key] = checked;
        this.redraw();
      }, disabled);
    const { foil } = this.model.report.measures;
    const noFoil = "unknown" in foil ? `The foil's surfaces are unknown: ${foil.unknown}` : "";
    return h(
      "div",
      { class: "toolbar" },
      labelled("Colour", colours.element),
      labelled("View", views.element, h("button", { type: "button", onclick: () => this.reset() }, "Reset")),
      labelled("Stereo", stereo.element),
      h(
        "div",
        { class: "ticks" },
        toggle("Error bars", "errorBars"),
        toggle("Foil surfaces", "foil", noFoil),
        toggle("Micrograph", "micrograph", noGlasses),
      ),
    );
  }

  private tiltControls(): HTMLElement {
    const tilts = this.model.report.tilts_deg;
    const [low, high] = [Math.min(...tilts), Math.max(...tilts)];
    const mid = (low + high) / 2;
    // Where the sign of depth was turned as asked, the foil turns the other way, so that both ends stay the micrographs.
    const sense = this.model.report.frame.depth_flipped ? -RADIAN : RADIAN;
    const slider = h("input", { type: "range", id: "tilt", min: low, max: high, step: 0.01, value: mid });
    const output = h("output", { for: "tilt" });
    const show = (tiltDeg: number) => {
      this.pose.tilt = (tiltDeg - mid) * sense;
      output.textContent = degrees(tiltDeg);
      this.moved();
    };
    show(mid);
    const rock = h("button", { type: "button", "aria-pressed": "false" }, "Rock");
    const stop = () => {
      cancelAnimationFrame(this.rocking);
      this.rocking = 0;
      rock.setAttribute("aria-pressed", "false");
    };
    rock.addEventListener("click", () => {
      if (this.rocking) return stop();
      rock.setAttribute("aria-pressed", "true");
      let phase = Math.asin(Math.max(-1, Math.min(1, (Number(slider.value) - mid) / ((high - low) / 2 || 1))));
      let last = performance.now();
      const step = (now: number) => {
        phase += ((now - last) / ROCK_MS) * 2 * Math.PI;
        last = now;
        slider.value = String(mid + ((high - low) / 2) * Math.sin(phase));
        show(Number(slider.value));
        this.rocking = requestAnimationFrame(step);
      };
      this.rocking = requestAnimationFrame(step);
    });
    slider.addEventListener("input", () => {
      if (this.rocking) stop();
      show(Number(slider.value));
    });
    return h(
      "div",
      { class: "tilt" },
      h("label", { for: "tilt" }, "Tilt"),
      h("span", { class: "end" }, degrees(low)),
      slider,
      h("span", { class: "end" }, degrees(high)),
      output,
      rock,
      h("span", { class: "hint" }, "drag turns, shift-drag moves, wheel zooms"),
    );
  }

  private showOrientation = () => {};

  orient(orientation: Orientation): void {
    Object.assign(this.pose, ORIENTATIONS[orientation]);
    this.orientation = orientation;
    this.fit();
    this.moved();
  }

  reset(): void {
    this.store.select(null);
    const slider = this.element.querySelector<HTMLInputElement>("#tilt")!;
    slider.value = String((Number(slider.min) + Number(slider.max)) / 2);
    slider.dispatchEvent(new Event("input"));
    this.orient("beam");
  }

  private fit(): void {
    this.fitted = true;
    if (this.width === 0) return;
    const pair = this.look.stereo === "pair";
    const legend = pair ? 0 : LEGEND_PX;
    this.pose.zoom = fittingZoom({ ...this.pose, tilt: 0 }, this.box, this.viewWidth() - legend, this.height);
    Object.assign(this.pose, { panX: -legend / 2, panY: 0 });
  }

  private resized(): void {
    const [width, height] = [this.area.clientWidth, this.area.clientHeight];
    if (this.fitted) {
      [this.width, this.height] = [width, height];
      this.fit();
    } else if (this.width > 0) {
      this.pose.zoom *= width / this.width;
      [this.width, this.height] = [width, height];
    }
    this.moved();
  }

  private moved(): void {
    this.screenIsOld = true;
    this.showOrientation();
    this.redraw();
  }

  private listen(): void {
    const { area, pose, store } = this;
    const pointers = new Map<number, { x: number; y: number }>();
    let travelled = 0;
    const place = (event: MouseEvent): [number, number] => {
      const rect = area.getBoundingClientRect();
      return [event.clientX - rect.left, event.clientY - rect.top];
    };
    const turn = (dx: number, dy: number) => {
      pose.yaw -= dx;
      pose.pitch = Math.max(-Math.PI / 2, Math.min(Math.PI / 2, pose.pitch + dy));
      this.orientation = null;
      this.moved();
    };
    const move = (dx: number, dy: number) => {
      pose.panX += dx;
      pose.panY += dy;
      this.fitted = false;
      this.moved();
    };
    const zoom = (factor: number, x: number, y: number) => {
      const bounded = Math.min(200, Math.max(0.02, (pose.zoom * factor * this.model.report.frame.pixel))) / this.model.report.frame.pixel / pose.zoom;
      const [dx, dy] = [x - this.viewWidth() / 2 - pose.panX, y - this.height / 2 - pose.panY];
      pose.zoom *= bounded;
      move(dx * (1 - bounded), dy * (1 - bounded));
    };
    area.addEventListener("pointerdown", (event) => {
      area.setPointerCapture(event.pointerId);
      pointers.set(event.pointerId, { x: event.clientX, y: event.clientY });
      travelled = pointers.size > 1 ? Infinity : 0;
    });
    area.addEventListener("pointermove", (event) => {
      const before = pointers.get(event.pointerId);
      if (!before) {
        store.point(this.pick(...place(event), REACH_PX.mouse));
        return;
      }
      const [dx, dy] = [event.clientX - before.x, event.clientY - before.y];
      travelled += Math.hypot(dx, dy);
      if (pointers.size === 2) {
        const other = [...pointers].find(([id]) => id !== event.pointerId)![1];
        const distance = (a: { x: number; y: number }) => Math.hypot(a.x - other.x, a.y - other.y) || 1;
        const rect = area.getBoundingClientRect();
        zoom(distance({ x: event.clientX, y: event.clientY }) / distance(before), (before.x + other.x) / 2 - rect.left, (before.y + other.y) / 2 - rect.top);
        move(dx / 2, dy / 2);
      } else if (event.shiftKey || event.buttons & 6) move(dx, dy);
      else if (travelled > 3) turn(dx * 0.008, dy * 0.008);
      pointers.set(event.pointerId, { x: event.clientX, y: event.clientY });
    });
    const up = (event: PointerEvent) => {
      if (!pointers.delete(event.pointerId)) return;
      if (event.type === "pointerup" && travelled <= 3) {
        const hit = this.pick(...place(event), event.pointerType === "touch" ? REACH_PX.touch : REACH_PX.mouse);
        store.select(hit?.curve ?? null);
      }
    };
    area.addEventListener("pointerup", up);
    area.addEventListener("pointercancel", up);
    area.addEventListener("pointerleave", () => store.point(null));
    area.addEventListener("contextmenu", (event) => event.preventDefault());
    area.addEventListener(
      "wheel",
      (event) => {
        event.preventDefault();
        zoom(Math.exp(-event.deltaY * (event.deltaMode === 1 ? 0.05 : 0.0015)), ...place(event));
      },
      { passive: false },
    );
    area.addEventListener("keydown", (event) => {
      const centre: [number, number] = [this.viewWidth() / 2, this.height / 2];
      const arrow = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[event.key];
      const count = this.model.curveCount;
      if (arrow && event.shiftKey) move(24 * arrow[0], 24 * arrow[1]);
      else if (arrow) turn(arrow[0] * 0.087, arrow[1] * 0.087);
      else if (event.key === "+" || event.key === "=") zoom(1.2, ...centre);
      else if (event.key === "-") zoom(1 / 1.2, ...centre);
      else if (event.key === "0" || event.key === "Home") this.reset();
      else if (event.key === "PageDown" && count) store.select(((store.selected ?? -1) + 1) % count);
      else if (event.key === "PageUp" && count) store.select(((store.selected ?? 0) + count - 1) % count);
      else if (event.key === "Escape") store.select(null);
      else return;
      event.preventDefault();
    });
  }

  private viewWidth(): number {
    return this.look.stereo === "pair" ? this.width / 2 : this.width;
  }

  private projector(): Projector {
    return new Projector(this.pose, this.box, this.viewWidth(), this.height);
  }

  /** The curve at a place of the view. */
  pick(x: number, y: number, reach: number) {
    if (this.look.stereo === "pair") return null;
    if (this.screenIsOld) {
      this.projector().placeAll(this.model.position, this.screen);
      this.screenIsOld = false;
    }
    return nearest(this.model, this.screen, x, y, reach);
  }

  /** Where a point of a curve stands in the view, px from its top left corner. */
  placeOf(point: number): [number, number] {
    const [x, y, z] = this.model.position.subarray(3 * point, 3 * point + 3);
    return this.projector().place(x, y, z);
  }

  private draw(): void {
    const { width, height, overlay } = this;
    if (width === 0 || height === 0) return;
    const start = performance.now();
    this.stage.draw(this.pose, this.look, width, height);
    const ratio = fitted(overlay, width, height);
    const context = overlay.getContext("2d")!;
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.clearRect(0, 0, width, height);
    drawScaleBar(context, this.pose.zoom, this.model.unit, 20, height - 18, 130);
    if (this.look.stereo === "off") {
      drawAxes(context, this.projector(), this.box, this.model);
      if (this.store.hover) drawRing(context, ...this.placeOf(this.store.hover.point));
    }
    this.frameMs = performance.now() - start;
  }

  private showLegend(): void {
    const { scale } = this.store;
    this.legend.replaceChildren(h("div", { class: "legend-title" }, scale.title));
    if (scale.classes) {
      for (const { colour, text, share } of scale.classes) {
        const swatch = s("svg", { width: 22, height: 8, "aria-hidden": "true" }, s("rect", { y: 2, width: 22, height: 4, rx: 2, fill: css(colour) }));
        this.legend.append(h("div", { class: "legend-class" }, swatch, `${text}, ${Math.round(100 * share)} %`));
      }
      return;
    }
    const [barHeight, barWidth] = [150, 14];
    const y = (value: number) => 8 + (barHeight * (value - scale.low)) / (scale.high - scale.low);
    // Depth grows downwards, as on the axis of the edge-on view; other quantities grow upwards.
    const at = (value: number) => (scale.mode === "depth" ? y(value) : barHeight + 16 - y(value));
    const steps = Array.from({ length: 50 }, (_, k) => scale.low + ((k + 0.5) / 50) * (scale.high - scale.low));
    const bar = s(
      "svg",
      { width: 84, height: barHeight + 16, role: "img", "aria-label": `Colour bar: ${scale.title}` },
      ...steps.map((value) => s("rect", { x: 0, y: at(value) - barHeight / 100 - 0.3, width: barWidth, height: barHeight / 50 + 0.6, fill: css(scale.colour(value)) })),
      ...ticks(scale.low, scale.high, 5).flatMap(({ value, text }) => [
        s("line", { x1: barWidth, x2: barWidth + 4, y1: at(value), y2: at(value), class: "axis" }),
        s("text", { x: barWidth + 8, y: at(value), dy: "0.35em" }, text),
      ]),
    );
    this.legend.append(bar);
    if (scale.mode === "depth") this.legend.append(h("div", { class: "legend-note" }, "+ is away", h("br"), "from the viewer"));
  }
}

export function labelled(text: string, ...children: HTMLElement[]): HTMLElement {
  return h("div", { class: "labelled" }, h("span", { class: "label", "aria-hidden": "true" }, text), ...children);
}
