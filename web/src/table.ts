// The curves as a table: the way to a curve for those who use no pointer, and its figures when it is selected.

import { type Model } from "./data";
import { h } from "./dom";
import { digits, fixed } from "./format";
import type { Store } from "./store";

type Key = "curve" | "length" | "min_z" | "sigma_z";

/** Figures of the selected curve. */
export function details(store: Store): HTMLElement {
  const { model } = store;
  const element = h("div", { class: "details", role: "status", "aria-label": "Selected curve" });
  const draw = () => {
    const curve = store.selected;
    if (curve === null) {
      const text = model.curveCount === 0 ? "No line was found in both images." : "Click a curve, in 3D or in an image, to see its figures here.";
      element.replaceChildren(h("h3", {}, "No curve selected"), h("p", { class: "hint" }, text));
      return;
    }
    const rows = rowsOf(model, curve).map(([name, value]) => h("tr", {}, h("th", { scope: "row" }, name), h("td", {}, value)));
    element.replaceChildren(
      h("h3", {}, `Curve ${curve}`),
      h("table", { class: "record" }, h("tbody", {}, ...rows)),
      h("button", { type: "button", class: "quiet", onclick: () => store.select(null) }, "Clear selection"),
    );
  };
  draw();
  store.on(["selection"], draw);
  return element;
}

function rowsOf(model: Model, curve: number): [string, string][] {
  const { unit, report } = model;
  const measures = report.measures.per_curve[curve];
  const { closed, ends, flags } = report.curves[curve];
  const shares = ["measured", "along the rows", "bridged"].map((text, flag) => ({ text, share: [...flags].filter((digit) => Number(digit) === flag).length / flags.length }));
  const rows: [string, string][] = [
    ["Length", `${digits(measures.length)} ${unit}`],
    ["Depth", `${fixed(measures.min_z, 1)} to ${fixed(measures.max_z, 1)} ${unit}`],
    ["Sigma of depth", `${digits(measures.sigma_z, 2)} ${unit} (median)`],
  ];
  if (measures.direction) {
    const [x, y, z] = measures.direction;
    const inImage = (Math.atan2(y, x) * 180) / Math.PI;
    const steep = (Math.asin(Math.min(1, Math.abs(z))) * 180) / Math.PI;
    // A line has no sense: its angle in the image is given between -90 and 90 degrees.
    const folded = inImage > 90 ? inImage - 180 : inImage <= -90 ? inImage + 180 : inImage;
    rows.push(["Direction", `(${[x, y, z].map((value) => fixed(value, 2)).join(", ")})`]);
    rows.push(["In the image", `${fixed(folded, 0)}° clockwise from x`]);
    rows.push(["Out of the image", `${fixed(steep, 0)}°`]);
  }
  rows.push(["Ends", closed ? "closed" : ends.join(" and ")]);
  rows.push(["Points", shares.filter(({ share }) => share > 0).map(({ text, share }) => `${Math.round(100 * share)} % ${text}`).join(", ")]);
  return rows;
}

/** All curves; a heading sorts, a row selects. */
export function table(store: Store): HTMLElement {
  const { model } = store;
  const { unit, report } = model;
  const measures = report.measures.per_curve;
  let sorted: { key: Key; down: boolean } = { key: "curve", down: false };
  const columns: { key: Key; text: string; unit?: string; value: (curve: number) => number; show: (curve: number) => string }[] = [
    { key: "curve", text: "Curve", value: (c) => c, show: String },
    { key: "length", text: "Length", unit, value: (c) => measures[c].length, show: (c) => digits(measures[c].length) },
    { key: "min_z", text: "Depth", unit, value: (c) => measures[c].min_z, show: (c) => `${fixed(measures[c].min_z, 0)} to ${fixed(measures[c].max_z, 0)}` },
    { key: "sigma_z", text: "Sigma", unit, value: (c) => measures[c].sigma_z, show: (c) => digits(measures[c].sigma_z, 2) },
  ];
  const rows = measures.map((_, curve) => {
    const [first, ...others] = columns.map((column) => column.show(curve));
    const button = h("button", { type: "button", class: "row", "aria-label": `Select curve ${curve}` }, first);
    const row = h("tr", {}, h("th", { scope: "row" }, button), ...others.map((text) => h("td", {}, text)));
    row.addEventListener("click", () => store.select(store.selected === curve ? null : curve));
    row.addEventListener("pointerenter", () => store.point({ curve, point: (model.offset[curve] + model.offset[curve + 1]) >> 1 }));
    row.addEventListener("pointerleave", () => store.point(null));
    return row;
  });
  const body = h("tbody", {}, ...rows);
  const headings = columns.map(({ key, text, unit }) => {
    const sort = () => {
      sorted = { key, down: sorted.key === key ? !sorted.down : key === "length" };
      const { value } = columns.find((column) => column.key === key)!;
      const order = [...rows.keys()].sort((a, b) => (value(a) - value(b)) * (sorted.down ? -1 : 1));
      body.replaceChildren(...order.map((curve) => rows[curve]));
      headings.forEach((heading, k) => {
        heading.setAttribute("aria-sort", columns[k].key !== key ? "none" : sorted.down ? "descending" : "ascending");
      });
    };
    return h("th", { scope: "col", "aria-sort": key === "curve" ? "ascending" : "none" }, h("button", { type: "button", onclick: sort }, text, unit ? h("span", { class: "unit" }, ` ${unit}`) : null));
  });
  const element = h("div", { class: "table", tabindex: 0, role: "region", "aria-label": "All curves" }, h("table", {}, h("thead", {}, h("tr", {}, ...headings)), body));
  store.on(["selection"], () => {
    rows.forEach((row, curve) => {
      row.classList.toggle("selected", curve === store.selected);
      row.querySelector("button")!.setAttribute("aria-pressed", String(curve === store.selected));
    });
    const row = store.selected === null ? null : rows[store.selected];
    if (row && (row.offsetTop < element.scrollTop + 30 || row.offsetTop > element.scrollTop + element.clientHeight - 30)) element.scrollTop = row.offsetTop - 60;
  });
  return element;
}
