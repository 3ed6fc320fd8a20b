import type { Job } from "../../client/src/index.ts";
import { t } from "../languages/index.ts";

/** A short name: the end of the id, which differs most. No patient is known here. */
export function nameOf(job: { id: string }): string {
  return job.id.slice(-6);
}

/** Where a job is, in words. */
export function stateOf(job: Job): string {
  if (job.cancel_requested && job.finished_at === null) return t("state.cancelling");
  return t(`state.${job.state}`);
}

/** How many gates it has, in words. */
export function gatesOf(job: Job): string {
  const gates = job.progress.gates_total;
  return gates === 1 ? t("studies.ungated") : t("study.gates", { gates });
}
