// Files of several series dropped at once become one study each: node series.mjs <service> <number of studies> <file>...
import assert from "node:assert/strict";
import { drop, ended, json, openPage, withBrowser } from "./browser.mjs";

const [url, studies, ...files] = process.argv.slice(2);

await withBrowser(async (browser) => {
  const { page, assertClean } = await openPage(browser, url);
  await page.locator(".live").waitFor();
  await drop(page, files);
  const rows = page.locator("tr[data-id]");
  await rows.nth(Number(studies) - 1).waitFor();
  await page.locator(".upload").first().waitFor({ state: "detached" });
  const { reconstructions } = await json(url, "/v1/reconstructions");
  assert.equal(reconstructions.length, Number(studies));
  assert.equal(await page.getByRole("alert").count(), 0);
  const states = await Promise.all(reconstructions.map(async ({ id }) => (await ended(url, id)).state));
  assert.deepEqual(new Set(states), new Set(["succeeded"]));
  assertClean();
});
