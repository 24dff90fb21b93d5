// The curves in the other views of their series: how far they lie from the lines there, and beside a tomogram.

import { spots } from "./charts";
import { css } from "./colour";
import type { Series, SeriesView, Tomogram, ViewPicture } from "./data";
import { fileName, quantile } from "./data";
import { h, s, tick } from "./dom";
import { degrees, digits, fixed } from "./format";
import type { Store } from "./store";

const percent = (share: number) => `${fixed(100 * share, 0)} %`;

/** All of it; null for a report of a pair alone. */
export function series(store: Store): HTMLElement | null {
  const found = store.model.report.series;
  if (!found) return null;
  const parts: (Node | null)[] = [
    found.views.length > 0 ? h("p", { class: "hint" }, lead(found)) : null,
    found.checks.length > 0 ? h("ul", { class: "checks" }, ...found.checks.map((text) => h("li", {}, text.charAt(0).toUpperCase() + text.slice(1) + "."))) : null,
    found.views.length > 0 ? charts(found) : null,
    found.pictures.length > 0 ? pictures(store, found.pictures) : null,
    found.tomogram ? tomogram(store, found.tomogram) : null,
  ];
  return h("div", { class: "series" }, ...parts);
}

function lead({ path, fitted, views }: Series): string {
  const others = views.filter((view) => !view.in_pair && view.distances);
  const medians = others.map((view) => view.distances!.median_px);
  const median = medians.length > 0 ? ` The median distance to a detected line is ${digits(quantile(medians, 0.5), 2)} px in the middle one of the ${others.length} views beside the pair.` : "";
  const what = fitted
    ? `The curves were fitted to these ${views.length} views of ${fileName(path)} together, so the distances are residuals and not a test.`
    : `The curves are drawn into ${views.length} views of ${fileName(path)} with each view's own shift, turn and magnification; views beside the pair took no part in making them.`;
  return what + median;
}

function charts({ fitted, views }: Series): HTMLElement {
  const shown = views.filter((view) => view.distances);
  const rows = shown.map((view) => ({ view, distances: view.distances! }));
  const cards: HTMLElement[] = [];
  const add = (title: string, chart: Node, text: string) => cards.push(h("figure", { class: "card" }, h("h3", {}, title), chart, h("figcaption", {}, text)));
  if (rows.length > 0) {
    const top = Math.max(4, Math.min(12, 1.15 * quantile(rows.map(({ distances }) => distances.percent95_px), 0.9)));
    add(
      fitted ? "Residuals against tilt" : "Re-projection error against tilt",
      spots(
        "Distance of the curves to the detected lines against tilt",
        rows.map(({ view, distances }) => ({
          x: view.tilt_deg,
          y: distances.median_px,
          low: distances.median_px,
          high: distances.percent95_px,
          hollow: view.in_pair,
          text: `${degrees(view.tilt_deg)}: median ${fixed(distances.median_px, 2)} px, 95 % within ${fixed(distances.percent95_px, 1)} px`,
        })),
        [0, top],
        "tilt (\u00b0)",
        "distance to a line (px)",
        [{ value: 2, text: "2 px" }],
      ),
      "Dots: median over the points of the curves; lines up to the distance that 95 % are within, cut off at the top. Hollow: the pair.",
    );
    add(
      "Share near a line against tilt",
      spots(
        "Share of the points within 2 px and 5 px of a line against tilt",
        rows.map(({ view, distances }) => ({
          x: view.tilt_deg,
          y: 100 * distances.within_2px,
          low: 100 * distances.within_2px,
          high: 100 * distances.within_5px,
          hollow: view.in_pair,
          text: `${degrees(view.tilt_deg)}: ${percent(distances.within_2px)} within 2 px, ${percent(distances.within_5px)} within 5 px`,
        })),
        [0, 100],
        "tilt (\u00b0)",
        "share of the points (%)",
        [{ value: 100 * quantile(rows.map(({ distances }) => distances.chance_within_3px), 0.5), text: "within 3 px by chance" }],
      ),
      "Dots: within 2 px; lines up to the share within 5 px. Lines that the detector misses in a view count as far away.",
    );
  }
  const errors = views.filter((view) => view.tilt_error_deg);
  if (errors.length > 0) {
    const reach = 1.1 * Math.max(0.1, ...errors.map(({ tilt_error_deg: [error, sigma] = [0, 0] }) => Math.abs(error) + sigma));
    add(
      "Errors of the tilts",
      spots(
        "Errors of the tilts that the fit found",
        errors.map(({ tilt_deg, in_pair, tilt_error_deg: [error, sigma] = [0, 0] }) => ({
          x: tilt_deg,
          y: error,
          low: error - sigma,
          high: error + sigma,
          hollow: in_pair,
          text: `${degrees(tilt_deg)}: ${fixed(error, 3)} \u00b1 ${fixed(sigma, 3)}\u00b0`,
        })),
        [-reach, reach],
        "tilt (\u00b0)",
        "fitted less nominal (\u00b0)",
      ),
      "With one sigma. Their mean is held at zero: a common error of all tilts turns the foil and changes no image.",
    );
  }
  return h("div", {}, h("div", { class: "charts" }, ...cards), viewTable(views));
}

