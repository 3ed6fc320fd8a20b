import { type Job, ProblemError } from "../../client/src/index.ts";
import { moment, number, t, told } from "../languages/index.ts";
import { type Child, h, show } from "../page/dom.ts";
import { followJobs } from "../page/jobs.ts";
import { gatesOf, nameOf, stateOf } from "../page/names.ts";
import { follow, go } from "../page/router.ts";
import { body, client } from "../page/service.ts";
import { box, isAborted, problemBox, troubleOf } from "../page/trouble.ts";
import { confirmed } from "../studies/confirm.ts";
import { loadShown } from "./load.ts";
import { results } from "./results.ts";

/** The page of one study: how far it is, and its results when it is done. */
export function studyPage(id: string, signal: AbortSignal): HTMLElement {
  const name = nameOf({ id });
  const state = h("span", { class: "state" });
  const facts = h("p", { class: "faint facts" });
  const remove = h("button", { type: "button", class: "quiet" }, t("studies.delete"));
  const place = h("div", { class: "place" });
  const announced = h("p", { class: "unseen", role: "status", "aria-live": "polite" });
  const waiting = createWaiting(name);
  let job: Job | null = null;
  let said = "";

  const back = () => h("a", { href: "/", class: "button", onclick: follow }, t("app.back"));
  const retry = (again: () => void) => h("button", { type: "button", class: "primary", onclick: again }, t("app.retry"));
  const update = (now: Job): void => {
    const before = job;
    // An answer that was on its way while an event overtook it.
    if (before !== null && before.finished_at !== null) return;
    job = now;
    state.textContent = stateOf(now);
    state.className = `state ${now.state}`;
    facts.replaceChildren(factsOf(now));
    const ended = now.finished_at !== null;
    remove.textContent = ended ? t("studies.delete") : t("studies.cancel");
    remove.disabled = !ended && now.cancel_requested;
    if (said !== "" && said !== state.textContent) announced.textContent = t("state.announce", { name, state: state.textContent });
    said = state.textContent;
    if (!ended) {
      if (waiting.element.parentElement !== place) place.replaceChildren(waiting.element);
      waiting.update(now);
    } else {
      void finish(now);
    }
  };
  const finish = async (done: Job): Promise<void> => {
    if (done.state !== "succeeded") {
      const problem = done.error ?? { code: "cancelled", title: t("code.cancelled"), detail: "", status: 0, type: "" };
      const again = (["clinical", "paper"] as const)
        .filter(() => done.input_kept)
        .map((preset) => h("button", { type: "button", onclick: () => void runAgain(done, preset, place) }, t("again.runPreset", { preset })));
      place.replaceChildren(problemBox(problem, [...again, back()]));
      return;
    }
    place.replaceChildren(h("p", { class: "faint", role: "status" }, t("app.loading")));
    try {
      place.replaceChildren(results(await loadShown(done, signal)));
    } catch (error) {
      if (!isAborted(error)) place.replaceChildren(troubleOf(error, [retry(() => void finish(done)), back()]));
    }
  };
  const load = async (): Promise<void> => {
    try {
      update(body(await client.api.GET("/v1/reconstructions/{id}", { params: { path: { id } }, signal })));
    } catch (error) {
      if (isAborted(error)) return;
      if (error instanceof ProblemError && error.status === 404) gone();
      else place.replaceChildren(troubleOf(error, [retry(() => void load()), back()]));
    }
  };
  const gone = (): void => {
    show(remove, false);
    place.replaceChildren(box(t("trouble.noStudy"), [h("p", {}, t("trouble.noStudy.detail"))], [back()]));
  };
  remove.addEventListener("click", () => {
    void (async () => {
      if (job === null) return;
      const ended = job.finished_at !== null;
      if (ended && !(await confirmed(t("studies.confirm", { name }), t("studies.delete"), t("studies.confirm.no")))) return;
      remove.disabled = true;
      try {
        await client.api.DELETE("/v1/reconstructions/{id}", { params: { path: { id } } });
        if (ended) go("/");
      } catch (error) {
        remove.disabled = false;
        place.prepend(troubleOf(error, [back()]));
      }
    })();
  });
  const isSettled = () => job !== null && job.finished_at !== null;
  followJobs(
    {
      // A finished study does not change any more: what is shown stays as it is.
      opened: () => {
        if (!isSettled()) void load();
      },
      changed: (now) => now.id === id && update(now),
      deleted: (other) => other === id && gone(),
      lost: () => {
        if (isSettled()) return;
        place.replaceChildren(troubleOf(new TypeError("no answer"), [retry(() => void load()), back()]));
      },
    },
    signal,
  );
  void load();
  return h(
    "div",
    { class: "page study-page" },
    h("nav", { class: "crumbs", "aria-label": t("app.back") }, h("a", { href: "/", onclick: follow }, `← ${t("app.back")}`)),
    h("div", { class: "title" }, h("h1", { tabindex: -1 }, t("study.title", { name })), state, h("span", { class: "spring" }), remove),
    facts,
    place,
    announced,
  );
}

/** A failed or cancelled job on the same counts. */
async function runAgain(job: Job, preset: "clinical" | "paper", place: HTMLElement): Promise<void> {
  try {
    go(`/studies/${body(await client.api.POST("/v1/reconstructions/{id}/again", { params: { path: { id: job.id } }, body: { preset, keep_input: true } })).id}`);
  } catch (error) {
    place.append(troubleOf(error));
  }
}

function factsOf(job: Job): string {
  const parts = [gatesOf(job), t("study.received", { when: moment(job.created_at) })];
  if (job.expires_at !== null) parts.push(t("study.expires", { when: moment(job.expires_at) }));
  return parts.join(" · ");
}

function createWaiting(name: string): { element: HTMLElement; update(job: Job): void } {
  const stage = h("p", { class: "stage-said" });
  const bar = h("progress", { max: 1, "aria-label": t("state.progress", { name }) });
  const eta = h("p", { class: "faint" });
  const children: Child[] = [stage, bar, eta, h("p", { class: "faint" }, t("study.waiting"))];
  return {
    element: h("div", { class: "card waiting" }, ...children),
    update(job) {
      if (job.state === "queued") bar.removeAttribute("value");
      else bar.value = job.progress.fraction;
      const { stage: now } = job.progress;
      stage.textContent = job.state === "queued" && job.queue_position !== null ? t("state.queue", { place: job.queue_position }) : now === null ? stateOf(job) : told("stage", now);
      eta.textContent = job.eta_seconds === null ? "" : t("state.eta", { seconds: number(Math.max(1, job.eta_seconds)) });
    },
  };
}
