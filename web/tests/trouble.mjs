// What goes wrong is told in words, with a way on: node trouble.mjs <service> <file that is refused>
import assert from "node:assert/strict";
import net from "node:net";
import { assertAccessible, drop, ended, json, openPage, withBrowser } from "./browser.mjs";

const [url, refused] = process.argv.slice(2);

/** A way to the service that can be cut. */
function way(port = 0) {
  const { hostname, port: to } = new URL(url);
  const open = new Set();
  const server = net.createServer((near) => {
    const far = net.connect(Number(to), hostname);
    for (const [one, other] of [[near, far], [far, near]]) {
      open.add(one);
      one.pipe(other);
      one.on("error", () => other.destroy());
      one.on("close", () => (open.delete(one), other.destroy()));
    }
  });
  return new Promise((resolve) =>
    server.listen(port, "127.0.0.1", () => {
      const cut = () => new Promise((done) => (server.close(done), open.forEach((socket) => socket.destroy())));
      resolve({ port: server.address().port, cut });
    }),
  );
}

/** A study of noise: it is accepted, and has no ventricle. */
function noise() {
  const counts = new Uint16Array(24 * 32 * 32);
  let seed = 7;
  for (let voxel = 0; voxel < counts.length; voxel += 1) {
    seed = (seed * 48_271) % 2_147_483_647;
    counts[voxel] = 40 + (seed % 20);
  }
  const grid = { gates: 1, shape: [24, 32, 32], spacing_mm: [6, 6, 6] };
  return JSON.stringify({ grid, counts: Buffer.from(counts.buffer).toString("base64"), dtype: "uint16", parameters: { keep_input: true } });
}

await withBrowser(async (browser) => {
  // A failed job.
  const sent = await json(url, "/v1/reconstructions", { method: "POST", body: noise(), headers: { "Content-Type": "application/json" } });
  const failed = await ended(url, sent.id);
  assert.equal(failed.state, "failed");
  const { page, assertClean, expectErrors } = await openPage(browser, new URL(`/studies/${failed.id}`, url).href);
  const told = page.getByRole("alert");
  await told.waitFor();
  const words = await told.innerText();
  assert.ok(words.includes("No left ventricle found") && words.includes(failed.error.detail) && words.includes("try the other method"), words);
  await assertAccessible(page, "a failed job");
  await told.getByRole("button", { name: "Run again: clinical" }).click();
  await page.waitForURL((address) => !address.pathname.endsWith(failed.id));
  await told.getByText("No left ventricle found").waitFor();
  await told.getByRole("link", { name: "All studies" }).click();
  await page.locator(`tr[data-id="${failed.id}"]`).getByText("No left ventricle found").waitFor();

  // A refused file.
  expectErrors(/status of (415|422|404)/);
  await drop(page, [refused]);
  await told.waitFor();
  const why = await told.innerText();
  assert.match(why, /was not accepted/);
  assert.match(why, /no nuclear medicine study/);
  await assertAccessible(page, "a refused file");
  await told.getByRole("button", { name: "Dismiss" }).click();
  await told.waitFor({ state: "detached" });

  // No such study, no such page.
  await page.goto(new URL("/studies/00000000-0000-7000-8000-000000000000", url).href);
  await page.getByText("There is no such study").waitFor();
  await page.getByRole("alert").getByRole("link", { name: "All studies" }).click();
  await page.locator("tr[data-id]").first().waitFor();
  assertClean();
  await page.close();

  // A service that goes away and comes back.
  const first = await way();
  const near = `http://127.0.0.1:${first.port}/`;
  const list = await openPage(browser, near);
  list.expectErrors(/Failed to load resource|ERR_/);
  await list.page.locator(".live").waitFor();
  await first.cut();
  const lost = list.page.getByRole("alert");
  await lost.getByText("The service cannot be reached").waitFor();
  assert.equal(await list.page.locator(".live").isVisible(), false);
  await assertAccessible(list.page, "an unreachable service");
  await drop(list.page, [refused]);
  await list.page.getByText("was not accepted").waitFor();
  await list.page.locator(".uploads").getByRole("button", { name: "Dismiss" }).click();
  await lost.getByRole("button", { name: "Try again" }).click();
  await lost.getByText("The service cannot be reached").waitFor();
  const second = await way(first.port);
  // By itself, without a click.
  await list.page.locator(".live").waitFor();
  await lost.waitFor({ state: "detached" });
  list.assertClean();
  await list.context.close();
  await second.cut();
});
