// The curves in the other views of their series: how far they lie from the lines there, and beside a tomogram.

import { spots } from "./charts";
import { css } from "./colour";
import { type Row, type Series, type SeriesView, type Tomogram, type ViewPicture, fileName, quantile } from "./data";
import { h, s, tick } from "./dom";
import { degrees, digits, fixed } from "./format";
import type { Store } from "./store";

const percent = (share: number) => `${fixed(100 * share, 0)} %`;

/** All of it; null for a report of a pair alone. */
export function series(store: Store): HTMLElement | null {
  const found = store.model.report.series;
  if (!found) return null;
  const said = [...found.checks, ...(found.warnings ?? []).map(({ message }) => message)];
  const parts: (Node | null)[] = [
    found.views.length > 0 ? h("p", { class: "hint" }, lead(found)) : null,
    said.length > 0 ? h("ul", { class: "checks" }, ...said.map((text) => h("li", {}, `${text.charAt(0).toUpperCase()}${text.slice(1)}.`))) : null,
    found.views.length > 0 ? charts(found) : null,
    found.pictures.length > 0 ? pictures(store, found.pictures) : null,
    found.tomogram ? tomogram(store, found.tomogram) : null,
  ];
  return h("div", { class: "series" }, ...parts.filter((part) => part !== null));
}

function lead({ path, fitted, views }: Series): string {
  const others = views.filter((view) => !view.in_pair && view.distances);
  const medians = others.map((view) => view.distances!.median_px);
  const median = medians.length > 0 ? ` In a typical view beside the pair the median distance to a detected line is ${digits(quantile(medians, 0.5), 2)} px (median of ${others.length} views).` : "";
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
      `Dots: median over the points of the curves; lines up to the distance that 95 % are within. What lies above ${digits(top)} px is drawn at the top. Hollow: the pair.`,
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
        [{ value: 100 * quantile(rows.map(({ distances }) => distances.chance_within_3px), 0.5), text: "by chance within 3 px" }],
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
      "With one sigma, mostly that of the goniometer (0.1\u00b0), to which the fit holds them. Their mean is held at zero: a common error of all tilts turns the foil and changes no image.",
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

/** Curves as polylines in a picture, and what colours them again. */
function curvesIn(store: Store, rows: [Row, Row], width: number): { group: SVGElement; colour: () => void } {
  const { model } = store;
  const at = (point: number) => rows.map(([a, b, c, d]) => a * model.position[3 * point] + b * model.position[3 * point + 1] + c * model.position[3 * point + 2] + d);
  const group = s("g", { fill: "none", "stroke-width": width, "stroke-linecap": "round", "stroke-linejoin": "round" });
  const pieces: { piece: SVGElement; curve: number; point: number }[] = [];
  for (let curve = 0; curve < model.curveCount; curve += 1) {
    const [first, end] = [model.offset[curve], model.offset[curve + 1]];
    const steps = end - first - 1 + Number(model.report.curves[curve].closed);
    // Eight steps a piece: depth changes little over them.
    for (let from = 0; from < steps; from += 8) {
      const points: string[] = [];
      for (let k = from; k <= Math.min(from + 8, steps); k += 1) points.push(at(first + (k % (end - first))).map((value) => value.toFixed(1)).join(","));
      const piece = s("polyline", { points: points.join(" ") });
      pieces.push({ piece, curve, point: first + from });
      group.append(piece);
    }
  }
  const colour = () => {
    for (const { piece, curve, point } of pieces) {
      piece.setAttribute("stroke", css(store.scale.colour(store.scale.value(point, curve))));
      if (store.selected === curve) piece.setAttribute("stroke-width", String(2.5 * width));
      else piece.removeAttribute("stroke-width");
    }
  };
  colour();
  return { group, colour };
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
  const drawn = found.map((view) => {
    const { size_px: size, image, step_px: step, projection, lines } = view;
    const width = Math.max(...size) / 220;
    const curves = curvesIn(store, projection, width);
    // SVG takes numbers of points with commas throughout.
    const detected = s("g", { class: "found", fill: "none", "stroke-width": 0.6 * width }, ...lines.map((line) => s("polyline", { points: line.join(",") })));
    const name = degrees(view.tilt_deg);
    const figure = h("figure", {}, picture(`View at ${name} with the curves`, image, size, covered(size, step), [detected, curves.group]), h("figcaption", {}, name));
    return { curves, detected, figure };
  });
  const show = (group: SVGElement, shown: boolean) => group.setAttribute("visibility", shown ? "visible" : "hidden");
  drawn.forEach(({ detected }) => show(detected, false));
  store.on(["selection", "colour"], () => drawn.forEach(({ curves }) => curves.colour()));
  return h(
    "div",
    { class: "images views" },
    h(
      "div",
      { class: "toolbar" },
      h(
        "div",
        { class: "ticks", role: "group", "aria-label": "Shown in the views" },
        tick("Curves", true, (on) => drawn.forEach(({ curves }) => show(curves.group, on))),
        tick("Lines detected there", false, (on) => drawn.forEach(({ detected }) => show(detected, on))),
      ),
      h("span", { class: "hint" }, "Curves in the colours of the 3D view"),
    ),
    h("div", { class: "strip" }, ...drawn.map(({ figure }) => figure)),
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
    ["Depth", c.depth_px ? `tomogram less curves ${fixed(c.depth_px[0], 1)} px in the median; half within ${fixed(c.depth_px[1], 1)} px of that. The shifts of the views were found on the curves, so a common offset tells nothing` : "nothing to compare"],
    ["Threshold", `${digits(c.threshold)}, ${digits(100 * c.share, 2)} % of the voxels: the one at which both agree best`],
  ];
  const one = (label: string, text: string, image: string, shown: [number, number], step: number, projection: [Row, Row]) => {
    const curves = curvesIn(store, projection, Math.max(...shown) / 300);
    return { curves, figure: h("figure", {}, picture(label, image, shown, covered(shown, step), [curves.group]), h("figcaption", {}, text)) };
  };
  const drawn = [
    one("Largest value of the tomogram along the beam, with the curves", "Along the beam: largest value along z", found.above, [size[0], size[1]], found.step[0], [voxels[0], voxels[1]]),
    one("Largest value of the tomogram along the tilt axis, with the curves", "Along the tilt axis: largest value along y, viewer on top", found.edge, [size[0], size[2]], found.step[1], [voxels[0], voxels[2]]),
  ];
  store.on(["selection", "colour"], () => drawn.forEach(({ curves }) => curves.colour()));
  return h(
    "div",
    { class: "images views" },
    h(
      "div",
      { class: "toolbar" },
      h("h3", {}, "Beside a tomogram"),
      tick("Curves over the tomogram", true, (on) => drawn.forEach(({ curves }) => curves.group.setAttribute("visibility", on ? "visible" : "hidden"))),
    ),
    h("div", { class: "tomogram" }, h("div", { class: "tomogram-pictures" }, ...drawn.map(({ figure }) => figure)), h("table", { class: "record" }, h("tbody", {}, ...rows.map(([name, text]) => h("tr", {}, h("th", { scope: "row" }, name), h("td", {}, text)))))),
  );
}