function viewTable(views: SeriesView[]): HTMLElement {
  const head = ["Tilt", "Points", "Median, px", "95 %, px", "Within 2 px", "Within 5 px", "3 px by chance", ""];
  const cells = ({ tilt_deg, in_pair, supported, distances: d }: SeriesView) => [
    degrees(tilt_deg),
    ...(d ? [String(d.points), fixed(d.median_px, 2), fixed(d.percent95_px, 1), percent(d.within_2px), percent(d.within_5px), percent(d.chance_within_3px)] : ["0", "", "", "", "", ""]),
    in_pair ? "of the pair" : supported ? "" : "no more than chance: its pose is a guess",
  ];
  const rows = views.map((view) => {
    const [tilt, ...others] = cells(view);
    return h("tr", {}, h("th", { scope: "row" }, tilt), ...others.map((text) => h("td", {}, text)));
  });
  return h(
    "details",
    { class: "per-view" },
    h("summary", {}, "Every view in figures"),
    h("table", { class: "figures-table" }, h("thead", {}, h("tr", {}, ...head.map((text) => h("th", { scope: "col" }, text)))), h("tbody", {}, ...rows)),
  );
}

type Rows = [number, number, number, number][];

/** Curves as polylines in a picture: each piece in the colour of its first point. */
function curvesIn(store: Store, rows: [Rows[0], Rows[1]], width: number): SVGElement {
  const { model, scale } = store;
  const at = (point: number) => rows.map(([a, b, c, d]) => a * model.position[3 * point] + b * model.position[3 * point + 1] + c * model.position[3 * point + 2] + d);
  const group = s("g", { fill: "none", "stroke-width": width, "stroke-linecap": "round", "stroke-linejoin": "round" });
  for (let curve = 0; curve < model.curveCount; curve += 1) {
    const [first, end] = [model.offset[curve], model.offset[curve + 1]];
    const length = end - first;
    const chosen = store.selected === curve;
    // Eight points a piece: depth changes little over them.
    for (let from = 0; from < length - 1; from += 8) {
      const points: string[] = [];
      for (let k = from; k <= Math.min(from + 8, length - 1); k += 1) points.push(at(first + k).map((value) => value.toFixed(1)).join(","));
      const colour = scale.colour(scale.value(first + from, curve));
      group.append(s("polyline", { points: points.join(" "), stroke: css(colour), "stroke-width": chosen ? 2.5 * width : width }));
    }
  }
  return group;
}

/** A picture in px of what it shows, with things drawn over it. */
function picture(label: string, image: string, size: [number, number], drawn: [number, number], over: SVGElement[]): SVGElement {
  return s(
    "svg",
    { viewBox: `-0.5 -0.5 ${size[0]} ${size[1]}`, role: "img", "aria-label": label },
    s("image", { href: `data:image/jpeg;base64,${image}`, x: -0.5, y: -0.5, width: drawn[0], height: drawn[1], preserveAspectRatio: "none" }),
    ...over,
  );
}

