// The report as a reader uses it. Pages: `cargo xtask web --test` makes them; screenshots for the documents are taken on the
// way where TILTLINE_SCREENSHOTS names a folder.

import assert from "node:assert/strict";
import { readFileSync, statSync } from "node:fs";
import { join } from "node:path";
import { after, before, describe, test } from "node:test";
import { createRequire } from "node:module";

import { PAGES, difference, drawn, launch, open, pixels } from "./browser.mjs";

const axeSource = readFileSync(createRequire(import.meta.url).resolve("axe-core/axe.min.js"), "utf8");

let browser;
before(async () => (browser = await launch()));
after(async () => browser.close());

/** Screen px in the 3D view of every point of a curve. */
const places = (page, curve) =>
  page.evaluate((curve) => {
    const { viewer, model } = window.tiltline;
    const points = [];
    for (let point = model.offset[curve]; point < model.offset[curve + 1]; point += 1) points.push(viewer.placeOf(point));
    return points;
  }, curve);

const longest = (data) => data.measures.per_curve.reduce((best, curve, index, all) => (curve.length > all[best].length ? index : best), 0);

const select = (page) => page.evaluate(() => window.tiltline.store.selected);
const press = (page, name) => page.getByRole("button", { name, exact: true }).click();

/** A point of a curve at which a click finds that curve and no other that lies nearer. */
const clickable = (page, curve) =>
  page.evaluate((curve) => {
    const { viewer, model } = window.tiltline;
    for (let point = model.offset[curve]; point < model.offset[curve + 1]; point += 1) {
      const [x, y] = viewer.placeOf(point);
      if (viewer.pick(x, y, 3)?.curve === curve) return [x, y];
    }
    return null;
  }, curve);

