// The report of a reconstruction, drawn from the data embedded in its page. Nothing is fetched.

import "./style.css";

import { modelOf, readReport } from "./data";
import { h } from "./dom";
import { downloads } from "./downloads";
import { Images } from "./images";
import { caveat, charts, keyFigures, runRecord, subtitle, title, warnings } from "./numbers";
import { series } from "./series";
import { Store } from "./store";
import { details, table } from "./table";
import { Viewer } from "./viewer";

const model = modelOf(readReport());
const store = new Store(model);
const viewer = new Viewer(store);
const images = new Images(store);

const themeButton = h("button", { type: "button", class: "quiet", onclick: () => store.setTheme(store.theme === "dark" ? "light" : "dark") });
const nameTheme = () => (themeButton.textContent = store.theme === "dark" ? "Light" : "Dark");
nameTheme();
store.on(["theme"], nameTheme);

const section = (id: string, name: string, ...children: HTMLElement[]) =>
  h("section", { id, "aria-labelledby": `${id}-title` }, h("h2", { id: `${id}-title` }, name), ...children);
const links = [
  ["foil", "In 3D"],
  ["images", "Images"],
  ...(model.report.series ? [["series", "Series"]] : []),
  ["numbers", "Numbers"],
  ["run", "Run and files"],
];

document.body.append(
  h(
    "header",
    {},
    h("div", { class: "bar" }, h("span", { class: "brand" }, "Tiltline"), h("nav", { "aria-label": "Sections" }, ...links.map(([id, text]) => h("a", { href: `#${id}` }, text))), themeButton),
  ),
  h(
    "main",
    {},
    h("div", { class: "title" }, h("h1", {}, title(model)), h("p", {}, subtitle(model))),
    keyFigures(model),
    h("p", { class: "caveat" }, caveat(model)),
    section("foil", "In 3D", h("div", { class: "split" }, viewer.element, h("aside", { "aria-label": "Curves" }, details(store), table(store)))),
    section("images", "Images", images.element),
    ...[series(store)].filter((part) => part !== null).map((part) => section("series", "Other views of the series", part)),
    section("numbers", "Numbers", ...[warnings(model)].filter((part) => part !== null), charts(store)),
    section("run", "Run and files", h("div", { class: "split" }, runRecord(model), h("aside", { "aria-label": "Downloads" }, h("h3", {}, "Save from this page"), downloads(model)))),
  ),
);

// For scripts and tests in the browser's console.
Object.assign(window, { tiltline: { model, store, viewer, images } });
