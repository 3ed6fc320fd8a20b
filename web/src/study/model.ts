import { number, t, told } from "../languages/index.ts";
import { type Child, h, show } from "../page/dom.ts";
import { box } from "../page/trouble.ts";
import { type Hit, valueAt } from "../scene/pick.ts";
import { createView, type View } from "../scene/view.ts";
import { spaceButtons } from "../scene/space.ts";
import { decimalsOf, type Shown, withUnit } from "./shared.ts";

/** Degrees that an arrow key turns, and how much a key zooms. */
const TURN_DEGREES = 8;
const ZOOM = 1.12;

/** The beating model with all that steers it. */
export function modelPanel(shown: Shown): HTMLElement {
  const canvas = h("canvas", { tabindex: 0, role: "img", "aria-label": t("model.canvas"), class: "model" });
  const stage = h("div", { class: "stage" }, canvas);
  const panel = (...parts: Child[]) =>
    h("section", { class: "card model-panel", "aria-labelledby": "model-title" }, h("h2", { id: "model-title" }, t("model.title")), ...parts);
  let view: View;
  try {
    view = createView(canvas, shown.model, shown.signal);
  } catch {
    return panel(box(t("trouble.webgl"), [h("p", {}, t("trouble.webgl.detail"))], []));
  }
  const readout = h("p", { class: "readout", "aria-live": "polite" }, t("model.hover"));
  const measuring = measureControls(shown, view);
  stage.append(measuring.cross);
  shown.cycle.phase.watch((phase) => view.pose(phase), shown.signal);
  shown.segment.watch((segment) => {
    view.paint.highlight(segment);
    view.redraw();
  }, shown.signal);
  const legend = legendOf(shown, view);
  pointing(shown, view, measuring, readout);
  keys(shown, view, measuring);
  return panel(
    stage,
    h("div", { class: "under" }, readout, legend),
    playControls(shown),
    h(
      "div",
      { class: "controls" },
      surfaceToggles(view),
      colourChoice(shown),
      measuring.element,
      h("button", { type: "button", class: "quiet", onclick: () => view.home() }, t("model.home")),
      spaceButtons(view, shown.signal),
    ),
  );
}

/** Play, speed and the gate. */
function playControls(shown: Shown): HTMLElement {
  const { cycle, signal } = shown;
  const play = h("button", { type: "button", class: "primary play", id: "play" });
  const gate = h("input", { type: "range", min: 1, max: cycle.gates, step: 1, value: 1, id: "gate", "aria-label": t("model.gate") });
  const said = h("output", { for: "gate", class: "gate-said" });
  const speed = h("select", { id: "speed", "aria-label": t("model.speed") }, ...[1, 0.5, 0.25].map((part) => h("option", { value: part }, `${number(part, part === 1 ? 0 : 2)} ×`)));
  play.addEventListener("click", () => cycle.playing.set(!cycle.playing.get()));
  gate.addEventListener("input", () => cycle.seek(gate.valueAsNumber));
  speed.addEventListener("change", () => cycle.speed.set(Number(speed.value)));
  cycle.playing.watch((plays) => (play.textContent = plays ? t("model.pause") : t("model.play")), signal);
  cycle.gate.watch((now) => {
    gate.valueAsNumber = now;
    said.textContent = t("model.gateOf", { gate: now, gates: cycle.gates });
    gate.setAttribute("aria-valuetext", said.textContent);
  }, signal);
  const element = h("div", { class: "controls play-controls" }, play, gate, said, h("label", { class: "field inline", for: "speed" }, h("span", {}, t("model.speed")), speed));
  show(element, cycle.gates > 1);
  return element;
}

function surfaceToggles(view: View): HTMLElement {
  const toggle = (label: string, id: string, changed: (on: boolean) => void) => {
    const input = h("input", { type: "checkbox", id, checked: true });
    input.addEventListener("change", () => (changed(input.checked), view.redraw()));
    return h("label", { class: "tick" }, input, label);
  };
  return h(
    "div",
    { class: "toggles" },
    toggle(t("model.endocardial"), "endocardial", (on) => view.shown("endocardial", on)),
    toggle(t("model.epicardial"), "epicardial", (on) => view.shown("epicardial", on)),
    toggle(t("model.translucent"), "translucent", (on) => view.paint.seeThrough(on)),
  );
}

function colourChoice(shown: Shown): HTMLElement {
  const options = shown.model.variants.map((variant) => h("option", { value: variant.name }, told("quantity", variant.name)));
  const select = h("select", { id: "colour" }, h("option", { value: "" }, t("model.plain")), ...options);
  select.addEventListener("change", () => shown.quantity.set(select.value === "" ? null : select.value));
  shown.quantity.watch((name) => (select.value = name ?? ""), shown.signal);
  return h("label", { class: "field inline", for: "colour" }, h("span", {}, t("model.colour")), select);
}

