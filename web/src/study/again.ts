import type { Parameters } from "../../client/src/index.ts";
import { number, t, told } from "../languages/index.ts";
import { h, show } from "../page/dom.ts";
import { go } from "../page/router.ts";
import { body, client } from "../page/service.ts";
import { isAborted, troubleOf } from "../page/trouble.ts";
import { regionEditor } from "./region.ts";
import type { Shown } from "./shared.ts";

const MODELS = ["free", "spring_mass", "restricted_spring_mass", "plane"] as const;
const SOLVERS = ["rk4", "midpoint", "euler", "implicit_euler"] as const;
/** Levels of the mesh and the vertices of each surface. */
const LEVELS = [
  [2, 162],
  [3, 642],
  [4, 2562],
] as const;

/** The form that runs the study again with other parameters. */
export function againPanel(shown: Shown): HTMLElement {
  const title = h("h2", { id: "again-title" }, t("again.title"));
  const panel = (...parts: Node[]) => h("section", { class: "card again-panel", "aria-labelledby": "again-title" }, title, ...parts);
  if (!shown.job.input_kept) return panel(h("p", { class: "note" }, t("again.notKept")));
  const used = shown.report.parameters as { preset?: string; mesh?: { level?: number }; deform?: { model?: string; solver?: string } };
  const choice = (id: string, options: readonly (readonly [string, string])[], chosen: string | undefined) =>
    h("select", { id }, ...options.map(([value, text]) => h("option", { value, selected: value === chosen }, text)));
  const preset = choice("again-preset", [["clinical", t("again.clinical")], ["paper", t("again.paper")]], used.preset);
  const model = choice("again-model", MODELS.map((name) => [name, told("again", name)] as const), used.deform?.model);
  const solver = choice("again-solver", SOLVERS.map((name) => [name, told("again", name)] as const), used.deform?.solver);
  const level = choice("again-level", LEVELS.map(([at, count]) => [String(at), t("again.vertices", { count: number(count) })] as const), String(used.mesh?.level ?? 3));
  const psf = h("input", { type: "number", id: "again-psf", min: 4, max: 30, step: 0.1 });
  const marked = h("input", { type: "checkbox", id: "again-region" });
  const plane = shown.slices?.planes.find((candidate) => candidate.plane === "acquired");
  const editor = plane === undefined ? null : regionEditor(shown, plane);
  const field = (label: string, element: HTMLElement) => h("label", { class: "field", for: element.id }, h("span", {}, label), element);
  const ofPaper = [field(t("again.model"), model), field(t("again.solver"), solver)];
  const ofClinical = [field(t("again.psf"), psf)];
  const settle = (): void => {
    ofPaper.forEach((part) => show(part, preset.value === "paper"));
    ofClinical.forEach((part) => show(part, preset.value === "clinical"));
    if (editor !== null) show(editor.element, marked.checked);
  };
  for (const input of [preset, marked]) input.addEventListener("change", settle);
  settle();
  const trouble = h("div", {});
  const run = h("button", { type: "submit", class: "primary" }, t("again.run"));
  const parameters = (): Parameters => ({
    preset: preset.value === "paper" ? "paper" : "clinical",
    mesh: { level: Number(level.value) },
    keep_input: true,
    ...(preset.value === "paper"
      ? { deform: { model: named(MODELS, model.value), solver: named(SOLVERS, solver.value) } }
      : psf.value === "" ? {} : { refine: { psf_fwhm_mm: psf.valueAsNumber } }),
    ...(marked.checked && editor !== null ? { region: editor.region() } : {}),
  });
  const submit = async (): Promise<void> => {
    run.disabled = true;
    trouble.replaceChildren();
    try {
      const answer = await client.api.POST("/v1/reconstructions/{id}/again", { params: { path: { id: shown.job.id } }, body: parameters(), signal: shown.signal });
      go(`/studies/${body(answer).id}`);
    } catch (error) {
      if (isAborted(error)) return;
      run.disabled = false;
      trouble.replaceChildren(troubleOf(error, [h("button", { type: "button", onclick: () => void submit() }, t("app.retry"))]));
    }
  };
  const form = h(
    "form",
    { onsubmit: (event: SubmitEvent) => (event.preventDefault(), void submit()) },
    h("div", { class: "fields" }, field(t("again.preset"), preset), field(t("again.level"), level), ...ofPaper, ...ofClinical),
    h("div", {}, editor === null ? "" : h("label", { class: "tick" }, marked, t("again.region")), editor?.element ?? ""),
    h("div", { class: "actions" }, run),
    trouble,
  );
  return panel(form);
}

function named<T extends string>(names: readonly T[], value: string): T {
  return names.find((name) => name === value) ?? (names[0] as T);
}
