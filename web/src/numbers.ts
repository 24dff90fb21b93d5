// What was measured, in figures and charts, and what is to be doubted about it.

import { bars, histogram, map } from "./charts";
import { type Scale, diverging, scaleOf } from "./colour";
import { type Model, fileName, quantile } from "./data";
import { h } from "./dom";
import { degrees, digits, fixed, scientific, short, tickStep, unitText, withError } from "./format";
import type { Store } from "./store";

const BINS = 40;

/** The figures a reader looks for first. */
export function keyFigures(model: Model): HTMLElement {
  const { measures, frame } = model.report;
  const unit = model.unit;
  const figure = (name: string, value: string, small: string) =>
    h("div", { class: "figure" }, h("dt", {}, name), h("dd", {}, h("span", { class: "value" }, value), h("span", { class: "small" }, small)));
  const depth = measures.depth;
  const { foil, density } = measures;
  return h(
    "dl",
    { class: "figures" },
    figure("Curves", String(measures.curves), "found in both images"),
    figure("Length", `${withError(measures.total_length, measures.total_length_sigma)} ${unit}`, "in the foil, one sigma"),
    figure(
      "Depth",
      depth ? `${digits(depth.low)} to ${digits(depth.high)} ${unit}` : "none",
      depth ? `95 % of the length; sigma ${digits(depth.sigma_z, 2)} ${unit}, and ${digits(100 * frame.relative_tilt_error, 2)} % of all` : "no curves",
    ),
    "known" in foil
      ? figure("Foil thickness", `${digits(foil.known.thickness)} ${unit}`, `95 %: ${digits(foil.known.thickness_interval[0])} to ${digits(foil.known.thickness_interval[1])} ${unit}`)
      : figure("Foil thickness", "Unknown", foil.unknown),
    "known" in density
      ? figure("Line density", `${scientific(density.known.value)} ${unitText(density.known.unit)}`, `95 %: ${scientific(density.known.low)} to ${scientific(density.known.high)}; a lower bound`)
      : figure("Line density", "Unknown", density.unknown),
  );
}

/** The line under the title. */
export function subtitle(model: Model): string {
  const { tilts_deg, frame, rectification } = model.report;
  const pixel = frame.unit === "nm" ? `${short(frame.pixel)} nm per pixel` : "pixel size unknown, so lengths are in px";
  return `Tilts ${degrees(tilts_deg[0])} and ${degrees(tilts_deg[1])} · ${pixel} · ${rectification.shape[1]} × ${rectification.shape[0]} px`;
}

/** What no pair of images can tell, in a sentence. */
export function caveat(model: Model): string {
  const { frame, measures } = model.report;
  const sign = frame.depth_flipped ? "its sign was turned as asked" : "its sign follows the tilts as given";
  const note = "known" in measures.density ? ` Density is a ${measures.density.known.note}.` : "";
  return `Depth is relative (a shift of one image cannot be seen), and ${sign}: no number of projections can check it.${note}`;
}

/** Warnings of the run, a sentence each; the program says with the numbers what to do. */
export function warnings(model: Model): HTMLElement | null {
  const found = model.report.warnings;
  if (found.length === 0) return null;
  // As a sentence.
  const sentence = (text: string) => text.charAt(0).toUpperCase() + text.slice(1).replaceAll(" +- ", " ± ") + (text.endsWith(".") ? "" : ".");
  return h(
    "details",
    { class: "warnings", open: true },
    h("summary", {}, found.length === 1 ? "One thing to know before you trust a number" : `${found.length} things to know before you trust a number`),
    h("ul", {}, ...found.map(({ stage, message }) => h("li", {}, h("span", { class: "stage-name" }, stage), sentence(message)))),
  );
}

/** A round range about the values, in bins of a round width. */
function binned(values: ArrayLike<number>, weights: ArrayLike<number> | null, low: number, high: number) {
  const step = tickStep(Math.max(high - low, 1e-9), BINS);
  const from = Math.floor(low / step) * step;
  return histogram(values, weights, from, Math.max(Math.ceil(high / step) * step, from + step), Math.max(1, Math.round((Math.ceil(high / step) * step - from) / step)));
}

