// A headless browser with a page of udc in it: what is on its canvas, what it says, what it breaks.

import { createRequire } from "node:module";
import { pathToFileURL } from "node:url";
import { readFileSync } from "node:fs";

// Where npm installed playwright-core and axe-core.
const require = createRequire(`${process.env.PAGE_TOOLS}/package.json`);
const { chromium } = require("playwright-core");
const axe = readFileSync(require.resolve("axe-core/axe.min.js"), "utf8");

export const SIZES = {
  phone: { width: 390, height: 844, deviceScaleFactor: 2 },
  tablet: { width: 820, height: 1180, deviceScaleFactor: 1 },
  desktop: { width: 1440, height: 900, deviceScaleFactor: 1 },
};

export async function launch() {
  return chromium.launch({
    executablePath: process.env.CHROMIUM || "/usr/bin/chromium",
    args: ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--allow-file-access-from-files"],
  });
}

/** Opens a page from disk; what it asks of the network or complains about is an error. */
export async function open(browser, file, { size = SIZES.desktop, scheme = "light", query = "" } = {}) {
  const { deviceScaleFactor, ...viewport } = size;
  const context = await browser.newContext({ viewport, deviceScaleFactor, colorScheme: scheme });
  const page = await context.newPage();
  page.faults = [];
  page.on("pageerror", (error) => page.faults.push(String(error)));
  page.on("console", (message) => {
    if (message.type() === "error") page.faults.push(message.text());
  });
  page.on("request", (request) => {
    if (!/^(file|data|blob):/.test(request.url())) page.faults.push(`asks for ${request.url()}`);
  });
  await page.goto(pathToFileURL(file).href + query);
  return page;
}

/** Waits until the viewer has drawn what was chosen last. */
export async function drawn(page) {
  await page.waitForFunction(() => {
    const viewer = document.querySelector(".viewer");
    return Number(viewer?.dataset.drawn) > 0 && viewer.querySelector("[data-part=wait]").textContent === "";
  });
  // What changed is drawn with the next frame.
  await page.evaluate(() => new Promise((resume) => {
    requestAnimationFrame(() => requestAnimationFrame(resume));
  }));
}

/** Red, green, blue and alpha of the canvas at shares of its width and height. */
export async function pixel(page, across, down) {
  await drawn(page);
  return page.evaluate(([u, v]) => {
    const from = document.querySelector(".viewer canvas");
    const to = document.createElement("canvas");
    [to.width, to.height] = [from.width, from.height];
    const context = to.getContext("2d");
    context.drawImage(from, 0, 0);
    const place = [Math.min(Math.floor(u * to.width), to.width - 1), Math.min(Math.floor(v * to.height), to.height - 1)];
    return [...context.getImageData(...place, 1, 1).data];
  }, [across, down]);
}

/** Every byte of the canvas. */
export async function canvasBytes(page) {
  await drawn(page);
  const text = await page.evaluate(() => {
    const from = document.querySelector(".viewer canvas");
    const to = document.createElement("canvas");
    [to.width, to.height] = [from.width, from.height];
    const context = to.getContext("2d");
    context.drawImage(from, 0, 0);
    return [...context.getImageData(0, 0, to.width, to.height).data].join(",");
  });
  return text.split(",").map(Number);
}

/** Sets a slider or a list as a reader would, and waits for the picture. */
export async function set(page, part, value) {
  await drawn(page);
  await page.evaluate(([name, wanted]) => {
    const element = document.querySelector(`.viewer [data-part="${name}"]`);
    element.value = wanted;
    element.dispatchEvent(new Event("input", { bubbles: true }));
    element.dispatchEvent(new Event("change", { bubbles: true }));
  }, [part, String(value)]);
  await drawn(page);
}

export async function text(page, part) {
  await drawn(page);
  return page.textContent(`.viewer [data-part="${part}"]`);
}

/** Serious and critical faults of accessibility. */
export async function accessibilityFaults(page) {
  await page.evaluate(axe);
  const { violations } = await page.evaluate(() => globalThis.axe.run(document, { resultTypes: ["violations"] }));
  return violations
    .filter(({ impact }) => impact === "serious" || impact === "critical")
    .map(({ id, impact, nodes }) => `${impact}: ${id}: ${nodes.slice(0, 3).map(({ target, failureSummary }) => `${target} ${failureSummary}`).join("; ")}`);
}

/** The values of a NumPy file of 32-bit floats, with its shape. */
export function readNpy(file) {
  const bytes = readFileSync(file);
  const length = bytes.readUInt16LE(8);
  const head = bytes.subarray(10, 10 + length).toString("latin1");
  if (!head.includes("'<f4'") || head.includes("'fortran_order': True")) throw new Error(`${file}: ${head}`);
  const shape = /\(([^)]*)\)/.exec(head)[1].split(",").filter((part) => part.trim()).map(Number);
  const copy = Uint8Array.from(bytes.subarray(10 + length));
  return { shape, values: new Float32Array(copy.buffer) };
}
