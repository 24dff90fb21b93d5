// What draws the foil: WebGL, and where it is missing a plain canvas.

import type { Scale } from "./colour";
import type { Model } from "./data";
import type { Box, Pose } from "./pose";

export type Stereo = "off" | "anaglyph" | "pair";

export interface Look {
  stereo: Stereo;
  /** Turn of each eye's view from the middle one, rad. */
  eyeAngle: number;
  errorBars: boolean;
  foil: boolean;
  micrograph: boolean;
}

/** Points between two error bars: bars on every point would be a grey mass. */
export const ERROR_BAR_STEP = 12;

export interface Stage {
  readonly canvas: HTMLCanvasElement;
  readonly name: "webgl" | "canvas";
  /** Draw calls of the last frame. */
  drawCalls: number;
  recolour(scale: Scale): void;
  /** The curves to stand out: the selected one and the one under the pointer. */
  emphasise(selected: number | null, hovered: number | null): void;
  draw(pose: Pose, look: Look, width: number, height: number): void;
}

export interface StageInput {
  model: Model;
  box: Box;
}

/** The points of error bars: z less and plus one sigma. */
export function errorBars(model: Model): Float32Array {
  const bars: number[] = [];
  for (let curve = 0; curve < model.curveCount; curve += 1) {
    for (let point = model.offset[curve]; point < model.offset[curve + 1]; point += ERROR_BAR_STEP) {
      const [x, y, z] = model.position.subarray(3 * point, 3 * point + 3);
      bars.push(x, y, z - model.sigmaZ[point], x, y, z + model.sigmaZ[point]);
    }
  }
  return Float32Array.from(bars);
}