describe("opened from disk", () => {
  test("shows the figures of its data, asks for nothing and complains of nothing", async () => {
    const { page, context, data, path, requests, complaints } = await open(browser, "example");
    await page.evaluate(() => window.scrollTo(0, document.body.scrollHeight));
    await drawn(page);
    assert.deepEqual(
      requests.filter((url) => !url.startsWith("data:")),
      [await page.evaluate(() => location.href)],
    );
    assert.deepEqual(complaints, []);
    assert.ok(data.curves.length > 8);
    const shown = await page.evaluate(() => {
      const { model, viewer } = window.tiltline;
      return { curves: model.curveCount, points: model.pointCount, rows: document.querySelectorAll(".table tbody tr").length, stage: viewer.stage.name };
    });
    const points = data.curves.reduce((sum, curve) => sum + curve.x.length, 0);
    assert.deepEqual(shown, { curves: data.curves.length, points, rows: data.curves.length, stage: "webgl" });
    assert.equal(await page.locator(".figure .value").first().textContent(), String(data.curves.length));
    assert.equal(await page.getByRole("heading", { level: 1 }).textContent(), "rendered_-4deg.png and rendered_+4deg.png");
    assert.equal(await page.locator(".warnings li").count(), data.warnings.length);
    assert.equal(await page.locator("#numbers circle").count(), data.point_matches.x.length);
    assert.ok(statSync(path).size < 3e6);
    await context.close();
  });

  test("its policy lets nothing in but itself", async () => {
    const { page, context, html, complaints } = await open(browser, "example");
    const policy = html.match(/Content-Security-Policy" content="([^"]*)"/)[1];
    assert.match(policy, /default-src 'none'/);
    assert.doesNotMatch(policy, /unsafe|https?:|\*/);
    const got = await page.evaluate(async () => {
      const fetched = await fetch("data:text/plain,x").then(() => "fetched", () => "refused");
      const script = document.createElement("script");
      script.textContent = "window.injected = true";
      document.body.append(script);
      return [fetched, window.injected ?? "refused"];
    });
    assert.deepEqual(got, ["refused", "refused"]);
    assert.ok(complaints.length > 0);
    await context.close();
  });

  test("user text is shown and not run", async () => {
    const { page, context, data, complaints } = await open(browser, "hostile");
    assert.equal(await page.locator("img, body > script:not([type])").count(), 1, "only the page's own script");
    assert.ok((await page.title()).includes("<img src=x onerror=alert(1)>"));
    assert.ok((await page.getByRole("heading", { level: 1 }).textContent()).includes('<!--"><img src=x onerror=alert(1)>.png and'));
    assert.ok((await page.locator(".warnings li").last().textContent()).includes(data.warnings.at(-1).message.slice(1)));
    assert.equal(await page.locator("pre").textContent(), data.run);
    assert.deepEqual(complaints, []);
    await context.close();
  });
});

describe("the foil in 3D", () => {
  test("curves are drawn where their data say, in the colours of the bar", async () => {
    const { page, context, data } = await open(browser, "example");
    await page.getByLabel("Micrograph").uncheck();
    const stage = await pixels(page, page.locator(".stage"));
    const ground = stage.at(3, 3);
    const far = (colour) => Math.max(...colour.map((value, channel) => Math.abs(value - ground[channel])));
    let [drawnPoints, all] = [0, 0];
    for (let curve = 0; curve < data.curves.length; curve += 1) {
      for (const [x, y] of await places(page, curve)) {
        all += 1;
        if (far(stage.at(x, y)) > 60) drawnPoints += 1;
      }
    }
    // Where curves cross, one hides a little of the other.
    assert.ok(drawnPoints > 0.97 * all, `${drawnPoints} of ${all}`);
    // An empty corner of the box is empty.
    const [x, y] = await page.evaluate(() => {
      const { viewer } = window.tiltline;
      for (let x = 150; x < 600; x += 7) for (let y = 60; y < 500; y += 7) if (!viewer.pick(x, y, 25)) return [x, y];
      return null;
    });
    assert.ok(far(stage.at(x, y)) < 12);
    // The colour is that of the map at the point's depth.
    const curve = longest(data);
    const [spot] = (await places(page, curve)).slice(20);
    const hit = await page.evaluate(([x, y]) => {
      const { viewer, store } = window.tiltline;
      const found = viewer.pick(x, y, 5);
      return store.scale.colour(store.scale.value(found.point, found.curve));
    }, spot);
    const seen = stage.at(...spot);
    assert.ok(hit.every((value, channel) => Math.abs(value - seen[channel]) < 40), `${hit} ${seen}`);
    await context.close();
  });

  test("a click selects a curve everywhere, a click beside it none", async () => {
    const { page, context, data, complaints } = await open(browser, "example");
    const curve = longest(data);
    const before = await pixels(page, page.locator(".panel canvas").first());
    const stage = page.locator(".stage");
    await stage.scrollIntoViewIfNeeded();
    const [x, y] = await clickable(page, curve);
    await stage.click({ position: { x, y } });
    assert.equal(await select(page), curve);
    assert.equal(await page.locator(".details h3").textContent(), `Curve ${curve}`);
    assert.match(await page.locator(".details").textContent(), /Length.*nm.*Depth.*nm.*Sigma.*Direction/s);
    assert.equal(await page.locator(".table tr.selected button").textContent(), String(curve));
    const after = await pixels(page, page.locator(".panel canvas").first());
    assert.ok(difference(before, after) > 200);
    await stage.scrollIntoViewIfNeeded();
    await stage.click({ position: { x: 8, y: 8 } });
    assert.equal(await select(page), null);
    assert.deepEqual(complaints, []);
    await context.close();
  });

  test("the tilt slider turns the foil about the vertical axis through the real range", async () => {
    const { page, context, data } = await open(browser, "example");
    const slider = page.getByLabel("Tilt", { exact: true });
    assert.deepEqual(
      [await slider.getAttribute("min"), await slider.getAttribute("max")].map(Number),
      [...data.tilts_deg].sort((a, b) => a - b),
    );
    const curve = longest(data);
    const level = await places(page, curve);
    await slider.scrollIntoViewIfNeeded();
    const box = await slider.boundingBox();
    await page.mouse.move(box.x + box.width / 2, box.y + box.height / 2);
    await page.mouse.down();
    await page.mouse.move(box.x + box.width + 20, box.y + box.height / 2, { steps: 6 });
    await page.mouse.up();
    assert.equal(await page.locator(".tilt output").textContent(), "+4°");
    const tilted = await places(page, curve);
    // x = X cos + Z sin at the tilt from the mid view, y stays.
    const { zoom, depths, middle } = await page.evaluate((curve) => {
      const { viewer, model } = window.tiltline;
      const depths = [];
      for (let point = model.offset[curve]; point < model.offset[curve + 1]; point += 1) depths.push(model.position[3 * point + 2]);
      return { zoom: viewer.pose.zoom, depths, middle: (viewer.box.low[2] + viewer.box.high[2]) / 2 };
    }, curve);
    const [sin, cos] = [Math.sin((4 * Math.PI) / 180), Math.cos((4 * Math.PI) / 180)];
    const centre = await page.evaluate(() => window.tiltline.viewer.width / 2 + window.tiltline.viewer.pose.panX);
    tilted.forEach(([x, y], k) => {
      const expected = centre + (level[k][0] - centre) * cos + zoom * (depths[k] - middle) * sin;
      assert.ok(Math.abs(x - expected) < 0.05, `${x} ${expected}`);
      assert.ok(Math.abs(y - level[k][1]) < 1e-3);
    });
    await context.close();
  });

  for (const name of ["example", "flipped"]) {
    test(`the ends of the slider are the micrographs: ${name}`, async () => {
      const { page, context, data } = await open(browser, name);
      const curve = longest(data);
      const { x, disparity } = data.curves[curve];
      for (const [side, end] of [Math.min(...data.tilts_deg), Math.max(...data.tilts_deg)].entries()) {
        await page.getByLabel("Tilt", { exact: true }).fill(String(end));
        const shown = await places(page, curve);
        const zoom = await page.evaluate(() => window.tiltline.viewer.pose.zoom * window.tiltline.model.report.frame.pixel);
        shown.forEach(([column], k) => {
          // Columns of the rectified left and right image.
          const apart = x[k] - x[0] + side * (disparity[k] - disparity[0]);
          assert.ok(Math.abs(column - shown[0][0] - zoom * apart) < 0.05, `end ${end}, point ${k}`);
        });
      }
      await context.close();
    });
  }

  test("views, stereo, colours and error bars change what is drawn", async () => {
    const { page, context, complaints } = await open(browser, "example");
    const stage = page.locator(".stage");
    const seen = [await pixels(page, stage)];
    const changes = async (name, act) => {
      await act();
      const now = await pixels(page, stage);
      assert.ok(difference(seen.at(-1), now) > 300, name);
      seen.push(now);
    };
    await changes("side", () => press(page, "Side"));
    // Along the beam, an error of depth is a point.
    await changes("error bars", () => page.getByLabel("Error bars").check());
    for (const name of ["Edge on", "Beam", "Sigma", "Length", "Flag", "Depth"]) await changes(name, () => press(page, name));
    await changes("red-cyan", () => press(page, "Red-cyan"));
    const glasses = await pixels(page, stage);
    let [reddish, cyanish] = [0, 0];
    for (let at = 0; at < glasses.data.length; at += 4) {
      const [r, , b] = glasses.data.subarray(at, at + 3);
      if (r - b > 60) reddish += 1;
      if (b - r > 60) cyanish += 1;
    }
    assert.ok(reddish > 200 && cyanish > 200, `${reddish} ${cyanish}`);
    await changes("side by side", () => page.locator(".stage").evaluate(() => document.querySelector('.viewer [data-value="pair"]').click()));
    await changes("off", () => press(page, "Off"));
    await changes("dragged", async () => {
      const box = await stage.boundingBox();
      await page.mouse.move(box.x + 300, box.y + 300);
      await page.mouse.down();
      await page.mouse.move(box.x + 420, box.y + 360, { steps: 5 });
      await page.mouse.up();
    });
    await changes("keys", async () => {
      await stage.focus();
      for (const key of ["ArrowLeft", "+", "+", "Shift+ArrowUp"]) await page.keyboard.press(key);
    });
    await press(page, "Reset");
    const reset = await pixels(page, stage);
    await page.getByLabel("Error bars").uncheck();
    assert.ok(difference(seen[0], await pixels(page, stage)) < 200, "reset shows what was shown at first");
    assert.ok(difference(reset, seen.at(-1)) > 300);
    assert.deepEqual(complaints, []);
    await context.close();
  });

  test("two thousand curves are few draw calls and little script", async () => {
    const { page, context, data, complaints } = await open(browser, "many", { viewport: { width: 900, height: 700 } });
    assert.equal(data.curves.length, 2000);
    await page.getByLabel("Error bars").check();
    await page.evaluate(() => window.tiltline.store.select(5));
    await drawn(page);
    const times = await page.evaluate(async () => {
      const { viewer } = window.tiltline;
      const times = [];
      for (let frame = 0; frame < 5; frame += 1) {
        viewer.pose.yaw += 0.01;
        viewer.moved();
        await new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)));
        times.push(viewer.frameMs);
      }
      return times;
    });
    const calls = await page.evaluate(() => window.tiltline.viewer.stage.drawCalls);
    assert.ok(calls <= 10, `${calls} draw calls`);
    const median = times.sort((a, b) => a - b)[2];
    console.log(`2,000 curves: ${calls} draw calls, ${median.toFixed(2)} ms of script a frame (median)`);
    assert.deepEqual(complaints, []);
    await context.close();
  });

  test("without WebGL it is drawn on a plain canvas", async () => {
    const poor = await launch({ webgl: false });
    const { page, data, complaints } = await open(poor, "example");
    assert.equal(await page.evaluate(() => window.tiltline.viewer.stage.name), "canvas");
    const stage = await pixels(page, page.locator(".stage"));
    const ground = stage.at(3, 3);
    const curve = longest(data);
    const points = await places(page, curve);
    const inked = points.filter(([x, y]) => stage.at(x, y).some((value, channel) => Math.abs(value - ground[channel]) > 60));
    assert.ok(inked.length > 0.95 * points.length);
    const [x, y] = await clickable(page, curve);
    await page.locator(".stage").click({ position: { x, y } });
    assert.equal(await select(page), curve);
    await press(page, "Edge on");
    assert.ok(difference(stage, await pixels(page, page.locator(".stage"))) > 300);
    assert.equal(await page.getByRole("button", { name: "Red-cyan" }).isDisabled(), true);
    assert.deepEqual(complaints.filter((text) => !text.includes("WebGL")), []);
    await poor.close();
  });
});

