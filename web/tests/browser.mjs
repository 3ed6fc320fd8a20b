// Debian's Chromium on the pages of a running service, and what every page must keep to.
import assert from "node:assert/strict";
import { readFile } from "node:fs/promises";
import { createRequire } from "node:module";
import { chromium } from "playwright-core";

const CHROMIUM = process.env.CHROMIUM ?? "/usr/bin/chromium";
const axe = await readFile(createRequire(import.meta.url).resolve("axe-core/axe.min.js"), "utf8");

/** Runs a test with a browser, which is closed whatever comes of it. */
export async function withBrowser(test) {
  const args = ["--no-sandbox", "--disable-dev-shm-usage", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"];
  const browser = await chromium.launch({ executablePath: CHROMIUM, args });
  try {
    return await test(browser);
  } finally {
    await browser.close();
  }
}

/** A page, and a check that it asked nothing of others, broke no policy and logged no error. */
export async function openPage(browser, url, options = {}) {
  const context = await browser.newContext({ viewport: { width: 1280, height: 900 }, locale: "en-GB", reducedMotion: "reduce", ...options });
  const page = await context.newPage();
  page.setDefaultTimeout(60_000);
  const origin = new URL(url).origin;
  const complaints = [];
  let expected = /^$/;
  page.on("request", (request) => {
    const to = new URL(request.url());
    if (!["blob:", "data:"].includes(to.protocol) && to.origin !== origin) complaints.push(`asked ${to.href}`);
  });
  page.on("pageerror", (error) => complaints.push(`threw ${error.stack}`));
  page.on("console", (message) => {
    const text = message.text();
    if (message.type() === "error" && !expected.test(text)) complaints.push(`logged ${text}`);
  });
  await page.addInitScript(() => addEventListener("securitypolicyviolation", (event) => console.error(`policy: ${event.violatedDirective} ${event.blockedURI}`)));
  await page.goto(url);
  return {
    page,
    context,
    /** Errors that a test brings about itself. */
    expectErrors: (pattern) => (expected = pattern),
    assertClean: () => assert.deepEqual(complaints, []),
  };
}

/** That axe finds nothing serious. */
export async function assertAccessible(page, where) {
  await page.evaluate(axe);
  const { violations } = await page.evaluate(() => globalThis.axe.run(document, { resultTypes: ["violations"] }));
  const serious = violations.filter((violation) => ["serious", "critical"].includes(violation.impact));
  const told = serious.map(({ id, nodes }) => `${id}: ${nodes.slice(0, 3).map((node) => `${node.html} ${node.failureSummary}`).join(" | ")}`);
  assert.deepEqual(told, [], `axe on ${where}`);
}

/** That nothing reaches beyond the sides of the window. */
export async function assertFits(page, where) {
  const [wide, window] = await page.evaluate(() => [document.documentElement.scrollWidth, document.documentElement.clientWidth]);
  assert.ok(wide <= window, `${where} is ${wide} px wide in a window of ${window}`);
}

/** How many pixels of two screenshots differ visibly, as part of all. */
export async function difference(context, one, other) {
  const blank = await context.newPage();
  try {
    return await blank.evaluate(
      async ([a, b]) => {
        const pixels = async (base64) => {
          const bytes = Uint8Array.from(atob(base64), (letter) => letter.charCodeAt(0));
          const picture = await createImageBitmap(new Blob([bytes]));
          const drawing = new OffscreenCanvas(picture.width, picture.height).getContext("2d");
          drawing.drawImage(picture, 0, 0);
          return drawing.getImageData(0, 0, picture.width, picture.height).data;
        };
        const [first, second] = [await pixels(a), await pixels(b)];
        let differ = 0;
        for (let at = 0; at < first.length; at += 4) {
          if ([0, 1, 2].some((channel) => Math.abs(first[at + channel] - second[at + channel]) > 24)) differ += 1;
        }
        return differ / (first.length / 4);
      },
      [one.toString("base64"), other.toString("base64")],
    );
  } finally {
    await blank.close();
  }
}

/** Drops files on the page as a person would. */
export async function drop(page, files) {
  const given = await Promise.all(files.map(async (path) => [path.split("/").at(-1), (await readFile(path)).toString("base64")]));
  await page.evaluate((encoded) => {
    const dropped = new DataTransfer();
    for (const [name, base64] of encoded) {
      dropped.items.add(new File([Uint8Array.from(atob(base64), (letter) => letter.charCodeAt(0))], name));
    }
    const target = document.getElementById("entrance");
    for (const type of ["dragover", "drop"]) target.dispatchEvent(new DragEvent(type, { dataTransfer: dropped, bubbles: true, cancelable: true }));
  }, given);
}

/** The JSON at a path of the service. */
export async function json(url, path, init) {
  const answer = await fetch(new URL(path, url), init);
  assert.ok(answer.ok, `${path}: ${answer.status} ${await answer.clone().text()}`);
  return answer.json();
}

/** A job when it has ended. */
export async function ended(url, id) {
  for (;;) {
    const job = await json(url, `/v1/reconstructions/${id}`, { headers: { Prefer: "wait=5" } });
    if (job.finished_at !== null) return job;
  }
}