/** The scale of what colours the model; it colours it, too. */
function legendOf(shown: Shown, view: View): HTMLElement {
  const legend = h("div", { class: "legend", role: "img" });
  shown.quantity.watch((name) => {
    const variant = shown.model.variants.find((candidate) => candidate.name === name) ?? null;
    view.paint.colour(variant);
    view.redraw();
    show(legend, variant !== null);
    if (variant === null) return;
    const [low, high] = variant.range;
    const top = withUnit(number(high), variant.unit);
    const bar = h("span", { class: "bar" });
    bar.style.background = `linear-gradient(to right, ${variant.colours.join(", ")})`;
    legend.setAttribute("aria-label", t("model.legend", { quantity: told("quantity", variant.name), low: number(low), high: top }));
    legend.replaceChildren(h("span", {}, number(low)), bar, h("span", {}, top));
  }, shown.signal);
  return legend;
}

interface Measuring {
  element: HTMLElement;
  cross: HTMLElement;
  on(): boolean;
  add(hit: Hit | null): void;
}

function measureControls(shown: Shown, view: View): Measuring {
  const cross = h("div", { class: "cross", "aria-hidden": "true" });
  const said = h("span", { class: "said", role: "status" });
  const button = h("button", { type: "button", "aria-pressed": "false", id: "measure" }, t("model.measure"));
  let on = false;
  const tell = (): void => {
    const next = view.measurement.points() === 0 ? "model.measure.first" : "model.measure.second";
    if (view.measurement.points() < 2) said.textContent = on ? t(next) : "";
  };
  view.onDistance = (mm) => {
    if (mm === null) return;
    const text = `${t("model.distance", { mm: number(mm, 1) })} (${t("model.gateOf", { gate: shown.cycle.gate.get(), gates: shown.cycle.gates })})`;
    if (said.textContent !== text) said.textContent = text;
  };
  button.addEventListener("click", () => {
    on = !on;
    button.setAttribute("aria-pressed", String(on));
    show(cross, on);
    if (!on) view.measurement.clear();
    view.redraw();
    tell();
    if (on) view.canvas.focus();
  });
  show(cross, false);
  return {
    element: h("div", { class: "measure" }, button, said),
    cross,
    on: () => on,
    add(hit) {
      if (hit === null) return;
      view.measurement.add(hit.anchor);
      view.redraw();
      tell();
    },
  };
}

/** What lies under the pointer is told, and its segment shown everywhere. A click that is no drag sets a point of a measurement. */
function pointing(shown: Shown, view: View, measuring: Measuring, readout: HTMLElement): void {
  const { canvas } = view;
  let pressed: { x: number; y: number } | null = null;
  let waiting = false;
  canvas.addEventListener("pointerdown", (event) => (pressed = { x: event.clientX, y: event.clientY }));
  canvas.addEventListener("pointerup", (event) => {
    const still = pressed !== null && Math.hypot(event.clientX - pressed.x, event.clientY - pressed.y) < 5;
    pressed = null;
    if (still && measuring.on()) measuring.add(view.at(event.offsetX, event.offsetY));
  });
  canvas.addEventListener("pointermove", (event) => {
    if (waiting || event.buttons !== 0) return;
    waiting = true;
    requestAnimationFrame(() => {
      waiting = false;
      const hit = view.at(event.offsetX, event.offsetY);
      shown.segment.set(hit?.segment ?? null);
      readout.textContent = hit === null ? t("model.hover") : readingOf(shown, hit);
    });
  });
  canvas.addEventListener("pointerleave", () => {
    shown.segment.set(null);
    readout.textContent = t("model.hover");
  });
}

function readingOf(shown: Shown, hit: Hit): string {
  const variant = shown.model.variants.find((candidate) => candidate.name === shown.quantity.get());
  const place = hit.segment === null ? "" : `${hit.segment} ${told("segment", String(hit.segment))}`;
  if (variant === undefined) return place;
  const value = valueAt(hit.anchor, variant, shown.model.noValue);
  const text = value === null ? t("model.noValue") : withUnit(number(value, decimalsOf(variant.unit)), variant.unit);
  return place === "" ? text : `${place}: ${text}`;
}

function keys(shown: Shown, view: View, measuring: Measuring): void {
  const actions: Record<string, () => void> = {
    ArrowLeft: () => view.turn(-TURN_DEGREES, 0),
    ArrowRight: () => view.turn(TURN_DEGREES, 0),
    ArrowUp: () => view.turn(0, TURN_DEGREES),
    ArrowDown: () => view.turn(0, -TURN_DEGREES),
    "+": () => view.zoom(1 / ZOOM),
    "-": () => view.zoom(ZOOM),
    Home: () => view.home(),
    " ": () => shown.cycle.playing.set(!shown.cycle.playing.get()),
    Enter: () => measuring.on() && measuring.add(view.at()),
  };
  view.canvas.addEventListener("keydown", (event) => {
    const action = actions[event.key];
    if (action === undefined || event.ctrlKey || event.metaKey || event.altKey) return;
    event.preventDefault();
    action();
  });
}
