// A page of the report in Chromium, opened from disk; whatever it asks for or complains of is kept.

import { readFileSync } from "node:fs";
import { pathToFileURL } from "node:url";
import { join } from "node:path";
import { chromium } from "playwright-core";

export const PAGES = process.env.TILTLINE_PAGES;
const ARGUMENTS = [
  "--no-sandbox",
  "--disable-quic",
  "--no-first-run",
  "--disable-background-networking",
  "--disable-component-update",
  "--disable-sync",
  // WebGL in software, as a machine without a graphics card has it.
  "--use-angle=swiftshader",
  "--enable-unsafe-swiftshader",
];

/** Chromium; `webgl: false` is one that has none. */
export function launch({ webgl = true } = {}) {
  const none = ["--disable-gpu", "--disable-3d-apis"];
  return chromium.launch({ executablePath: process.env.TILTLINE_CHROMIUM, args: webgl ? ARGUMENTS : [...ARGUMENTS.slice(0, 6), ...none] });
}

/** A report on screen, its data as they stand in the file, what it asked for and what went wrong. */
export async function open(browser, name, options = {}) {
  const path = join(PAGES, name, "report.html");
  const context = await browser.newContext({ viewport: { width: 1280, height: 1000 }, colorScheme: "light", reducedMotion: "reduce", ...options });
  const page = await context.newPage();
  const [requests, complaints] = [[], []];
  page.on("request", (request) => requests.push(request.url()));
  page.on("pageerror", (error) => complaints.push(error.message));
  page.on("console", (message) => {
    // Software WebGL warns that reading pixels back is slow.
    if (["error", "warning"].includes(message.type()) && !message.text().includes("GPU stall")) complaints.push(message.text());
  });
  page.on("dialog", (dialog) => {
    complaints.push(`dialog: ${dialog.message()}`);
    dialog.dismiss();
  });
  await page.goto(pathToFileURL(path).href);
  await drawn(page);
  const html = readFileSync(path, "utf8");
  const data = JSON.parse(html.split('id="report-data">')[1].split("</script>")[0]);
  return { page, context, path, html, data, requests, complaints };
}

/** Waits until the views have drawn what they were asked to. */
export async function drawn(page) {
  await page.evaluate(async () => {
    for (const image of document.images) await image.decode().catch(() => {});
    for (let frame = 0; frame < 4; frame += 1) await new Promise((done) => requestAnimationFrame(done));
  });
  await page.waitForTimeout(150);
}

/** Pixels of a part of the screen: `at(x, y)` gives [r, g, b] in CSS px from the part's corner. */
export async function pixels(page, locator) {
  await locator.scrollIntoViewIfNeeded();
  await drawn(page);
  const shot = (await locator.screenshot()).toString("base64");
  const { width, bytes } = await page.context().browser().newPage().then(async (blank) => {
    const found = await blank.evaluate(async (base64) => {
      const image = new Image();
      image.src = `data:image/png;base64,${base64}`;
      await image.decode();
      const canvas = document.createElement("canvas");
      [canvas.width, canvas.height] = [image.width, image.height];
      const context = canvas.getContext("2d");
      context.drawImage(image, 0, 0);
      const { data } = context.getImageData(0, 0, image.width, image.height);
      let text = "";
      for (let at = 0; at < data.length; at += 32768) text += String.fromCharCode(...data.subarray(at, at + 32768));
      return { width: image.width, bytes: btoa(text) };
    }, shot);
    await blank.close();
    return found;
  });
  const data = Buffer.from(bytes, "base64");
  return { width, height: data.length / 4 / width, data, at: (x, y) => [...data.subarray(4 * (Math.round(y) * width + Math.round(x)), 4 * (Math.round(y) * width + Math.round(x)) + 3)] };
}

/** How many pixels of two pictures of one size differ by more than the grain of the screen. */
export function difference(a, b) {
  let count = 0;
  for (let at = 0; at < Math.min(a.data.length, b.data.length); at += 4) {
    if ([0, 1, 2].some((channel) => Math.abs(a.data[at + channel] - b.data[at + channel]) > 12)) count += 1;
  }
  return count;
}
