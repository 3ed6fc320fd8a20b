import type { Client as FetchClient } from "openapi-fetch";
import { ProblemError } from "./problem.ts";
import type { paths } from "./schema.ts";
import { study } from "./study.ts";
import type { Job, Parameters, Report } from "./types.ts";

/** How to reconstruct a file. */
export interface ReconstructOptions {
  /** What differs from the preset; `GET /v1/parameters` lists all. */
  parameters?: Parameters;
  /** Stops waiting. The reconstruction goes on; `DELETE` its address to end it. */
  signal?: AbortSignal;
  /** Makes a repetition of the same request the same job (RFC draft Idempotency-Key). */
  idempotencyKey?: string;
}

/** A step on the way: how far the job is, and at the end its report. */
export type Reconstruction = { done: false; job: Job } | { done: true; job: Job; report: Report };

/** Seconds that one request waits for a change; the service caps it at 30. */
const WAIT_SECONDS = 20;

/**
 * Posts a study and yields the job each time it changes; the last step has `done: true` and the report. Refusals, failed and cancelled
 * jobs throw a `ProblemError`.
 */
export async function* reconstruct(
  api: FetchClient<paths>,
  file: Blob | readonly Blob[],
  options: ReconstructOptions,
): AsyncGenerator<Reconstruction, void, undefined> {
  const signal = options.signal ?? null;
  const { body, contentType } = study(file, options.parameters);
  const submitted = await api.POST("/v1/reconstructions", {
    params: { header: { "Idempotency-Key": options.idempotencyKey ?? null } },
    body: body as never,
    bodySerializer: (whole: unknown) => whole as BodyInit,
    headers: { "Content-Type": contentType, "Idempotency-Key": options.idempotencyKey ?? null },
    signal,
  });
  let job = expected(submitted.data);
  let version = submitted.response.headers.get("etag");
  while (job.finished_at === null) {
    yield { done: false, job };
    const answer = await api.GET("/v1/reconstructions/{id}", {
      params: { path: { id: job.id } },
      headers: { Prefer: `wait=${WAIT_SECONDS}`, "If-None-Match": version },
      signal,
    });
    if (answer.response.status === 304) continue;
    job = expected(answer.data);
    version = answer.response.headers.get("etag");
  }
  if (job.state !== "succeeded") throw new ProblemError(job.error ?? cancelled(job));
  const report = await api.GET("/v1/reconstructions/{id}/report", { params: { path: { id: job.id } }, signal });
  yield { done: true, job, report: expected(report.data) };
}

function expected<T>(data: T | undefined): T {
  if (data === undefined) throw new TypeError("The service answered without the JSON that its contract promises.");
  return data;
}

function cancelled(job: Job): NonNullable<Job["error"]> {
  const detail = `The reconstruction ${job.id} was cancelled; post the study again to have it.`;
  return { type: "urn:problem-type:ventricle:cancelled", title: "Cancelled", status: 409, code: "cancelled", detail };
}