/** Sides of what an averaged picture covers: whole blocks only. */
const covered = (size: [number, number], step: number): [number, number] => [Math.max(1, Math.floor(size[0] / step)) * step, Math.max(1, Math.floor(size[1] / step)) * step];

function pictures(store: Store, found: ViewPicture[]): HTMLElement {
  const strip = h("div", { class: "strip" });
  let [showsCurves, showsLines] = [true, false];
  const draw = () => {
    const one = (view: ViewPicture) => {
      const { size_px: size, image, step_px: step, projection, lines } = view;
      const width = Math.max(...size) / 300;
      const over: SVGElement[] = [];
      if (showsLines) {
        // SVG takes numbers of points with commas throughout.
        over.push(s("g", { class: "found", fill: "none", "stroke-width": width }, ...lines.map((line) => s("polyline", { points: line.join(",") }))));
      }
      if (showsCurves) over.push(curvesIn(store, projection, width));
      return h("figure", {}, picture(`View at ${degrees(view.tilt_deg)} with the curves`, image, size, covered(size, step), over), h("figcaption", {}, degrees(view.tilt_deg)));
    };
    strip.replaceChildren(...found.map(one));
  };
  draw();
  store.on(["selection", "colour"], draw);
  const redraw = (change: () => void) => {
    change();
    draw();
  };
  return h(
    "div",
    { class: "images views" },
    h(
      "div",
      { class: "toolbar" },
      h("div", { class: "ticks", role: "group", "aria-label": "Shown in the views" }, tick("Curves", true, (on) => redraw(() => (showsCurves = on))), tick("Lines detected there", false, (on) => redraw(() => (showsLines = on)))),
      h("span", { class: "hint" }, "Curves in the colours of the 3D view"),
    ),
    strip,
  );
}

function tomogram(store: Store, found: Tomogram): HTMLElement {
  const { comparison: c, size, voxels } = found;
  const of = ([length, share]: [number, number]) => `${percent(share)} of ${fixed(length, 0)} px`;
  const rows: [string, string][] = [
    ["Tomogram", `${found.method}; ${size.join(" \u00d7 ")} voxels`],
    ["Curves with a line of the tomogram", of(c.result)],
    ["Lines of the tomogram with a curve", of(c.tomogram)],
    ["Within", `${fixed(c.reach_px[0], 0)} px across the beam and ${fixed(c.reach_px[1], 0)} px along it`],
    ["Depth", c.depth_px ? `tomogram less curves ${fixed(c.depth_px[0], 1)} px in the median; half within ${fixed(c.depth_px[1], 1)} px of that` : "nothing to compare"],
    ["Threshold", `${digits(c.threshold)}, ${digits(100 * c.share, 2)} % of the voxels: the one at which both agree best`],
  ];
  const pair = h("div", { class: "tomogram-pictures" });
  let shows = true;
  const draw = () => {
    const one = (label: string, text: string, image: string, shown: [number, number], projection: [Rows[0], Rows[1]]) => {
      const over = shows ? [curvesIn(store, projection, Math.max(...shown) / 400)] : [];
      return h("figure", {}, picture(label, image, shown, covered(shown, Math.ceil(Math.max(...shown) / 768)), over), h("figcaption", {}, text));
    };
    pair.replaceChildren(
      one("Largest value of the tomogram along the beam, with the curves", "Along the beam: largest value along z", found.above, [size[0], size[1]], [voxels[0], voxels[1]]),
      one("Largest value of the tomogram along the tilt axis, with the curves", "Along the tilt axis: largest value along y, viewer on top", found.edge, [size[0], size[2]], [voxels[0], voxels[2]]),
    );
  };
  draw();
  store.on(["selection", "colour"], draw);
  return h(
    "div",
    { class: "images views" },
    h(
      "div",
      { class: "toolbar" },
      h("h3", {}, "Beside a tomogram"),
      tick("Curves over the tomogram", true, (on) => {
        shows = on;
        draw();
      }),
    ),
    h("div", { class: "tomogram" }, pair, h("table", { class: "record" }, h("tbody", {}, ...rows.map(([name, text]) => h("tr", {}, h("th", { scope: "row" }, name), h("td", {}, text)))))),
  );
}
