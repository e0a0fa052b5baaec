// What a browser makes of a page with a player: node check.mjs PAGE RENDER.png HOSTILE [SCREENSHOT]
// PAGE is an address, RENDER what `rogs render` makes of the first camera at the first time, HOSTILE text that must be shown
// as text. Prints one JSON value; what is wrong ends it with an error.
import assert from "node:assert/strict";
import { readFile } from "node:fs/promises";
import { createRequire } from "node:module";

const require = createRequire(new URL("../../pipeline/report/viewer/package.json", import.meta.url));
const puppeteer = require("puppeteer-core");
const [page_address, render, hostile, screenshot] = process.argv.slice(2);

const browser = await puppeteer.launch({
  executablePath: process.env.ROGS_CHROMIUM ?? "/usr/bin/chromium",
  headless: true,
  protocolTimeout: 600_000,
  args: ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist", "--disable-gpu-vsync"],
});
try {
  const page = await browser.newPage();
  await page.setViewport({ width: 560, height: 900 });
  const wrong = [];
  const asked = [];
  page.on("console", (message) => message.type() === "error" && wrong.push(message.text()));
  page.on("pageerror", (error) => wrong.push(String(error)));
  page.on("dialog", (dialog) => wrong.push(`dialog: ${dialog.message()}`) && dialog.dismiss());
  page.on("request", (request) => asked.push(request.url()));
  await page.goto(page_address, { timeout: 300_000 });
  await page.waitForFunction(() => globalThis.rogsPlayers?.current, { timeout: 300_000 });
  await page.evaluate(() => rogsPlayers.current.ready);

  // The first frame against the program's render.
  const picture = `data:image/png;base64,${(await readFile(render)).toString("base64")}`;
  const psnr = await page.evaluate(async (address) => {
    const pixels = async (source) => {
      const image = new Image();
      image.src = source;
      await image.decode();
      const canvas = Object.assign(document.createElement("canvas"), { width: image.width, height: image.height });
      const context = canvas.getContext("2d");
      context.drawImage(image, 0, 0);
      return context.getImageData(0, 0, image.width, image.height);
    };
    const meant = await pixels(address);
    const shown = await pixels(rogsPlayers.current.snapshot(meant.width, meant.height));
    let squares = 0;
    let count = 0;
    for (let k = 0; k < meant.data.length; k++) {
      if (k % 4 === 3) continue;
      squares += (meant.data[k] - shown.data[k]) ** 2;
      count++;
    }
    return 10 * Math.log10((255 * 255 * count) / squares);
  }, picture);
  assert(psnr > 35, `the first frame is ${psnr} dB from the render`);

  await page.evaluate(() => rogsPlayers.current.loaded);
  const size = [112, 84];
  const snapshot = () => page.evaluate((size) => rogsPlayers.current.snapshot(...size), size);
  const first = await snapshot();
  assert.equal(await snapshot(), first, "the same moment looks different the second time");
  await page.evaluate(() => {
    const slider = document.querySelector(".player-bar input[type=range]");
    slider.value = slider.max;
    slider.dispatchEvent(new Event("input"));
  });
  assert.notEqual(await snapshot(), first, "the slider changes nothing");
  await page.evaluate(() => rogsPlayers.current.setTime(0));
  await page.click(".player-bar button");
  await page.waitForFunction(() => rogsPlayers.current.time > 0.2, { timeout: 300_000 });
  assert.notEqual(await snapshot(), first, "playing changes nothing");
  await page.click(".player-bar button");
  await page.evaluate(() => rogsPlayers.current.setTime(0));
  for (const mode of [1, 2, 3]) {
    const shown = await page.evaluate((mode, size) => {
      rogsPlayers.current.mode = mode;
      return rogsPlayers.current.snapshot(...size);
    }, mode, size);
    assert.notEqual(shown, first, `mode ${mode} looks like colours`);
  }
  await page.evaluate(() => (rogsPlayers.current.mode = 0));
  const last = await page.evaluate(() => {
    const select = document.querySelector(".player-bar select");
    select.value = "1";
    select.dispatchEvent(new Event("change"));
    return rogsPlayers.current.view.followed;
  });
  assert.equal(last, 1);
  assert.notEqual(await snapshot(), first, "another camera sees the same");

  const enlarged = await page.evaluate(() => {
    const picture = document.querySelector("figure img");
    picture?.click();
    return [picture?.classList.contains("large"), (picture?.click(), picture?.classList.contains("large"))];
  });
  assert(enlarged[0] !== false && !enlarged[1], "a click does not enlarge a picture, or a second one leaves it large");

  // A phone: nothing but tables is wider than the screen, and these scroll by themselves.
  await page.setViewport({ width: 390, height: 844 });
  const width = await page.evaluate(() => document.scrollingElement.scrollWidth);
  assert(width <= 390, `the page is ${width} pixels wide on a screen of 390`);
  await page.setViewport({ width: 560, height: 900 });

  const text = await page.evaluate(() => document.body.textContent);
  assert(text.includes(hostile), `\`${hostile}\` is not shown as text`);
  assert.equal(await page.evaluate(() => document.querySelectorAll("img[src=x]").length), 0, "text became an element");
  const home = page_address.startsWith("file:") ? "file://" : new URL(page_address).origin;
  const away = asked.filter((url) => !url.startsWith(home) && !url.startsWith("data:") && !url.startsWith("blob:"));
  assert.deepEqual(away, [], "requests leave");
  assert.deepEqual(wrong, [], "the console has errors");
  if (screenshot) await page.screenshot({ path: screenshot });
  console.log(JSON.stringify({ psnr, requests: asked.length }));
} finally {
  await browser.close();
}
