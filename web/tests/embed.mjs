// The component on a page of another site with a strict policy: node embed.mjs <service, with CORS for any origin> <study>
import assert from "node:assert/strict";
import { readFile } from "node:fs/promises";
import http from "node:http";
import { difference, ended, json, withBrowser } from "./browser.mjs";

const [url, study] = process.argv.slice(2);
const service = new URL(url).origin;

const job = await ended(url, (await json(url, "/v1/reconstructions", { method: "POST", body: await readFile(study) })).id);
const report = await json(url, job.links.report);
const html = `<!doctype html><html lang="en"><title>Host</title><script type="module" src="${service}/embed/ventricle-viewer.js"></script>
<ventricle-viewer src="${service}${job.links.surfaces}" report="${service}${job.links.report}" gate="1"></ventricle-viewer>`;
const example = (await readFile(new URL("../client/example/index.html", import.meta.url), "utf8"));
const policy = `default-src 'none'; script-src ${service}; connect-src ${service} blob:; img-src blob:`;
const host = http.createServer((request, response) => {
  const isExample = request.url?.startsWith("/example");
  response.writeHead(200, { "Content-Type": "text/html", ...(isExample ? {} : { "Content-Security-Policy": policy }) });
  response.end(isExample ? example : html);
});
await new Promise((resolve) => host.listen(0, "127.0.0.1", resolve));
const site = `http://127.0.0.1:${host.address().port}`;

try {
  await withBrowser(async (browser) => {
    const context = await browser.newContext({ viewport: { width: 700, height: 600 } });
    const page = await context.newPage();
    const complaints = [];
    page.on("console", (message) => message.type() === "error" && !/favicon/.test(message.text() + message.location().url) && complaints.push(message.text()));
    page.on("pageerror", (error) => complaints.push(error.message));
    await page.goto(site);
    const viewer = page.locator("ventricle-viewer");
    await viewer.getByText(`EF ${report.function.ef_percent.toFixed(0)} %`).waitFor();
    const canvas = viewer.locator("canvas");
    const shown = async (attributes) => {
      await viewer.evaluate((element, all) => Object.entries(all).forEach(([name, value]) => element.setAttribute(name, value)), attributes);
      await page.waitForTimeout(400);
      return canvas.screenshot();
    };
    await viewer.evaluate((element) => {
      globalThis.gates = [];
      element.addEventListener("gatechange", (event) => globalThis.gates.push(event.detail));
    });
    const { end_diastolic_gate: full, end_systolic_gate: empty } = report.function;
    const [one, other] = [await shown({ gate: String(full) }), await shown({ gate: String(empty) })];
    assert.ok((await difference(context, one, other)) > 0.01, "gates differ");
    assert.deepEqual(await page.evaluate(() => globalThis.gates.at(-1)), { gate: empty, gates: report.study.gates });
    const coloured = await shown({ colour: "thickening" });
    assert.ok((await difference(context, other, coloured)) > 0.02, "colours show");
    await viewer.getByText("100 %", { exact: true }).waitFor();
    await viewer.evaluate((element) => element.setAttribute("play", ""));
    await page.waitForFunction((count) => new Set(globalThis.gates.map((change) => change.gate)).size >= count, 4);
    assert.deepEqual(complaints, []);

    // Headers, set before the script is there and after, go with both requests.
    const sent = [];
    page.on("request", (request) => request.method() === "GET" && request.url().includes("/v1/reconstructions/") && sent.push(request.headers().authorization));
    await viewer.evaluate((element) => (element.headers = { Authorization: "Bearer later" }));
    await viewer.getByText(`EF ${report.function.ef_percent.toFixed(0)} %`).waitFor();
    assert.deepEqual(sent.splice(0), ["Bearer later", "Bearer later"]);
    await page.addInitScript(() => {
      new MutationObserver((_, observer) => {
        const element = document.querySelector("ventricle-viewer");
        if (element === null) return;
        element.headers = { Authorization: "Bearer early" };
        observer.disconnect();
      }).observe(document, { childList: true, subtree: true });
    });
    await page.goto(site);
    await viewer.getByText(`EF ${report.function.ef_percent.toFixed(0)} %`).waitFor();
    assert.deepEqual(sent.splice(0), ["Bearer early", "Bearer early"]);
    assert.deepEqual(complaints, []);

    // The example page: a file goes in, the model comes out.
    await page.goto(`${site}/example?service=${encodeURIComponent(service)}`);
    await page.locator("#file").setInputFiles(study);
    await page.locator("#said").getByText("succeeded").waitFor();
    await page.locator("ventricle-viewer").getByText(`EF ${report.function.ef_percent.toFixed(0)} %`).waitFor();
    assert.deepEqual(complaints, []);
  });
} finally {
  host.close();
  host.closeAllConnections();
}
