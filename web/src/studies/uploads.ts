import type { Job, Parameters } from "../../client/src/index.ts";
import { t } from "../languages/index.ts";
import { h } from "../page/dom.ts";
import { upload } from "../page/service.ts";
import { isAborted, troubleOf } from "../page/trouble.ts";

/** What is being sent, above the list. */
export interface Uploads {
  element: HTMLElement;
  /** Sends the files of one study. */
  send(name: string, files: readonly Blob[], parameters: Parameters): void;
}

/** Shows what is being sent, and tells of every job that came of it. */
export function createUploads(accepted: (job: Job) => void, signal: AbortSignal): Uploads {
  const element = h("div", { class: "uploads", "aria-live": "polite" });
  const send = (name: string, files: readonly Blob[], parameters: Parameters): void => {
    const one = new AbortController();
    const bar = h("progress", { max: 1, value: 0, "aria-label": t("state.progress", { name }) });
    const cancel = h("button", { type: "button", class: "quiet", onclick: () => one.abort() }, t("studies.cancel"));
    const row = h("div", { class: "upload" }, h("strong", {}, name), h("span", { class: "faint" }, t("state.uploading")), bar, cancel);
    element.append(row);
    const both = AbortSignal.any([signal, one.signal]);
    upload(files, parameters, (part) => (bar.value = part), both).then(
      (job) => {
        row.remove();
        accepted(job);
      },
      (error: unknown) => {
        if (isAborted(error)) {
          row.remove();
          return;
        }
        const again = h("button", { type: "button", onclick: () => (told.remove(), send(name, files, parameters)) }, t("app.retry"));
        const dismiss = h("button", { type: "button", class: "quiet", onclick: () => told.remove() }, t("studies.dismiss"));
        const told = troubleOf(error, [again, dismiss], t("trouble.upload", { name }));
        row.replaceWith(told);
      },
    );
  };
  return { element, send };
}