/** Histograms of depth, sigma and row residual, and the residuals over the image. */
export function charts(store: Store): HTMLElement {
  const { model } = store;
  const { report, unit } = model;
  const element = h("div", { class: "charts" });
  const draw = () => {
    const depths = Float32Array.from({ length: model.pointCount }, (_, point) => model.position[3 * point + 2]);
    const parts: HTMLElement[] = [];
    const add = (title: string, chart: Node, text: string) => parts.push(h("figure", { class: "card" }, h("h3", {}, title), chart, h("figcaption", {}, text)));
    const range = (scale: Scale) => (value: number) => scale.colour(value);
    if (model.pointCount > 0) {
      const foil = report.measures.foil;
      const marks =
        "known" in foil
          ? [
              { value: foil.known.surfaces.z_near, text: "near surface" },
              { value: foil.known.surfaces.z_far, text: "far surface" },
            ]
          : [];
      const [low, high] = [quantile(depths, 0.001), quantile(depths, 0.999)];
      add(
        "Depth",
        bars(
          "Histogram of depth",
          binned(depths, model.weight, Math.min(low, ...marks.map((mark) => mark.value)), Math.max(high, ...marks.map((mark) => mark.value))),
          range(scaleOf(model, "depth", store.theme)),
          `depth z (${unit}), + away from viewer`,
          `length (${unit})`,
          marks,
        ),
        marks.length > 0 ? "Projected length of line in each range of depth, and the foil's surfaces at the middle of the image." : "Projected length of line in each range of depth.",
      );
      const median = report.measures.depth?.sigma_z ?? 0;
      add(
        "Sigma of depth",
        bars(
          "Histogram of the sigma of depth",
          binned(model.sigmaZ, model.weight, 0, Math.max(quantile(model.sigmaZ, 0.98), 1.5 * median)),
          range(scaleOf(model, "sigma", store.theme)),
          `one sigma of z (${unit})`,
          `length (${unit})`,
          [{ value: median, text: `median ${digits(median, 2)} ${unit}` }],
        ),
        `Without the error of the tilt angle, which scales all depths by one factor (one sigma: ${digits(100 * report.frame.relative_tilt_error, 2)} %).`,
      );
    }
    const { x, y, row } = report.point_matches;
    const { rms_row_error_px: rms, shape } = report.rectification;
    if (row.length > 0) {
      const reach = Math.max(...row.map(Math.abs), 0.1);
      const limit = Math.max(2 * rms, 1e-6);
      const colour = (value: number) => diverging(Math.min(1, Math.max(-1, value / limit)), store.theme);
      add(
        "Row residuals",
        bars("Histogram of row residuals", binned(row, null, -reach, reach), colour, "row in right less row in left (px)", "point matches", [
          { value: -rms, text: "\u2212rms" },
          { value: rms, text: `rms ${digits(rms, 2)} px` },
        ]),
        `${row.length} of ${report.rectification.matches} point matches agree with one geometry. What is left is mostly the error of the points; rows are good to ${digits(report.rectification.sigma_row_px, 2)} px.`,
      );
      const points = x.map((column, k) => ({ x: column, y: y[k], colour: colour(row[k]), text: `column ${fixed(column, 0)}, row ${fixed(y[k], 0)}: ${fixed(row[k], 2)} px` }));
      add(
        "Row residuals over the image",
        map("Row residuals over the left image", points, shape),
        `Blue: right point above its row, orange: below, grey: on it; full colour at ${digits(limit, 2)} px. Patches of one colour would mean distortion or drift.`,
      );
    }
    element.replaceChildren(...parts);
  };
  draw();
  store.on(["theme"], draw);
  return element;
}

/** Everything about the run that a methods section needs. */
export function runRecord(model: Model): HTMLElement {
  const { report } = model;
  const { rectification, sources, tilts_deg, views, measures, frame } = report;
  const axis = `${degrees(rectification.axis_deg)} ± ${fixed(rectification.axis_sigma_deg, 2)}°${rectification.axis_held_by_prior ? ", as given: the points do not show it" : ""}`;
  const rows: [string, string][] = [
    ["Left", `${sources[0].path || "image in memory"}, tilt ${degrees(tilts_deg[0])}`],
    ["Right", `${sources[1].path || "image in memory"}, tilt ${degrees(tilts_deg[1])}`],
    ["Pixel", frame.unit === "nm" ? `${short(frame.pixel)} nm, of the left image` : "unknown"],
    ["Tilt axis", `${axis}, clockwise from the image's vertical`],
    ["Right to left", `turned by ${degrees(rectification.relative_rotation_deg, 3)}, magnified by ${fixed(rectification.relative_scale, 4)}`],
    ["Point matches", `${rectification.inliers} of ${rectification.matches} agree; rows to ${digits(rectification.rms_row_error_px, 2)} px rms`],
    ["Detected lines", `${views[0].lines.length} left (${fixed(views[0].length_px[0], 0)} px), ${views[1].lines.length} right (${fixed(views[1].length_px[0], 0)} px)`],
    ["Without a match", `${fixed(views[0].length_px[1], 0)} px left, ${fixed(views[1].length_px[1], 0)} px right`],
    ["Doubtful length", `${fixed(100 * measures.doubtful_share, 1)} % bridged or along the rows`],
    ["Program", `Tiltline ${report.program}`],
  ];
  return h(
    "div",
    { class: "run" },
    h("table", { class: "record" }, h("tbody", {}, ...rows.map(([name, text]) => h("tr", {}, h("th", { scope: "row" }, name), h("td", {}, text))))),
    h(
      "details",
      {},
      h("summary", {}, "Settings, versions, hashes and timings (run.toml)"),
      h("pre", { tabindex: 0, "aria-label": "run.toml" }, report.run),
    ),
  );
}

/** Names of both files. */
export function title(model: Model): string {
  return model.report.sources.map((source) => fileName(source.path)).join(" and ");
}
