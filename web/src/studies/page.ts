import type { Job } from "../../client/src/index.ts";
import { t } from "../languages/index.ts";
import { h, show } from "../page/dom.ts";
import { followJobs } from "../page/jobs.ts";
import { nameOf, stateOf } from "../page/names.ts";
import { go } from "../page/router.ts";
import { body, client } from "../page/service.ts";
import { isAborted, troubleOf } from "../page/trouble.ts";
import { confirmed } from "./confirm.ts";
import { createEntrance } from "./entrance.ts";
import { createRow, type Row } from "./row.ts";
import { createUploads } from "./uploads.ts";

/** Studies of one page of the list. */
const LIMIT = 50;

/** The page that lists all studies and takes in new ones. */
export function studiesPage(signal: AbortSignal): HTMLElement {
  const rows = new Map<string, Row>();
  const states = new Map<string, string>();
  let cursor: string | null = null;
  const list = h("tbody", {});
  const live = h("span", { class: "live" }, t("studies.live"));
  const announced = h("p", { class: "unseen", role: "status", "aria-live": "polite" });
  const trouble = h("div", { "aria-live": "assertive" });
  const empty = h("div", { class: "empty" }, h("h3", {}, t("studies.empty")), h("p", { class: "faint" }, t("studies.empty.detail")));
  const more = h("button", { type: "button", onclick: () => void load(cursor) }, t("studies.more"));
  const table = h("table", { class: "studies" }, h("thead", {}, h("tr", {}, ...heads())), list);
  [empty, more, table, live].forEach((part) => show(part, false));

  const settle = (): void => {
    show(table, rows.size > 0);
    show(empty, rows.size === 0);
    show(more, cursor !== null);
  };
  const put = (job: Job): void => {
    const said = stateOf(job);
    if (states.has(job.id) && states.get(job.id) !== said) announced.textContent = t("state.announce", { name: nameOf(job), state: said });
    states.set(job.id, said);
    const known = rows.get(job.id);
    if (known !== undefined) {
      known.update(job);
      return;
    }
    const row = createRow(job, { open: (opened) => go(`/studies/${opened.id}`), remove });
    rows.set(job.id, row);
    // Ids of later jobs sort after those of earlier ones, and the newest stands first.
    const after = [...list.children].find((other) => (other.getAttribute("data-id") ?? "") < job.id);
    list.insertBefore(row.element, after ?? null);
  };
  const drop = (id: string): void => {
    rows.get(id)?.element.remove();
    rows.delete(id);
    states.delete(id);
    settle();
  };
  const remove = async (job: Job, button: HTMLButtonElement): Promise<void> => {
    const ended = job.finished_at !== null;
    if (ended && !(await confirmed(t("studies.confirm", { name: nameOf(job) }), t("studies.delete"), t("studies.confirm.no")))) return;
    button.disabled = true;
    try {
      await client.api.DELETE("/v1/reconstructions/{id}", { params: { path: { id: job.id } }, signal });
      if (ended) {
        drop(job.id);
        announced.textContent = t("studies.deleted", { name: nameOf(job) });
      }
    } catch (error) {
      button.disabled = false;
      if (!isAborted(error)) trouble.replaceChildren(troubleOf(error, [retry(() => void remove(job, button))]));
    }
  };
  const retry = (again: () => void) =>
    h("button", { type: "button", onclick: () => (trouble.replaceChildren(), again()) }, t("app.retry"));
  const load = async (from: string | null): Promise<void> => {
    try {
      const query = { limit: LIMIT, ...(from === null ? {} : { cursor: from }) };
      const answer = body(await client.api.GET("/v1/reconstructions", { params: { query }, signal }));
      if (from === null) {
        const there = new Set(answer.reconstructions.map((job) => job.id));
        for (const id of [...rows.keys()]) if (!there.has(id)) drop(id);
      }
      answer.reconstructions.forEach(put);
      cursor = answer.next_cursor;
      trouble.replaceChildren();
      settle();
    } catch (error) {
      if (!isAborted(error)) trouble.replaceChildren(troubleOf(error, [retry(() => void load(from))]));
    }
  };
  const uploads = createUploads((job) => (put(job), settle()), signal);
  followJobs(
    {
      opened: () => (show(live, true), void load(null)),
      changed: (job) => (put(job), settle()),
      deleted: drop,
      lost: () => {
        show(live, false);
        trouble.replaceChildren(troubleOf(new TypeError("no answer"), [retry(() => void load(null))]));
      },
    },
    signal,
  );
  return h(
    "div",
    { class: "page studies-page" },
    h("h1", {}, t("studies.title")),
    createEntrance(uploads, signal),
    uploads.element,
    trouble,
    h(
      "section",
      { class: "card list", "aria-labelledby": "list-title" },
      h("div", { class: "head" }, h("h2", { id: "list-title" }, t("studies.list")), live),
      empty,
      table,
      more,
    ),
    announced,
  );
}

function heads(): HTMLElement[] {
  const names = ["studies.study", "studies.when", "studies.stateHead", "studies.ef", "studies.volumes", "studies.flagsHead"] as const;
  const heads = names.map((name) => h("th", { scope: "col", class: name === "studies.ef" || name === "studies.volumes" ? "number" : null }, t(name)));
  return [...heads, h("th", { scope: "col" }, h("span", { class: "unseen" }, t("studies.actions")))];
}
