// The client against a service that runs at VENTRICLE_URL, with the study VENTRICLE_STUDY.
import assert from "node:assert/strict";
import { openAsBlob } from "node:fs";
import { test } from "node:test";
import { createClient, ProblemError } from "../dist/index.js";

const url = process.env.VENTRICLE_URL;
const study = process.env.VENTRICLE_STUDY;
assert.ok(url && study, "VENTRICLE_URL and VENTRICLE_STUDY say where the service and a study are");
const ventricle = createClient(`${url}/`);

test("a study goes from file to report, and tells how far it is", async () => {
  const steps = [];
  for await (const step of ventricle.reconstruct(await openAsBlob(study))) steps.push(step);
  const last = steps.at(-1);
  assert.equal(last.done, true);
  assert.equal(last.job.state, "succeeded");
  assert.ok(steps.slice(0, -1).every((step) => !step.done) && steps.length > 2, `${steps.length} steps`);
  const fractions = steps.map((step) => step.job.progress.fraction);
  assert.deepEqual(fractions, [...fractions].sort((a, b) => a - b));
  assert.ok(last.report.function.ef_percent > 0 && last.report.function.ef_percent < 100);
  const own = await (await fetch(url + last.job.links.report)).json();
  assert.deepEqual(last.report, own);
});

test("parameters go along, and the same idempotency key is the same job", async () => {
  const ids = [];
  for (let time = 0; time < 2; time += 1) {
    const options = { parameters: { mesh: { level: 2 } }, idempotencyKey: `client-test-${process.pid}` };
    for await (const step of ventricle.reconstruct([await openAsBlob(study)], options)) {
      if (!step.done) continue;
      ids.push(step.job.id);
      assert.equal(step.report.parameters.mesh.level, 2);
    }
  }
  assert.equal(ids.length, 2);
  assert.equal(ids[0], ids[1]);
});

test("what is refused is thrown with its code and its sentence", async () => {
  const refused = async () => {
    for await (const step of ventricle.reconstruct(new Blob(["no study"]))) assert.fail(`accepted ${step.job.id}`);
  };
  await assert.rejects(refused, (error) => {
    assert.ok(error instanceof ProblemError);
    assert.equal(error.status, 415);
    assert.equal(error.code, error.problem.code);
    assert.equal(error.message, error.problem.detail);
    return true;
  });
  const unknown = { params: { path: { id: "00000000-0000-7000-8000-000000000000" } } };
  await assert.rejects(ventricle.api.GET("/v1/reconstructions/{id}", unknown), { name: "ProblemError", status: 404, code: "not_found" });
});

test("an aborted signal ends the waiting at once", async () => {
  const stop = new AbortController();
  const begun = performance.now();
  const waiting = async () => {
    for await (const step of ventricle.reconstruct(await openAsBlob(study), { signal: stop.signal })) {
      assert.equal(step.done, false);
      stop.abort();
    }
  };
  await assert.rejects(waiting, { name: "AbortError" });
  assert.ok(performance.now() - begun < 5000);
});

test("every operation of the contract is there with its types", async () => {
  const { data } = await ventricle.api.GET("/v1/reconstructions", { params: { query: { state: "succeeded", limit: 1 } } });
  assert.equal(data.reconstructions.length, 1);
  const { data: maps } = await ventricle.api.GET("/v1/reconstructions/{id}/polar-maps", { params: { path: { id: data.reconstructions[0].id } } });
  assert.equal(maps.maps[0].segments.length, 17);
});
