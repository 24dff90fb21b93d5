// Builds src/main.ts into one HTML file with its script and style in it: the page that the program fills and writes.
import { createHash } from "node:crypto";
import { readFileSync } from "node:fs";
import { defineConfig } from "vite";

const sha256 = (text) => createHash("sha256").update(text).digest("base64");

/** Puts the one script and the one style into page.html, and their hashes into its Content-Security-Policy. */
const onePage = {
  name: "one-page",
  enforce: "post",
  generateBundle(_options, bundle) {
    const files = Object.values(bundle);
    const script = files
      .find((file) => file.type === "chunk")
      .code.trim()
      .replaceAll("</script", "<\\/script")
      .replaceAll("<!--", "<\\!--");
    const style = String(files.find((file) => file.fileName.endsWith(".css")).source).trim();
    if (files.length !== 2) throw new Error(`one script and one style expected, not ${Object.keys(bundle)}`);
    const parts = { "script hash": sha256(script), "style hash": sha256(style), style, script };
    const source = readFileSync("page.html", "utf8").replace(/\[\[([a-z ]+)\]\]/g, (_, name) => parts[name]);
    for (const name of Object.keys(bundle)) delete bundle[name];
    this.emitFile({ type: "asset", fileName: "page.html", source });
  },
};

export default defineConfig({
  plugins: [onePage],
  build: {
    outDir: process.env.TILTLINE_PAGE_FOLDER ?? "dist",
    emptyOutDir: true,
    target: "es2022",
    cssCodeSplit: false,
    assetsInlineLimit: 0,
    rollupOptions: { input: "src/main.ts", output: { format: "iife" } },
  },
});
