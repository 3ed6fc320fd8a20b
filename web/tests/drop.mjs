// A study is dropped on the page, and looked at: node drop.mjs <service> <study.dcm> [<folder for screenshots>]
import assert from "node:assert/strict";
import { writeFile } from "node:fs/promises";
import { join } from "node:path";
import { assertAccessible, assertFits, difference, drop, ended, json, openPage, withBrowser } from "./browser.mjs";

const [url, study, pictures] = process.argv.slice(2);

await withBrowser(async (browser) => {
  const { page, context, assertClean } = await openPage(browser, url);
  await page.getByText("No studies yet").waitFor();

  // Progress moves on the list while the file is worked on.
  await page.evaluate(() => {
    globalThis.seen = [];
    new MutationObserver(() => {
      const bar = document.querySelector("tr[data-id] progress");
      if (bar?.hasAttribute("value") && !bar.hidden) globalThis.seen.push(bar.value);
    }).observe(document.body, { subtree: true, childList: true, attributes: true, characterData: true });
  });
  await drop(page, [study]);
  const row = page.locator("tr[data-id]");
  await row.waitFor();
  await row.getByText("Done").waitFor();
  const seen = [...new Set(await page.evaluate(() => globalThis.seen))].filter((part) => part > 0 && part < 1);
  assert.ok(seen.length >= 2, `progress stood at ${JSON.stringify(seen)}`);
  assert.deepEqual(seen, [...seen].sort((a, b) => a - b));
  const [job] = (await json(url, "/v1/reconstructions")).reconstructions;
  const report = await json(url, job.links.report);
  assert.match(await row.innerText(), new RegExp(`${Math.round(report.function.ef_percent)} %`));
  assert.equal(job.input_kept, true);

  // The model moves: end diastole and end systole are half a cycle or so apart.
  await row.getByRole("link").click();
  await page.waitForURL(`**/studies/${job.id}`);
  const canvas = page.locator("canvas.model");
  await canvas.waitFor();
  const { gates } = report.study;
  const picture = async (gate) => {
    await page.locator("#gate").fill(String(gate));
    await page.getByText(`Gate ${gate} of ${gates}`).waitFor();
    await page.waitForTimeout(300);
    return canvas.screenshot();
  };
  const apart = 1 + ((report.function.end_diastolic_gate - 1 + gates / 2) % gates);
  const [filled, halfway] = [await picture(report.function.end_diastolic_gate), await picture(apart)];
  const moved = await difference(context, filled, halfway);
  assert.ok(moved > 0.01, `${moved} of the pixels differ half a cycle later`);
  assert.ok((await difference(context, filled, await picture(report.function.end_diastolic_gate))) < 0.001, "a gate looks the same again");
  for (const [box, least] of [["#endocardial", 0.02], ["#epicardial", 0.02], ["#translucent", 0.02]]) {
    const before = await canvas.screenshot();
    await page.locator(box).uncheck();
    await page.waitForTimeout(300);
    const changed = await difference(context, before, await canvas.screenshot());
    assert.ok(changed > least, `${box} changes ${changed} of the pixels`);
    await page.locator(box).check();
  }
  for (const colour of ["perfusion", "end_diastolic_thickness", "thickening", "motion", "phase"]) {
    const before = await canvas.screenshot();
    await page.locator("#colour").selectOption(colour);
    await page.waitForTimeout(300);
    assert.ok((await difference(context, before, await canvas.screenshot())) > 0.02, `${colour} colours the model`);
    const unit = { perfusion: "100 %", thickening: "100 %", phase: "360°", motion: "12 mm" }[colour] ?? "20 mm";
    assert.equal(await page.locator(".model-panel .legend span").last().innerText(), unit);
  }
  await page.locator("#colour").selectOption("");
  await page.locator("#play").click();
  const playing = new Set();
  for (let look = 0; look < 40 && playing.size < 3; look += 1) {
    playing.add(await page.locator(".gate-said").innerText());
    await page.waitForTimeout(60);
  }
  assert.ok(playing.size >= 3, `it plays through ${[...playing].join(", ")}`);
  await page.locator("#play").click();

  // The curve has the report's points, and is linked to the gate.
  const points = JSON.parse(await page.locator(".plot").getAttribute("data-points"));
  assert.deepEqual(points, report.cycle.gates.map((gate) => [gate.rr_percent, gate.endocardial_ml]));
  assert.equal(points.length, gates);
  const plot = await page.locator(".plot .u-over").boundingBox();
  await page.locator(".plot .u-over").click({ position: { x: (plot.width * points[3][0]) / 100, y: 20 } });
  await page.getByText(`Gate 4 of ${gates}`).waitFor();

  // Segments: pointing at one shows it on the model, and pointing at the model shows it on the maps.
  await page.locator("#perfusion-7").hover();
  await page.locator("#thickening-7.chosen").waitFor();
  assert.match(await page.locator(".maps-panel .readout").innerText(), /^7 mid anterior: Perfusion \d+ %/);
  await page.mouse.move(2, 2);
  const plain = await canvas.screenshot();
  await page.locator("svg[role=listbox]").first().focus();
  for (let segment = 1; segment <= 7; segment += 1) await page.keyboard.press("ArrowRight");
  await page.locator("#phase-7.chosen").waitFor();
  assert.ok((await difference(context, plain, await canvas.screenshot())) > 0.01, "the segment stands out on the model");
  await canvas.scrollIntoViewIfNeeded();
  const box = await canvas.boundingBox();
  const read = page.locator(".model-panel .readout");
  for (let look = 0; look < 30 && !/^\d/.test(await read.innerText()); look += 1) {
    await page.mouse.move(box.x + box.width / 2 + look, box.y + box.height / 2);
    await page.waitForTimeout(200);
  }
  assert.equal(await page.locator("g.chosen").count(), 6, "one segment on each of the maps");
  assert.match(await page.locator(".model-panel .readout").innerText(), /^\d+ (basal|mid|apical|apex)/);

  // A distance of two points, set with the keyboard alone.
  await page.locator("#measure").click();
  await page.keyboard.press("Enter");
  for (let turn = 0; turn < 3; turn += 1) await page.keyboard.press("ArrowRight");
  await page.keyboard.press("Enter");
  await page.waitForFunction(() => /\d mm/.test(document.querySelector(".measure .said").textContent));
  const mm = Number.parseFloat(await page.locator(".measure .said").innerText());
  assert.ok(mm > 1 && mm < 80, `${mm} mm between two points of a ventricle`);
  await page.locator("#measure").click();

  // Contours: as numbers on the wall, and drawn where the numbers say.
  await page.locator("#gate").fill(String(report.function.end_diastolic_gate));
  await assertOnTheWall(page, job, report.function.end_diastolic_gate);

  await page.locator(".model-panel").scrollIntoViewIfNeeded();
  for (const colorScheme of ["light", "dark"]) {
    await page.emulateMedia({ colorScheme, reducedMotion: "reduce" });
    for (const width of [360, 768, 1440]) {
      await page.setViewportSize({ width, height: 900 });
      await page.waitForTimeout(300);
      await assertFits(page, `the study at ${width} px`);
      if (pictures !== undefined) await page.screenshot({ path: join(pictures, `study-${width}-${colorScheme}.png`), fullPage: true });
      if (width !== 768) await assertAccessible(page, `the study at ${width} px, ${colorScheme}`);
    }
  }
  await page.setViewportSize({ width: 1280, height: 900 });

  // Again, with a circle that is moved by keys and by the pointer.
  await page.locator("#again-region").check();
  await page.locator("canvas.region").focus();
  const centre = Number(await page.locator("#region-x").inputValue());
  const radius = Number(await page.locator("#region-radius").inputValue());
  await page.keyboard.press("ArrowRight");
  await page.keyboard.press("+");
  const region = await page.locator("canvas.region").boundingBox();
  const [x, y] = [region.x + region.width / 2, region.y + region.height / 2];
  await page.mouse.move(x, y);
  await page.mouse.down();
  await page.mouse.move(x + 6, y, { steps: 3 });
  await page.mouse.up();
  const wanted = { x: Number(await page.locator("#region-x").inputValue()), radius: Number(await page.locator("#region-radius").inputValue()) };
  assert.ok(wanted.x > centre + 2.5, `the centre moved from ${centre} to ${wanted.x}`);
  assert.equal(wanted.radius, Math.round((radius + 2) * 10) / 10);
  await page.locator("#again-level").selectOption("2");
  await page.getByRole("button", { name: "Run again" }).click();
  await page.waitForURL((address) => address.pathname.startsWith("/studies/") && !address.pathname.endsWith(job.id));
  const again = await ended(url, new URL(page.url()).pathname.split("/").at(-1));
  assert.equal(again.state, "succeeded", JSON.stringify(again.error));
  const { parameters } = await json(url, again.links.report);
  assert.equal(parameters.mesh.level, 2);
  assert.equal(parameters.region.centre_mm[0], wanted.x);
  assert.equal(parameters.region.radius_mm, wanted.radius);
  await canvas.waitFor();
  assertClean();
});

