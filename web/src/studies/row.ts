import type { Job } from "../../client/src/index.ts";
import { moment, number, t, told } from "../languages/index.ts";
import { type Child, h, show } from "../page/dom.ts";
import { gatesOf, nameOf, stateOf } from "../page/names.ts";

/** What can be done with a study from the list. */
export interface RowActions {
  open(job: Job): void;
  remove(job: Job, button: HTMLButtonElement): void;
}

/** A row of the list, which can be told of a change without losing the focus within it. */
export interface Row {
  element: HTMLTableRowElement;
  update(job: Job): void;
}

/** The row of a job. */
export function createRow(first: Job, actions: RowActions): Row {
  let job = first;
  const name = nameOf(job);
  const link = h("a", { href: `/studies/${job.id}`, class: "name", "aria-label": t("studies.open", { name }) }, name);
  const facts = h("span", { class: "faint" });
  const state = h("span", { class: "state" });
  const detail = h("span", { class: "faint" });
  const bar = h("progress", { max: 1, "aria-label": t("state.progress", { name }) });
  const ef = h("td", { class: "number strong", "data-label": t("studies.ef") });
  const volumes = h("td", { class: "number", "data-label": t("studies.volumes") });
  const flags = h("td", { class: "flags", "data-label": t("studies.flagsHead") });
  const remove = h("button", { type: "button", class: "quiet", onclick: () => actions.remove(job, remove) });
  link.addEventListener("click", (event) => {
    if (event.metaKey || event.ctrlKey || event.shiftKey) return;
    event.preventDefault();
    actions.open(job);
  });
  const element = h(
    "tr",
    { "data-id": job.id },
    h("th", { scope: "row" }, link, facts),
    h("td", { "data-label": t("studies.when") }, moment(job.created_at)),
    h("td", { class: "progress", "data-label": t("studies.stateHead") }, h("span", { class: "line" }, state, detail), bar),
    ef,
    volumes,
    flags,
    h("td", { class: "last" }, remove),
  );
  const update = (now: Job): void => {
    job = now;
    const ended = job.finished_at !== null;
    facts.textContent = gatesOf(job);
    state.textContent = stateOf(job);
    state.className = `state ${job.state}`;
    detail.textContent = detailOf(job);
    show(bar, !ended);
    if (job.state === "queued") bar.removeAttribute("value");
    else bar.value = job.progress.fraction;
    const { summary } = job;
    const percent = summary?.ef_percent ?? null;
    ef.textContent = percent !== null ? `${number(percent)} %` : "";
    const { edv_ml: edv = null, esv_ml: esv = null } = summary ?? {};
    volumes.textContent = edv !== null && esv !== null ? `${number(edv)} / ${number(esv)} ml` : "";
    flags.replaceChildren(...flagsOf(job));
    remove.textContent = ended ? t("studies.delete") : t("studies.cancel");
    remove.setAttribute("aria-label", t("studies.ofStudy", { action: remove.textContent, name }));
    remove.disabled = job.cancel_requested && !ended;
  };
  update(job);
  return { element, update };
}

function detailOf(job: Job): string {
  if (job.state === "queued" && job.queue_position !== null) return t("state.queue", { place: job.queue_position });
  if (job.state === "running") return job.progress.stage === null ? "" : told("stage", job.progress.stage);
  return "";
}

function flagsOf(job: Job): (Node | string)[] {
  const parts: Child[] = [];
  if (job.error !== null) parts.push(h("span", { class: "flag bad" }, told("code", job.error.code)));
  const codes = [...new Set(job.summary?.flags ?? [])];
  parts.push(...codes.map((code) => h("span", { class: "flag" }, told("flag", code))));
  if (job.state === "succeeded" && codes.length === 0 && job.summary !== null) parts.push(h("span", { class: "faint" }, t("studies.noFlags")));
  return parts.filter((part): part is Node | string => part !== null && part !== false);
}
