import { t } from "../languages/index.ts";
import { h } from "../page/dom.ts";
import { type Counts, countsOf } from "./counts.ts";
import type { Shown } from "./shared.ts";
import { aspectOf, drawSlice, type Plane } from "./slice-picture.ts";

/** The paper's two manual steps: a circle about the ventricle, and its first and last slice. */
export interface Region {
  centre_mm: [number, number];
  radius_mm: number;
  first_slice: number;
  last_slice: number;
}

/** What a key moves, in mm, and the bounds of a radius that the service takes. */
const STEP_MM = 2;
const RADIUS_MM = { low: 10, high: 250 };
const WIDTH_PX = 560;

/** The region drawn on the slices as they were acquired, by pointer, by keys, or by numbers. */
export function regionEditor(shown: Shown, plane: Plane): { element: HTMLElement; region(): Region } {
  const { report } = shown;
  const [right = 1, down = 1] = plane.pixel_mm;
  const found = report.region;
  const region: Region = {
    centre_mm: [round(found?.centre_mm[0] ?? (right * (plane.width - 1)) / 2), round(found?.centre_mm[1] ?? (down * (plane.height - 1)) / 2)],
    radius_mm: round(found?.radius_mm ?? 60),
    first_slice: found?.first_slice ?? 1,
    last_slice: found?.last_slice ?? plane.slices,
  };
  let slice = Math.floor((region.first_slice + region.last_slice) / 2) - 1;
  let counts: Counts | null = null;
  const canvas = h("canvas", {
    tabindex: 0,
    width: WIDTH_PX,
    height: Math.round(WIDTH_PX * aspectOf(plane)),
    role: "application",
    "aria-label": t("again.region.canvas"),
    "aria-describedby": "region-hint",
    class: "region",
  });
  const input = (id: string, min: number, max: number, step: number) => h("input", { type: "number", id, min, max, step, required: true });
  const x = input("region-x", 0, round(plane.width * right), 0.1);
  const y = input("region-y", 0, round(plane.height * down), 0.1);
  const radius = input("region-radius", RADIUS_MM.low, RADIUS_MM.high, 0.1);
  const first = input("region-first", 1, plane.slices, 1);
  const last = input("region-last", 1, plane.slices, 1);
  const position = h("input", { type: "range", id: "region-slice", min: 1, max: plane.slices, step: 1, value: slice + 1 });
  const said = h("output", { for: "region-slice" });

  const scale = () => canvas.width / (plane.width * right);
  const draw = (): void => {
    drawSlice(canvas, plane, slice, shown.cycle.gate.get(), counts, { low: 0, high: 255 }, false);
    const context = canvas.getContext("2d");
    if (context === null) return;
    const inside = slice + 1 >= region.first_slice && slice + 1 <= region.last_slice;
    const at = (mm: number, step: number) => (mm + step / 2) * scale();
    context.setTransform(1, 0, 0, 1, 0, 0);
    context.strokeStyle = inside ? "#ffd23f" : "#9aa0a6";
    context.fillStyle = context.strokeStyle;
    context.lineWidth = 2.5;
    context.setLineDash(inside ? [] : [8, 6]);
    context.beginPath();
    context.arc(at(region.centre_mm[0], right), at(region.centre_mm[1], down), region.radius_mm * scale(), 0, 2 * Math.PI);
    context.stroke();
    context.setLineDash([]);
    for (const [dx, size] of [[0, 4], [region.radius_mm, 7]] as const) {
      context.beginPath();
      context.arc(at(region.centre_mm[0] + dx, right), at(region.centre_mm[1], down), size, 0, 2 * Math.PI);
      context.fill();
    }
  };
  const put = (): void => {
    [x.value, y.value] = region.centre_mm.map((mm) => String(round(mm))) as [string, string];
    radius.value = String(round(region.radius_mm));
    first.value = String(region.first_slice);
    last.value = String(region.last_slice);
    position.valueAsNumber = slice + 1;
    said.textContent = t("slices.sliceOf", { slice: slice + 1, slices: plane.slices });
    draw();
  };
  const move = (dx: number, dy: number): void => {
    region.centre_mm = [region.centre_mm[0] + dx, region.centre_mm[1] + dy];
  };
  const resize = (to: number): void => {
    region.radius_mm = Math.min(RADIUS_MM.high, Math.max(RADIUS_MM.low, to));
  };
  const go = (to: number): void => {
    slice = Math.min(plane.slices - 1, Math.max(0, to));
  };
  const typed = (): void => {
    region.centre_mm = [x.valueAsNumber || 0, y.valueAsNumber || 0];
    resize(radius.valueAsNumber || region.radius_mm);
    region.first_slice = first.valueAsNumber || 1;
    region.last_slice = last.valueAsNumber || plane.slices;
    draw();
  };
  for (const number of [x, y, radius, first, last]) number.addEventListener("change", typed);
  position.addEventListener("input", () => (go(position.valueAsNumber - 1), put()));
  const keys: Record<string, () => void> = {
    ArrowLeft: () => move(-STEP_MM, 0),
    ArrowRight: () => move(STEP_MM, 0),
    ArrowUp: () => move(0, -STEP_MM),
    ArrowDown: () => move(0, STEP_MM),
    "+": () => resize(region.radius_mm + STEP_MM),
    "-": () => resize(region.radius_mm - STEP_MM),
    PageUp: () => go(slice + 1),
    PageDown: () => go(slice - 1),
  };
  canvas.addEventListener("keydown", (event) => {
    const action = keys[event.key];
    if (action === undefined) return;
    event.preventDefault();
    action();
    put();
  });
  drag(canvas, () => (plane.width * right) / canvas.clientWidth, region, [right, down], { move, resize, put });
  const load = countsOf(shown.job.id, shown.signal);
  shown.cycle.gate.watch((gate) => {
    load("acquired", gate).then((loaded) => ((counts = loaded), draw()), () => undefined);
  }, shown.signal);
  put();
  const field = (label: string, element: HTMLElement) => h("label", { class: "field", for: element.id }, h("span", {}, label), element);
  const take = (label: string, which: "first_slice" | "last_slice") =>
    h("button", { type: "button", class: "quiet", onclick: () => ((region[which] = slice + 1), put()) }, label);
  const element = h(
    "div",
    { class: "region-editor" },
    h("div", {}, canvas, h("p", { id: "region-hint", class: "faint small" }, t("again.region.hint"))),
    h(
      "div",
      { class: "numbers" },
      h("label", { class: "field full", for: "region-slice" }, h("span", {}, t("again.slice")), position),
      h("div", { class: "full takes" }, said, take(t("again.takeFirst"), "first_slice"), take(t("again.takeLast"), "last_slice")),
      field(t("again.first"), first),
      field(t("again.last"), last),
      field(t("again.x"), x),
      field(t("again.y"), y),
      field(t("again.radius"), radius),
    ),
  );
  return { element, region: () => ({ ...region, centre_mm: [round(region.centre_mm[0]), round(region.centre_mm[1])], radius_mm: round(region.radius_mm) }) };
}

interface Dragged {
  move(dx: number, dy: number): void;
  resize(to: number): void;
  put(): void;
}

/** A drag that begins near the rim changes the radius, any other moves the circle. */
function drag(canvas: HTMLCanvasElement, mmPerPx: () => number, region: Region, [right, down]: [number, number], { move, resize, put }: Dragged): void {
  const placeOf = (event: PointerEvent) => [event.offsetX * mmPerPx() - right / 2, event.offsetY * mmPerPx() - down / 2] as const;
  let last: readonly [number, number] | null = null;
  let rim = false;
  const apart = ([x, y]: readonly [number, number]) => Math.hypot(x - region.centre_mm[0], y - region.centre_mm[1]);
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    last = placeOf(event);
    rim = Math.abs(apart(last) - region.radius_mm) < 14 * mmPerPx();
  });
  canvas.addEventListener("pointermove", (event) => {
    if (last === null) return;
    const now = placeOf(event);
    if (rim) resize(apart(now));
    else move(now[0] - last[0], now[1] - last[1]);
    last = now;
    put();
  });
  for (const name of ["pointerup", "pointercancel"] as const) canvas.addEventListener(name, () => (last = null));
}

function round(mm: number): number {
  return Math.round(mm * 10) / 10;
}
