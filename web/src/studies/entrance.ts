import type { Parameters } from "../../client/src/index.ts";
import { t } from "../languages/index.ts";
import { h } from "../page/dom.ts";
import { bytes } from "../page/service.ts";
import { troubleOf } from "../page/trouble.ts";
import { droppedFiles, isData } from "./dropped.ts";
import { bySeries } from "./series.ts";
import type { Uploads } from "./uploads.ts";

/** Where studies come in: by drop anywhere on the page, by choosing, or the built-in phantom. */
export function createEntrance(uploads: Uploads, signal: AbortSignal): HTMLElement {
  const keep = h("input", { type: "checkbox", id: "keep", checked: true });
  const preset = h(
    "select",
    { id: "preset" },
    h("option", { value: "clinical" }, t("again.clinical")),
    h("option", { value: "paper" }, t("again.paper")),
  );
  const parameters = (): Parameters => ({
    ...(keep.checked ? { keep_input: true } : {}),
    ...(preset.value === "paper" ? { preset: "paper" } : {}),
  });
  const take = async (files: readonly File[]): Promise<void> => {
    said.textContent = files.length === 0 ? t("studies.nothing") : "";
    for (const group of await bySeries(files)) {
      const name = (group[0]?.name ?? "") + (group.length > 1 ? ` + ${group.length - 1}` : "");
      uploads.send(name, group, parameters());
    }
  };
  const chosen = (input: HTMLInputElement) => (): void => {
    void take([...(input.files ?? [])].filter(isData));
    input.value = "";
  };
  const files = h("input", { type: "file", multiple: true, hidden: true, id: "files", "aria-label": t("studies.choose") });
  const folder = h("input", { type: "file", webkitdirectory: true, hidden: true, id: "folder", "aria-label": t("studies.chooseFolder") });
  files.addEventListener("change", chosen(files));
  folder.addEventListener("change", chosen(folder));
  const phantom = h("button", { type: "button", id: "phantom" }, t("studies.phantom"));
  phantom.addEventListener("click", () => {
    phantom.disabled = true;
    bytes("/v1/phantom.dcm", signal)
      .then((file) => uploads.send(t("studies.phantom.name"), [new File([file], "phantom.dcm", { type: "application/dicom" })], { ...parameters(), keep_input: true }))
      .catch((error: unknown) => {
        const again = h("button", { type: "button", onclick: () => (told.remove(), phantom.click()) }, t("app.retry"));
        const told = troubleOf(error, [again]);
        uploads.element.append(told);
      })
      .finally(() => (phantom.disabled = false));
  });
  const said = h("p", { class: "faint", role: "status" });
  const entrance = h(
    "section",
    { class: "entrance", id: "entrance", "aria-labelledby": "entrance-title" },
    h(
      "div",
      { class: "target" },
      h("h2", { id: "entrance-title" }, t("studies.drop")),
      h("p", { class: "faint" }, t("studies.drop.hint")),
      h(
        "div",
        { class: "actions" },
        h("button", { type: "button", class: "primary", onclick: () => files.click() }, t("studies.choose")),
        h("button", { type: "button", onclick: () => folder.click() }, t("studies.chooseFolder")),
        phantom,
      ),
      said,
    ),
    h(
      "div",
      { class: "options" },
      h("label", { class: "field", for: "preset" }, h("span", {}, t("studies.preset")), preset),
      h("label", { class: "tick" }, keep, t("studies.keep")),
    ),
    files,
    folder,
  );
  receiveDrops(entrance, (dropped) => void droppedFiles(dropped).then(take), signal);
  return entrance;
}

/** A drop anywhere on the page is meant for it: beside the target it would leave the page. */
function receiveDrops(entrance: HTMLElement, take: (dropped: DataTransfer) => void, signal: AbortSignal): void {
  const over = (event: DragEvent): void => {
    event.preventDefault();
    entrance.classList.add("over");
  };
  document.addEventListener("dragover", over, { signal });
  document.addEventListener("dragleave", (event) => event.relatedTarget === null && entrance.classList.remove("over"), { signal });
  document.addEventListener(
    "drop",
    (event) => {
      event.preventDefault();
      entrance.classList.remove("over");
      if (event.dataTransfer !== null) take(event.dataTransfer);
    },
    { signal },
  );
}
