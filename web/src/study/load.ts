import { type Job, ProblemError, type Slices } from "../../client/src/index.ts";
import { createCycle } from "../page/cycle.ts";
import { observed } from "../page/observed.ts";
import { body, bytes, client } from "../page/service.ts";
import { readModel } from "../scene/load.ts";
import type { Shown } from "./shared.ts";

/** Everything that the page of a finished study shows, fetched at once. */
export async function loadShown(job: Job, signal: AbortSignal): Promise<Shown> {
  const params = { path: { id: job.id } };
  const [report, maps, slices, model] = await Promise.all([
    client.api.GET("/v1/reconstructions/{id}/report", { params, signal }).then(body),
    client.api.GET("/v1/reconstructions/{id}/polar-maps", { params, signal }).then(body),
    slicesOf(job.id, signal),
    bytes(job.links.surfaces, signal).then(readModel),
  ]);
  const cycle = createCycle(model.timing, signal);
  const shown: Shown = { job, report, maps, slices, model, cycle, segment: observed<number | null>(null), quantity: observed<string | null>(null), signal };
  // It beats at once, but for people who want less motion.
  if (cycle.gates > 1 && !matchMedia("(prefers-reduced-motion: reduce)").matches) cycle.playing.set(true);
  return shown;
}

/** A study of before slices were stored has none. */
async function slicesOf(id: string, signal: AbortSignal): Promise<Slices | null> {
  try {
    return body(await client.api.GET("/v1/reconstructions/{id}/slices", { params: { path: { id } }, signal }));
  } catch (error) {
    if (error instanceof ProblemError && error.status === 404) return null;
    throw error;
  }
}
