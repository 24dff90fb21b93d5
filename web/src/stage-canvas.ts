// The foil on a plain canvas, for browsers without WebGL: the same projection, far curves first.

import { type Scale, css } from "./colour";
import { fitted, h } from "./dom";
import { type Pose, Projector, corners, rotation, surfaceCorners } from "./pose";
import { type Look, type Stage, type StageInput, errorBars } from "./stage";
import { token } from "./store";

export class CanvasStage implements Stage {
  readonly canvas = h("canvas");
  readonly name = "canvas";
  drawCalls = 0;
  private colours: string[] = [];
  private emphasis: { curve: number; colour: string }[] = [];
  private readonly screen: Float32Array;
  private readonly bars: Float32Array;

  constructor(private readonly input: StageInput) {
    this.screen = new Float32Array(2 * input.model.pointCount);
    this.bars = errorBars(input.model);
  }

  recolour(scale: Scale): void {
    const { model } = this.input;
    this.colours = Array.from(model.segmentCurve, (curve, segment) => css(scale.colour(scale.value(model.segments[2 * segment], curve))));
  }

  emphasise(selected: number | null, hovered: number | null): void {
    this.emphasis = [];
    if (hovered !== null && hovered !== selected) this.emphasis.push({ curve: hovered, colour: token("muted") });
    if (selected !== null) this.emphasis.push({ curve: selected, colour: token("mark") });
  }

  draw(pose: Pose, look: Look, width: number, height: number): void {
    const ratio = fitted(this.canvas, width, height);
    const context = this.canvas.getContext("2d");
    if (!context) return;
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.fillStyle = token("stage");
    context.fillRect(0, 0, width, height);
    this.drawCalls = 0;
    if (look.stereo === "off") {
      this.view(context, pose, look, width, height);
      return;
    }
    // Red-cyan needs WebGL; side by side does not.
    [-1, 1].forEach((side, index) => {
      context.save();
      context.beginPath();
      context.rect((index * width) / 2, 0, width / 2, height);
      context.clip();
      context.translate((index * width) / 2, 0);
      this.view(context, { ...pose, eye: side * look.eyeAngle }, look, width / 2, height);
      context.restore();
    });
  }

  private view(context: CanvasRenderingContext2D, pose: Pose, look: Look, width: number, height: number): void {
    const { model, box } = this.input;
    const projector = new Projector(pose, box, width, height);
    const stroke = (colour: string, lineWidth: number, alpha: number, path: () => void) => {
      context.globalAlpha = alpha;
      context.strokeStyle = colour;
      context.lineWidth = lineWidth;
      context.beginPath();
      path();
      context.stroke();
      context.globalAlpha = 1;
      this.drawCalls += 1;
    };
    const line = (a: number[], b: number[]) => {
      context.moveTo(...projector.place(a[0], a[1], a[2]));
      context.lineTo(...projector.place(b[0], b[1], b[2]));
    };
    context.lineCap = "round";
    const points = corners(box);
    stroke(token("ink"), 1, 0.28, () => {
      for (let a = 0; a < 8; a += 1) for (const axis of [0, 1, 2]) if (!(a & (1 << axis))) line(points[a], points[a | (1 << axis)]);
    });
    const foil = model.report.measures.foil;
    if (look.foil && "known" in foil) {
      context.fillStyle = token("accent");
      context.globalAlpha = 0.14;
      for (const surface of surfaceCorners(box, foil.known.surfaces)) {
        context.beginPath();
        surface.forEach((corner) => context.lineTo(...projector.place(...corner)));
        context.fill();
      }
      context.globalAlpha = 1;
    }
    projector.placeAll(model.position, this.screen);
    const away = rotation(pose)[2];
    const depth = (segment: number) => {
      const at = 3 * model.segments[2 * segment];
      return away[0] * model.position[at] + away[1] * model.position[at + 1] + away[2] * model.position[at + 2];
    };
    const segment = (index: number) => {
      const [a, b] = [model.segments[2 * index], model.segments[2 * index + 1]];
      context.moveTo(this.screen[2 * a], this.screen[2 * a + 1]);
      context.lineTo(this.screen[2 * b], this.screen[2 * b + 1]);
    };
    for (const { curve, colour } of this.emphasis) {
      stroke(colour, 8, 1, () => model.segmentCurve.forEach((owner, index) => owner === curve && segment(index)));
    }
    const order = Array.from(model.segmentCurve.keys());
    const depths = order.map(depth);
    order.sort((a, b) => depths[b] - depths[a]);
    for (const index of order) stroke(this.colours[index], 2.4, 1, () => segment(index));
    if (look.errorBars) {
      stroke(token("ink"), 1, 0.6, () => {
        for (let at = 0; at < this.bars.length; at += 6) line([...this.bars.subarray(at, at + 3)], [...this.bars.subarray(at + 3, at + 6)]);
      });
    }
  }
}
