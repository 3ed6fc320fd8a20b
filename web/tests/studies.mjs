// The list: phantom, live changes, languages, keys, accessibility: node studies.mjs <service> <other study>
import assert from "node:assert/strict";
import { readFile } from "node:fs/promises";
import { assertAccessible, assertFits, ended, json, openPage, withBrowser } from "./browser.mjs";

const [url, other] = process.argv.slice(2);

await withBrowser(async (browser) => {
  const { page, assertClean } = await openPage(browser, url);
  await page.locator(".live").waitFor();

  // The phantom comes from the service, is uploaded as any file, and succeeds.
  await page.locator("#phantom").click();
  const rows = page.locator("tr[data-id]");
  await rows.first().getByText("Done").waitFor();
  const [job] = (await json(url, "/v1/reconstructions")).reconstructions;
  assert.deepEqual([job.state, job.input_kept], ["succeeded", true]);
  assert.ok(job.summary.ef_percent > 40 && job.summary.ef_percent < 80, `${job.summary.ef_percent}`);

  // What others send and delete is seen here without a reload.
  const sent = await json(url, "/v1/reconstructions", { method: "POST", body: await readFile(other) });
  const row = page.locator(`tr[data-id="${sent.id}"]`);
  await row.waitFor();
  await row.getByText("Done").waitFor();
  const done = await ended(url, sent.id);
  assert.match(await row.innerText(), new RegExp(`${Math.round(done.summary.ef_percent)} %`));
  assert.deepEqual(await rows.evaluateAll((all) => all.map((one) => one.dataset.id)), [sent.id, job.id], "the newest stands first");
  await fetch(new URL(done.links.self, url), { method: "DELETE" });
  await row.waitFor({ state: "detached" });

  // A study without its counts says so, and what to do.
  const bare = await json(url, "/v1/reconstructions", { method: "POST", body: await readFile(other) });
  await ended(url, bare.id);
  await page.goto(new URL(`/studies/${bare.id}`, url).href);
  await page.getByText("so only the contours can be drawn").waitFor();
  await page.getByText("then it can be run with other parameters").waitFor();
  await page.goto(url);
  await rows.nth(1).waitFor();

  for (const colorScheme of ["light", "dark"]) {
    await page.emulateMedia({ colorScheme });
    for (const width of [360, 1440]) {
      await page.setViewportSize({ width, height: 800 });
      await assertFits(page, `the list at ${width} px`);
      await assertAccessible(page, `the list at ${width} px, ${colorScheme}`);
    }
  }

  // Every language says everything, and is kept.
  const words = { de: "Studien", es: "Estudios", en: "Studies" };
  for (const [tag, title] of Object.entries(words)) {
    await page.locator("#language").selectOption(tag);
    await page.getByRole("heading", { level: 1, name: title, exact: true }).waitFor();
    assert.equal(await page.evaluate(() => document.documentElement.lang), tag);
    await page.setViewportSize({ width: 360, height: 800 });
    await rows.first().waitFor();
    await assertFits(page, `the list in ${tag}`);
    const text = await page.locator("body").innerText();
    assert.doesNotMatch(text, /\{\w+\}|\b[a-z]+\.[a-z]+[A-Z]\w*/, "no name of a text is left");
  }
  await page.locator("#language").selectOption("es");
  await page.reload();
  await page.getByRole("heading", { level: 1, name: "Estudios" }).waitFor();
  await page.locator("#language").selectOption("en");

  // Opened, deleted and confirmed by keys alone.
  await page.locator(`tr[data-id="${bare.id}"] button`).focus();
  await page.keyboard.press("Enter");
  await page.locator("dialog").waitFor();
  await page.keyboard.press("Escape");
  await page.locator("dialog").waitFor({ state: "detached" });
  await page.locator(`tr[data-id="${bare.id}"] button`).focus();
  await page.keyboard.press("Enter");
  await page.locator("dialog button.danger").focus();
  await page.keyboard.press("Enter");
  await page.locator(`tr[data-id="${bare.id}"]`).waitFor({ state: "detached" });
  assert.equal((await fetch(new URL(`/v1/reconstructions/${bare.id}`, url))).status, 404);
  await page.locator(`tr[data-id="${job.id}"] a`).focus();
  await page.keyboard.press("Enter");
  await page.waitForURL(`**/studies/${job.id}`);
  assertClean();
});
