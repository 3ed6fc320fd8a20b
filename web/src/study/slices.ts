import { t, told } from "../languages/index.ts";
import { type Child, h, show } from "../page/dom.ts";
import { isAborted, troubleOf } from "../page/trouble.ts";
import { type Counts, countsOf } from "./counts.ts";
import type { Shown } from "./shared.ts";
import { aspectOf, drawSlice, type Plane } from "./slice-picture.ts";

/** Pixels along the width of the large picture and of the small ones. */
const LARGE_PX = 720;
const SMALL_PX = 132;

/** Slices of the counts with the contours over them, so that a physician can judge the fit. */
export function slicesPanel(shown: Shown): HTMLElement {
  const panel = (...parts: Child[]) =>
    h("section", { class: "card slices-panel", "aria-labelledby": "slices-title" }, h("h2", { id: "slices-title" }, t("slices.title")), ...parts);
  const planes = shown.slices?.planes ?? [];
  const [first] = planes;
  if (first === undefined) return panel(h("p", { class: "faint" }, t("slices.none")));
  const kept = shown.job.input_kept;
  const load = countsOf(shown.job.id, shown.signal);
  let plane = first;
  let slice = Math.floor(plane.slices / 2);
  let counts: Counts | null = null;
  let asked = "";

  const large = h("canvas", { class: "large", role: "img" });
  const walls = h("div", { class: "walls", "aria-hidden": "true" });
  const frame = h("div", { class: "frame" }, large, walls);
  const strip = h("div", { class: "strip" });
  const position = h("input", { type: "range", min: 1, step: 1, id: "slice", "aria-label": t("slices.slice") });
  const said = h("output", { for: "slice" });
  const contours = h("input", { type: "checkbox", checked: true, id: "contours" });
  const width = h("input", { type: "range", min: 10, max: 255, value: 255, id: "window" });
  const level = h("input", { type: "range", min: 0, max: 255, value: 128, id: "level" });
  const trouble = h("div", {});
  const buttons = planes.map((candidate) => {
    const button = h("button", { type: "button", "aria-pressed": "false" }, told("slices", candidate.plane));
    button.addEventListener("click", () => choose(candidate));
    return button;
  });
  let small: HTMLCanvasElement[] = [];

  const draw = (): void => {
    const gate = shown.cycle.gate.get();
    const half = width.valueAsNumber / 2;
    const window = { low: level.valueAsNumber - half, high: level.valueAsNumber + half };
    drawSlice(large, plane, slice, gate, counts, window, contours.checked);
    small.forEach((canvas, index) => drawSlice(canvas, plane, index, gate, counts, window, contours.checked));
  };
  const tell = (): void => {
    const view = plane.views?.[slice]?.view;
    said.textContent = view !== undefined ? told("slices", view) : t("slices.sliceOf", { slice: slice + 1, slices: plane.slices });
    position.setAttribute("aria-valuetext", said.textContent);
    const gate = shown.cycle.gate.get();
    large.setAttribute("aria-label", t("slices.picture", { plane: told("slices", plane.plane), slice: slice + 1, slices: plane.slices, gate }));
    small.forEach((canvas, index) => canvas.parentElement?.setAttribute("aria-pressed", String(index === slice)));
    walls.replaceChildren(...wallsOf(plane, slice));
  };
  const refresh = async (): Promise<void> => {
    const gate = shown.cycle.gate.get();
    const wanted = `${plane.plane} ${gate}`;
    asked = wanted;
    tell();
    if (!kept) return draw();
    try {
      const loaded = await load(plane.plane, gate);
      if (asked !== wanted) return;
      counts = loaded;
      trouble.replaceChildren();
    } catch (error) {
      if (isAborted(error) || asked !== wanted) return;
      counts = null;
      trouble.replaceChildren(troubleOf(error, [h("button", { type: "button", onclick: () => void refresh() }, t("app.retry"))]));
    }
    draw();
  };
  const go = (to: number): void => {
    slice = to;
    position.valueAsNumber = slice + 1;
    tell();
    draw();
  };
  const choose = (chosen: Plane): void => {
    plane = chosen;
    counts = null;
    slice = Math.floor(plane.slices / 2);
    if (plane.plane === "long_axis") slice = 0;
    buttons.forEach((button, index) => button.setAttribute("aria-pressed", String(planes[index] === plane)));
    const aspect = aspectOf(plane);
    large.width = LARGE_PX;
    large.height = Math.round(LARGE_PX * aspect);
    position.max = String(plane.slices);
    position.valueAsNumber = slice + 1;
    small = Array.from({ length: plane.slices }, () => h("canvas", { width: SMALL_PX, height: Math.round(SMALL_PX * aspect), "aria-hidden": "true" }));
    strip.replaceChildren(
      ...small.map((canvas, index) => {
        const label = t("slices.sliceOf", { slice: index + 1, slices: plane.slices });
        return h("button", { type: "button", "aria-label": label, "aria-pressed": "false", onclick: () => go(index) }, canvas);
      }),
    );
    void refresh();
  };
  position.addEventListener("input", () => go(position.valueAsNumber - 1));
  for (const input of [contours, width, level]) input.addEventListener("input", draw);
  choose(first);
  shown.cycle.gate.watch(() => void refresh(), shown.signal);
  const field = (id: string, label: string, input: HTMLElement) => h("label", { class: "field inline", for: id }, h("span", {}, label), input);
  const windowing = h("div", { class: "controls" }, field("window", t("slices.window"), width), field("level", t("slices.level"), level));
  show(windowing, kept);
  return panel(
    kept ? null : h("p", { class: "note" }, t("slices.notKept")),
    h("div", { class: "controls" }, h("div", { class: "segmented", role: "group", "aria-label": t("slices.plane") }, ...buttons), h("label", { class: "tick" }, contours, t("slices.contours"))),
    h("div", { class: "slices" }, h("div", { class: "main" }, frame, h("div", { class: "controls" }, field("slice", t("slices.slice"), position), said), windowing), strip),
    trouble,
  );
}

/** The walls' names around the picture, where they are known. */
function wallsOf(plane: Plane, slice: number): HTMLElement[] {
  const labels = plane.labels ?? plane.views?.[slice]?.labels;
  if (!labels) return [];
  return (["left", "right", "top", "bottom"] as const).map((side) => h("span", { class: side }, told("wall", labels[side])));
}
