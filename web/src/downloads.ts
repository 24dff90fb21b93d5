// Files made in the page from its data: the same columns as those that the program writes (docs/formats.md).

import { FLAGS, type Model, inverse } from "./data";
import { h } from "./dom";

const PX = 4;

function decimalsOf(model: Model): number {
  return Math.min(12, Math.max(0, 4 - Math.floor(Math.log10(model.report.frame.pixel))));
}

const number = (value: number, decimals: number): string => {
  const text = value.toFixed(decimals);
  return Number(text) === 0 ? text.replace("-", "") : text;
};

/** Position and sigma of a point in full precision, from the columns of the data. */
function place(model: Model, point: number): [number, number, number, number] {
  const { frame, tilts_deg } = model.report;
  const cosHalf = Math.cos((((tilts_deg[1] - tilts_deg[0]) / 2) * Math.PI) / 180);
  const d = model.disparity[point];
  return [
    ((model.x[point] + d / 2 - frame.centre_px[0]) / cosHalf) * frame.pixel,
    (model.y[point] - frame.centre_px[1]) * frame.pixel,
    d * frame.depth_gain * frame.pixel - frame.median_z,
    model.sigmaDisparity[point] * Math.abs(frame.depth_gain) * frame.pixel,
  ];
}

function eachPoint(model: Model, visit: (curve: number, index: number, point: number) => void): void {
  for (let curve = 0; curve < model.curveCount; curve += 1) {
    for (let point = model.offset[curve]; point < model.offset[curve + 1]; point += 1) visit(curve, point - model.offset[curve], point);
  }
}

export function csv(model: Model): string {
  const { unit, report } = model;
  const decimals = decimalsOf(model);
  const { rectified_from_left, rectified_from_right } = report.rectification;
  const rows = [
    `curve,point,x_left_px,y_left_px,x_right_px,y_right_px,disparity_px,sigma_disparity_px,x_${unit},y_${unit},z_${unit},sigma_z_${unit},flag`,
  ];
  eachPoint(model, (curve, index, point) => {
    const [x, y, d] = [model.x[point], model.y[point], model.disparity[point]];
    const inPx = [...inverse(rectified_from_left, x, y), ...inverse(rectified_from_right, x + d, y), d, model.sigmaDisparity[point]];
    const values = [...inPx.map((value) => number(value, PX)), ...place(model, point).map((value) => number(value, decimals))];
    rows.push([curve, index, ...values, FLAGS[model.flag[point]]].join(","));
  });
  return `${rows.join("\n")}\n`;
}

export function ply(model: Model): string {
  const decimals = decimalsOf(model);
  const rows = [
    "ply",
    "format ascii 1.0",
    `comment Tiltline curves; unit ${model.unit}; x right, y down, z away`,
    "comment flag: 0 ok, 1 ill conditioned, 2 bridged",
    `element vertex ${model.pointCount}`,
    ..."x y z sigma_z disparity_px sigma_disparity_px".split(" ").map((name) => `property double ${name}`),
    "property int curve",
    "property uchar flag",
    `element edge ${model.segmentCurve.length}`,
    "property int vertex1",
    "property int vertex2",
    "end_header",
  ];
  eachPoint(model, (curve, _, point) => {
    const lengths = place(model, point).map((value) => number(value, decimals));
    const px = [model.disparity[point], model.sigmaDisparity[point]].map((value) => number(value, PX));
    rows.push([...lengths, ...px, curve, model.flag[point]].join(" "));
  });
  model.segmentCurve.forEach((_, segment) => rows.push(`${model.segments[2 * segment]} ${model.segments[2 * segment + 1]}`));
  return `${rows.join("\n")}\n`;
}

export function vtp(model: Model): string {
  const { unit, report } = model;
  const decimals = decimalsOf(model);
  const columns = { curve: [] as number[], z: [] as string[], sigma: [] as string[], d: [] as string[], sd: [] as string[], flag: [] as number[], xyz: [] as string[] };
  eachPoint(model, (curve, _, point) => {
    const [x, y, z, sigma] = place(model, point).map((value) => number(value, decimals));
    columns.curve.push(curve);
    columns.z.push(z);
    columns.sigma.push(sigma);
    columns.d.push(number(model.disparity[point], PX));
    columns.sd.push(number(model.sigmaDisparity[point], PX));
    columns.flag.push(model.flag[point]);
    columns.xyz.push(`${x} ${y} ${z}`);
  });
  const array = (type: string, name: string, values: (string | number)[]) =>
    `<DataArray type="${type}" Name="${name}" format="ascii">\n${values.join("\n")}\n</DataArray>`;
  let end = 0;
  const lines = report.curves.map((curve, index) => {
    const points = Array.from(curve.x, (_, k) => model.offset[index] + k);
    if (curve.closed) points.push(model.offset[index]);
    end += points.length;
    return { text: points.join(" "), end };
  });
  const all = report.curves.map((_, index) => index);
  return `<?xml version="1.0"?>
<!-- Tiltline curves; unit ${unit}; x right, y down, z away; flag: 0 ok, 1 ill conditioned, 2 bridged -->
<VTKFile type="PolyData" version="1.0" byte_order="LittleEndian" header_type="UInt64">
<PolyData>
<Piece NumberOfPoints="${model.pointCount}" NumberOfVerts="0" NumberOfLines="${model.curveCount}" NumberOfStrips="0" NumberOfPolys="0">
<PointData Scalars="z_${unit}">
${array("Float64", "disparity_px", columns.d)}
${array("Float64", "sigma_disparity_px", columns.sd)}
${array("Float64", `z_${unit}`, columns.z)}
${array("Float64", `sigma_z_${unit}`, columns.sigma)}
${array("UInt8", "flag", columns.flag)}
${array("Int32", "curve", columns.curve)}
</PointData>
<CellData>
${array("Int32", "curve", all)}
${array("Float64", `length_${unit}`, report.measures.per_curve.map((curve) => number(curve.length, decimals)))}
${array("UInt8", "closed", report.curves.map((curve) => Number(curve.closed)))}
</CellData>
<Points>
${array("Float64\" NumberOfComponents=\"3", "Points", columns.xyz)}
</Points>
<Lines>
${array("Int64", "connectivity", lines.map((line) => line.text))}
${array("Int64", "offsets", lines.map((line) => line.end))}
</Lines>
</Piece>
</PolyData>
</VTKFile>
`;
}

/** Buttons that save a file made when they are pressed. */
export function downloads(model: Model): HTMLElement {
  const files: { name: string; type: string; text: string; make: () => string }[] = [
    { name: "curves.csv", type: "text/csv", text: "for any table program", make: () => csv(model) },
    { name: "curves.vtp", type: "application/xml", text: "for ParaView", make: () => vtp(model) },
    { name: "curves.ply", type: "application/octet-stream", text: "for MeshLab and Blender", make: () => ply(model) },
    { name: "report.json", type: "application/json", text: "all data of this page", make: () => JSON.stringify(model.report) },
    { name: "run.toml", type: "application/toml", text: "to repeat the run", make: () => model.report.run },
  ];
  const buttons = files.map(({ name, type, text, make }) =>
    h(
      "li",
      {},
      h("button", { type: "button", class: "download", "data-file": name, onclick: () => save(name, new Blob([make()], { type })) }, name),
      h("span", {}, text),
    ),
  );
  return h("ul", { class: "downloads" }, ...buttons);
}

function save(name: string, blob: Blob): void {
  const link = h("a", { href: URL.createObjectURL(blob), download: name });
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10_000);
}