describe("the images", () => {
  test("a point under the pointer is marked in both images and in 3D", async () => {
    const { page, context, data } = await open(browser, "example");
    const [left, right] = [page.locator(".panel canvas").nth(0), page.locator(".panel canvas").nth(1)];
    const before = [await pixels(page, left), await pixels(page, right)];
    const curve = longest(data);
    const middle = data.curves[curve].x.length >> 1;
    const [x, y] = await page.evaluate(
      ({ x, y }) => {
        const { view } = window.tiltline.images;
        const canvas = document.querySelector(".panel canvas");
        return [canvas.clientWidth / 2 + (x - view.x) * view.zoom, canvas.clientHeight / 2 + (y - view.y) * view.zoom];
      },
      { x: data.curves[curve].x[middle], y: data.curves[curve].y[middle] },
    );
    await left.hover({ position: { x, y } });
    assert.match(await page.locator(".readout").textContent(), /curve \d+: disparity .* px, z .* nm/);
    await drawn(page);
    const box = await left.boundingBox();
    await page.mouse.move(box.x + x, box.y + y);
    const rightNow = await right.evaluate((canvas) => canvas.toDataURL());
    assert.ok(rightNow.length > 1000);
    const after = [await pixels(page, left), await pixels(page, right)];
    for (const side of [0, 1]) {
      // The row under the pointer runs across both.
      assert.ok(difference(before[side], after[side]) > 200, `panel ${side}`);
    }
    assert.notEqual(await page.evaluate(() => window.tiltline.store.hover), null);
    await context.close();
  });

  test("overlays, opacity, zoom and blink", async () => {
    const { page, context, complaints } = await open(browser, "example");
    const left = page.locator(".panel canvas").first();
    let last = await pixels(page, left);
    const changes = async (name, act) => {
      await act();
      const now = await pixels(page, left);
      assert.ok(difference(last, now) > 100, name);
      last = now;
    };
    await changes("curves off", () => page.getByRole("checkbox", { name: "Curves" }).uncheck());
    for (const name of ["Detected lines", "Line probability", "Point matches", "Disparity"]) {
      await changes(name, async () => {
        await page.getByLabel(name).check();
        await page.waitForTimeout(250);
      });
    }
    await changes("opacity", () => page.getByLabel("Opacity").fill("0.2"));
    await changes("zoom", () => press(page, "Zoom in"));
    const zooms = await page.evaluate(() => [...document.querySelectorAll(".panel canvas")].map((canvas) => canvas.width));
    assert.equal(zooms[0], zooms[1]);
    await press(page, "Blink");
    const visible = async () => page.locator(".panel:visible figcaption").allTextContents();
    const first = await visible();
    assert.equal(first.length, 1);
    await page.waitForTimeout(800);
    assert.notDeepEqual(await visible(), first);
    assert.deepEqual(complaints, []);
    await context.close();
  });
});

