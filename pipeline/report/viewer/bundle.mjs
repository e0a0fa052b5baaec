// Makes viewer.js from src/: one classic script without modules, so that it runs from file://.
// `node bundle.mjs --check` only compares.
import { readFile, writeFile } from "node:fs/promises";
import { dirname, join } from "node:path";
import { fileURLToPath } from "node:url";
import { build } from "esbuild";

const here = dirname(fileURLToPath(import.meta.url));
const target = join(here, "viewer.js");
const licence = (await readFile(join(here, "node_modules/three/LICENSE"), "utf8")).trim().replace("\u00a9", "(c)");
const result = await build({
  absWorkingDir: here,
  entryPoints: ["src/main.js"],
  bundle: true,
  minify: true,
  format: "iife",
  target: "es2022",
  charset: "ascii",
  legalComments: "none",
  write: false,
  banner: { js: `/* The viewer of rogs, MIT OR Apache-2.0. It contains three.js:\n\n${licence}\n*/` },
});
const made = result.outputFiles[0].text;
// It is put into pages between tags.
if (/<\/script|<!--|[^\t\n -~]/i.test(made)) throw new Error("the bundle would end its own tag, or is not plain text");
if (process.argv.includes("--check")) {
  if ((await readFile(target, "utf8")) !== made) {
    console.error("viewer.js is not what src/ gives: run `npm ci && npm run bundle` in pipeline/report/viewer");
    process.exit(1);
  }
} else {
  await writeFile(target, made);
  console.log(`${target}: ${made.length} bytes`);
}
