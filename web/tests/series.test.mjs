// The part of the report about the other views of a series.

import assert from "node:assert/strict";
import { after, before, describe, test } from "node:test";

import { difference, launch, open, pixels } from "./browser.mjs";

let browser;
before(async () => (browser = await launch()));
after(async () => browser.close());

describe("the other views of a series", () => {
  test("curves are drawn on the lines of every view, and the figures are those of the data", async () => {
    const { page, context, data, complaints } = await open(browser, "series");
    assert.equal(await page.locator("nav a[href='#series']").count(), 1);
    const views = data.series.views;
    assert.equal(await page.locator("#series .chart").first().locator(".spot").count(), views.length);
    assert.equal(await page.locator("#series .chart").first().locator(".spot.hollow").count(), 2);
    assert.equal(await page.locator(".figures-table tbody tr").count(), views.length);
    const pictures = page.locator(".strip svg");
    assert.equal(await pictures.count(), data.series.pictures.length);
    // The drawn points are the curves' points in the view's own pixels, where its detected lines are.
    const drawn = await page.evaluate(() =>
      [...document.querySelectorAll(".strip svg")].map((svg) => [...svg.querySelectorAll("g:not(.found) polyline")].flatMap((line) => line.getAttribute("points").split(" ").map((text) => text.split(",").map(Number)))),
    );
    drawn.forEach((points, side) => {
      const lines = data.series.pictures[side].lines;
      const near = ([x, y]) =>
        lines.some((line) => {
          for (let k = 2; k < line.length; k += 2) {
            const [ax, ay, bx, by] = [line[k - 2], line[k - 1], line[k], line[k + 1]];
            const length = (bx - ax) ** 2 + (by - ay) ** 2 || 1;
            const share = Math.min(1, Math.max(0, ((x - ax) * (bx - ax) + (y - ay) * (by - ay)) / length));
            if (Math.hypot(ax + share * (bx - ax) - x, ay + share * (by - ay) - y) < 2.5) return true;
          }
          return false;
        });
      const share = points.filter(near).length / points.length;
      assert.ok(points.length > 100 && share > 0.9, `view ${side}: ${share} of ${points.length}`);
    });
    assert.equal(await page.locator("#series img, #series script").count(), 0);
    assert.ok((await page.locator(".checks li").last().textContent()).includes("<img src=x onerror=alert(1)>"));
    const before = await pixels(page, pictures.first());
    await page.getByLabel("Lines detected there").check();
    assert.ok(difference(before, await pixels(page, pictures.first())) > 50);
    await page.locator(".views").first().getByRole("checkbox", { name: "Curves" }).uncheck();
    assert.equal(await page.locator(".strip svg").first().locator("g:not(.found)").getAttribute("visibility"), "hidden");
    const tomogram = page.locator(".tomogram");
    assert.match(await tomogram.textContent(), /SIRT, 30 iterations.*70 % of 1000 px.*50 % of 1500 px/s);
    assert.equal(await tomogram.locator("svg").count(), 2);
    assert.ok((await tomogram.locator("polyline").count()) > 20);
    assert.deepEqual(complaints, []);
    await context.close();
  });

  test("a report of a pair alone has no such part", async () => {
    const { page, context } = await open(browser, "example");
    assert.equal(await page.locator("#series, nav a[href='#series']").count(), 0);
    await context.close();
  });
});