/** The counts half way through the wall are higher than in the cavity and beyond the wall; and the contours are drawn there. */
async function assertOnTheWall(page, job, gate) {
  await page.locator("#contours").waitFor();
  const found = await page.evaluate(
    async ([id, shown]) => {
      const answer = await (await fetch(`/v1/reconstructions/${id}/slices`)).json();
      const plane = answer.planes.find((candidate) => candidate.plane === "short_axis");
      const picture = await createImageBitmap(await (await fetch(`/v1/reconstructions/${id}/gates/${shown}/slices.png?plane=short_axis`)).blob());
      const drawing = new OffscreenCanvas(picture.width, picture.height).getContext("2d");
      drawing.drawImage(picture, 0, 0);
      const { data } = drawing.getImageData(0, 0, picture.width, picture.height);
      const size = [picture.width, picture.height / plane.slices];
      const grey = (slice, x, y) => data[4 * ((slice * plane.height + Math.round(y)) * plane.width + Math.round(x))];
      const sums = { slices: 0, wall: 0, cavity: 0, outside: 0, size, expected: [plane.width, plane.height] };
      const mean = (values) => values.reduce((sum, value) => sum + value, 0) / values.length;
      plane.gates[shown - 1].slices.forEach(({ endocardial, epicardial }, slice) => {
        if (endocardial.length !== 1 || epicardial.length !== 1) return;
        const [inner, outer] = [endocardial[0], epicardial[0]];
        const centre = [0, 1].map((axis) => mean(inner.map((point) => point[axis])));
        const middles = [];
        const beyond = [];
        for (const point of inner) {
          const angle = Math.atan2(point[1] - centre[1], point[0] - centre[0]);
          const apart = (other) => Math.abs(((Math.atan2(other[1] - centre[1], other[0] - centre[0]) - angle + 3 * Math.PI) % (2 * Math.PI)) - Math.PI);
          const facing = outer.reduce((best, other) => (apart(other) < apart(best) ? other : best));
          middles.push(grey(slice, (point[0] + facing[0]) / 2, (point[1] + facing[1]) / 2));
          const far = 14 / plane.pixel_mm[0];
          beyond.push(grey(slice, facing[0] + far * Math.cos(angle), facing[1] + far * Math.sin(angle)));
        }
        sums.slices += 1;
        sums.wall += mean(middles);
        sums.outside += mean(beyond.filter((value) => value !== undefined));
        sums.cavity += grey(slice, centre[0], centre[1]);
      });
      return sums;
    },
    [job.id, gate],
  );
  assert.deepEqual(found.size, found.expected);
  assert.ok(found.slices >= 6, `${found.slices} slices have both contours`);
  assert.ok(found.wall > 1.25 * found.cavity && found.wall > 1.25 * found.outside, JSON.stringify(found));
  // The drawing: the epicardial contour's colour stands at its points.
  const drawn = await page.evaluate(
    async ([id, shown]) => {
      const answer = await (await fetch(`/v1/reconstructions/${id}/slices`)).json();
      const plane = answer.planes[0];
      const canvas = document.querySelector("canvas.large");
      const slice = Math.floor(plane.slices / 2);
      const context = canvas.getContext("2d");
      const scale = canvas.width / plane.width;
      const line = plane.gates[shown - 1].slices[slice].epicardial[0];
      const hits = line.filter(([x, y]) => {
        const [red, green, blue] = context.getImageData(Math.round((x + 0.5) * scale), Math.round((y + 0.5) * scale), 1, 1).data;
        return blue > red + 60 && green > red + 60;
      });
      return hits.length / line.length;
    },
    [job.id, gate],
  );
  assert.ok(drawn > 0.9, `the contour is drawn at ${drawn} of its points`);
  console.log(`counts half way through the wall ${(found.wall / found.slices).toFixed(0)}, in the cavity ${(found.cavity / found.slices).toFixed(0)}, outside ${(found.outside / found.slices).toFixed(0)}`);
}