describe("files saved from the page", () => {
  test("are the program's own to the last digits that are kept", async () => {
    const { page, context, data } = await open(browser, "example");
    const save = async (name) => {
      const [download] = await Promise.all([page.waitForEvent("download"), page.locator(`[data-file="${name}"]`).click()]);
      return readFileSync(await download.path(), "utf8");
    };
    for (const name of ["curves.csv", "curves.ply", "curves.vtp"]) {
      const [saved, written] = [await save(name), readFileSync(join(PAGES, "example", name), "utf8")];
      const words = (text) => text.split(/[\s,]+/).filter((word) => word !== "");
      const [a, b] = [words(saved), words(written)];
      assert.equal(a.length, b.length, name);
      a.forEach((word, k) => {
        if (word === b[k]) return;
        // Disparities are kept to 0.0001 px, which is 0.001 nm of depth here; positions to 0.001 px.
        assert.ok(Math.abs(Number(word) - Number(b[k])) <= 0.0021, `${name}, word ${k}: ${word} ${b[k]}`);
      });
    }
    assert.deepEqual(JSON.parse(await save("report.json")), data);
    assert.equal(await save("run.toml"), data.run);
    await context.close();
  });
});

describe("for everybody", () => {
  for (const [name, scheme, viewport] of [
    ["example", "light", { width: 1280, height: 900 }],
    ["example", "dark", { width: 1280, height: 900 }],
    ["series", "dark", { width: 1280, height: 900 }],
    ["many", "light", { width: 820, height: 1180 }],
    ["empty", "dark", { width: 1280, height: 900 }],
  ]) {
    test(`axe finds nothing serious: ${name}, ${scheme}, ${viewport.width} px`, async () => {
      const { page, context, complaints } = await open(browser, name, { colorScheme: scheme, viewport, bypassCSP: true });
      await page.evaluate(axeSource);
      await page.evaluate(() => window.tiltline.model.curveCount > 0 && window.tiltline.store.select(0));
      const { violations } = await page.evaluate(() => window.axe.run());
      const serious = violations.filter(({ impact }) => ["serious", "critical"].includes(impact));
      assert.deepEqual(
        serious.map(({ id, nodes }) => [id, nodes.slice(0, 3).map((node) => node.html.slice(0, 120))]),
        [],
      );
      const overflow = await page.evaluate(() => document.documentElement.scrollWidth - window.innerWidth);
      assert.ok(overflow <= 0, `${overflow} px too wide`);
      assert.deepEqual(complaints, []);
      await context.close();
    });
  }

  test("a curve can be found and selected with the keyboard alone", async () => {
    const { page, context } = await open(browser, "example");
    for (let step = 0; step < 60; step += 1) {
      await page.keyboard.press("Tab");
      if (await page.evaluate(() => document.activeElement.classList.contains("stage"))) break;
    }
    await page.keyboard.press("PageDown");
    await page.keyboard.press("PageDown");
    assert.equal(await select(page), 1);
    await page.keyboard.press("Escape");
    assert.equal(await select(page), null);
    for (let step = 0; step < 60; step += 1) {
      await page.keyboard.press("Tab");
      if (await page.evaluate(() => document.activeElement.classList.contains("row"))) break;
    }
    await page.keyboard.press("Enter");
    assert.equal(await select(page), 0);
    await context.close();
  });

  test("a result without curves says so", async () => {
    const { page, context, complaints } = await open(browser, "empty");
    assert.equal(await page.locator(".figure .value").first().textContent(), "0");
    assert.match(await page.locator(".details").textContent(), /No line was found/);
    assert.doesNotMatch(await page.locator("main").innerText(), /\bnm\b|NaN|Infinity|undefined/);
    assert.deepEqual(complaints, []);
    await context.close();
  });

  test("light and dark follow the system and the button", async () => {
    const { page, context } = await open(browser, "example", { colorScheme: "dark" });
    const dark = await pixels(page, page.locator(".stage"));
    assert.ok(dark.at(3, 3).every((value) => value < 60));
    await press(page, "Light");
    assert.ok((await pixels(page, page.locator(".stage"))).at(3, 3).every((value) => value > 200));
    await context.close();
  });
});

