// Colour maps (viridis, cividis: perceptually uniform, colour-blind safe, CC0) and what the curves are coloured by.

import { FLAG_TEXTS, type Model, quantile } from "./data";

export type Rgb = [number, number, number];
export type Mode = "depth" | "sigma" | "length" | "flag";
export const MODES: { mode: Mode; text: string }[] = [
  { mode: "depth", text: "Depth" },
  { mode: "sigma", text: "Sigma" },
  { mode: "length", text: "Length" },
  { mode: "flag", text: "Flag" },
];

const parse = (hex: string): Rgb[] =>
  hex.match(/.{6}/g)!.map((code) => [0, 2, 4].map((at) => parseInt(code.slice(at, at + 2), 16)) as Rgb);

const VIRIDIS = parse(
  "44015448186a472d7b4240863b528b33638d2c728e26828e21918c1fa08828ae803fbc735ec96284d44baddc30d8e219fde725",
);
const CIVIDIS = parse(
  "00224e002e6a1a386f32436d434e6c535a6d61656f6f70737d7c788c88789b9476aba072bcae6ccdbb63dec958f0d846fee838",
);
/** Okabe and Ito's colours that can be told apart by all: measured, along the rows, bridged. */
const FLAG_COLOURS = { light: parse("0072b2d55e009a6a8a"), dark: parse("56b4e9e69f00cc79a7") };
/** Blue, grey, orange for residuals, whose zero means something. */
const DIVERGING = { light: parse("2166ac8a8f98b35806"), dark: parse("6fb7f09aa0a8f1a340") };

function sample(map: Rgb[], fraction: number): Rgb {
  const at = Math.min(Math.max(fraction, 0), 1) * (map.length - 1);
  const index = Math.min(Math.floor(at), map.length - 2);
  const t = at - index;
  return [0, 1, 2].map((c) => Math.round(map[index][c] * (1 - t) + map[index + 1][c] * t)) as Rgb;
}

/** The ends of a map that would vanish on the page's ground are left out. */
const SHOWN: Record<Theme, [number, number]> = { light: [0, 0.93], dark: [0.12, 1] };
export type Theme = "light" | "dark";

export const css = ([r, g, b]: Rgb): string => `rgb(${r},${g},${b})`;

/** How a quantity becomes a colour. */
export interface Scale {
  mode: Mode;
  title: string;
  /** Ends of the colour map; outside, its end colours hold. */
  low: number;
  high: number;
  colour(value: number): Rgb;
  /** Value of a point. */
  value(point: number, curve: number): number;
  /** For flags, which have no range: a colour and its words each. */
  classes?: { colour: Rgb; text: string; share: number }[];
}

export function scaleOf(model: Model, mode: Mode, theme: Theme): Scale {
  const [from, to] = SHOWN[theme];
  const { measures } = model.report;
  const ranged = (title: string, map: Rgb[], low: number, high: number, value: Scale["value"]): Scale => {
    const spare = high - low > 1e-9 * (Math.abs(high) + 1) ? 0 : model.report.frame.pixel / 2;
    const [bottom, range] = [low - spare, high - low + 2 * spare];
    const colour = (v: number) => sample(map, from + (to - from) * Math.min(Math.max((v - bottom) / range, 0), 1));
    return { mode, title, low: bottom, high: bottom + range, colour, value };
  };
  switch (mode) {
    case "depth": {
      const { low, high } = measures.depth ?? { low: 0, high: 0 };
      return ranged(`Depth z (${model.unit})`, VIRIDIS, low, high, (point) => model.position[3 * point + 2]);
    }
    case "sigma":
      return ranged(`Sigma of depth (${model.unit})`, CIVIDIS, 0, quantile(model.sigmaZ, 0.95), (p) => model.sigmaZ[p]);
    case "length": {
      const lengths = measures.per_curve.map((curve) => curve.length);
      return ranged(`Length of curve (${model.unit})`, CIVIDIS, 0, quantile(lengths, 0.98), (_, curve) => lengths[curve]);
    }
    case "flag": {
      const colours = FLAG_COLOURS[theme];
      const counts = [0, 0, 0];
      model.flag.forEach((flag) => (counts[flag] += 1));
      const share = (flag: number) => counts[flag] / Math.max(1, model.pointCount);
      const classes = FLAG_TEXTS.map((text, flag) => ({ colour: colours[flag], text, share: share(flag) }));
      return { mode, title: "Flag", low: 0, high: 2, colour: (v) => colours[v], value: (p) => model.flag[p], classes };
    }
  }
}

/** Colour of a signed residual, -1 to 1. */
export function diverging(fraction: number, theme: Theme): Rgb {
  return sample(DIVERGING[theme], 0.5 + 0.5 * fraction);
}