test("screenshots for the documents", { skip: !process.env.TILTLINE_SCREENSHOTS }, async () => {
  const folder = process.env.TILTLINE_SCREENSHOTS;
  const name = process.env.TILTLINE_SCREENSHOT_PAGE ?? "example";
  for (const scheme of ["light", "dark"]) {
    const { page, context, data } = await open(browser, name, { colorScheme: scheme, viewport: { width: 1280, height: 1000 } });
    await page.evaluate((curve) => {
      const { viewer, store } = window.tiltline;
      store.select(curve);
      Object.assign(viewer.pose, { yaw: 0.5, pitch: -0.45, zoom: viewer.pose.zoom * 0.95, panX: -70, panY: -10 });
      viewer.orientation = null;
      viewer.moved();
      document.querySelector("#foil").scrollIntoView();
    }, longest(data));
    await drawn(page);
    await page.screenshot({ path: join(folder, `report-3d-${scheme}.png`) });
    if (scheme === "dark") return context.close();
    await page.locator("#images").scrollIntoViewIfNeeded();
    await page.evaluate(() => document.querySelector("#images").scrollIntoView());
    await page.getByLabel("Detected lines").check();
    await drawn(page);
    await page.screenshot({ path: join(folder, `report-images-light.png`) });
    await page.evaluate(() => document.querySelector("#numbers").scrollIntoView());
    await drawn(page);
    await page.screenshot({ path: join(folder, `report-numbers-light.png`) });
    await context.close();
  }
});
