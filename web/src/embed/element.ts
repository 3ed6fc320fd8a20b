import type { Report } from "../../client/src/types.ts";
import { createCycle, type Cycle } from "../page/cycle.ts";
import { h, show } from "../page/dom.ts";
import { type Model, readModel } from "../scene/load.ts";
import { createView, type View } from "../scene/view.ts";
import { styleSheet } from "./style.ts";
import { wordsFor } from "./words.ts";

/**
 * `<ventricle-viewer src="…/surfaces.glb" report="…/report">`: the beating ventricle on any site.
 *
 * Attributes: `src`, `report` (optional: shows the volumes), `play` (beats from the start, but for people who want less motion), `gate`
 * (from 1; stops there), `colour` (`perfusion`, `end_diastolic_thickness`, `end_systolic_thickness`, `thickening`, `motion`, `phase`).
 * Property: `headers`, what is sent with the requests for both (`{ Authorization: "Bearer …" }`). An attribute would stand in the page for
 * everything that reads it. Events: `load`, `error`, and `gatechange` with `detail.gate` and `detail.gates`.
 */
export class VentricleViewer extends HTMLElement {
  static readonly observedAttributes = ["src", "report", "play", "gate", "colour"];

  #shown: AbortController | null = null;
  #headers: Readonly<Record<string, string>> = {};
  /** Between its coming into a page and its going: an element that the page had before this script is told of its attributes first. */
  #placed = false;
  #now: { view: View; cycle: Cycle; model: Model; legend: HTMLElement } | null = null;

  constructor() {
    super();
    this.attachShadow({ mode: "open" }).adoptedStyleSheets = [styleSheet()];
  }

  /** Sent with the requests for `src` and `report`; another value fetches both again. */
  get headers(): Readonly<Record<string, string>> {
    return this.#headers;
  }

  set headers(headers: Readonly<Record<string, string>>) {
    this.#headers = { ...headers };
    if (this.#placed) void this.#load();
  }

  connectedCallback(): void {
    // What a page set before this script was there lies on the element and hides the property.
    const early = Object.getOwnPropertyDescriptor(this, "headers");
    if (early !== undefined) {
      Reflect.deleteProperty(this, "headers");
      this.#headers = { ...(early.value as Readonly<Record<string, string>>) };
    }
    this.#placed = true;
    void this.#load();
  }

  disconnectedCallback(): void {
    this.#placed = false;
    this.#shown?.abort();
    this.#now = null;
  }

  attributeChangedCallback(name: string, before: string | null, now: string | null): void {
    if (!this.#placed || before === now) return;
    if (name === "src" || name === "report") void this.#load();
    else this.#apply(name);
  }

  async #load(): Promise<void> {
    this.#shown?.abort();
    this.#now = null;
    const shown = new AbortController();
    this.#shown = shown;
    const words = wordsFor(this);
    const said = h("p", { class: "said", role: "status" }, words.loading);
    const canvas = h("canvas", { tabindex: 0, role: "img", "aria-label": words.canvas });
    const play = h("button", { type: "button" }, words.play);
    const gate = h("input", { type: "range", min: 1, step: 1, value: 1, "aria-label": words.gate });
    const volumes = h("span", {});
    const legend = h("span", { class: "legend", hidden: true });
    const bar = h("div", { class: "bar", hidden: true }, play, gate, volumes, legend);
    this.shadowRoot?.replaceChildren(h("div", { class: "stage" }, canvas, said), bar);
    const src = this.getAttribute("src");
    if (src === null) return;
    try {
      const [model, report] = await Promise.all([this.#fetched(src, shown.signal).then((answer) => answer.arrayBuffer()).then(readModel), this.#report(shown.signal)]);
      const view = createView(canvas, model, shown.signal);
      const cycle = createCycle(model.timing, shown.signal);
      gate.max = String(cycle.gates);
      play.addEventListener("click", () => cycle.playing.set(!cycle.playing.get()));
      gate.addEventListener("input", () => cycle.seek(gate.valueAsNumber));
      cycle.playing.watch((plays) => (play.textContent = plays ? words.pause : words.play), shown.signal);
      cycle.phase.watch((phase) => view.pose(phase), shown.signal);
      cycle.gate.watch((now) => {
        gate.valueAsNumber = now;
        this.dispatchEvent(new CustomEvent("gatechange", { detail: { gate: now, gates: cycle.gates } }));
      }, shown.signal);
      keys(view);
      volumes.textContent = report?.function ? `${words.ef} ${report.function.ef_percent.toFixed(0)} % · ${report.function.edv_ml.toFixed(0)} / ${report.function.esv_ml.toFixed(0)} ml` : "";
      said.remove();
      show(bar, true);
      show(play, cycle.gates > 1);
      show(gate, cycle.gates > 1);
      this.#now = { view, cycle, model, legend };
      for (const name of ["colour", "play", "gate"]) this.#apply(name);
      this.dispatchEvent(new Event("load"));
    } catch (error) {
      if (shown.signal.aborted) return;
      said.textContent = `${words.failed}: ${error instanceof Error ? error.message : String(error)}`;
      this.dispatchEvent(new ErrorEvent("error", { error }));
    }
  }

  async #report(signal: AbortSignal): Promise<Report | null> {
    const address = this.getAttribute("report");
    return address === null ? null : ((await (await this.#fetched(address, signal)).json()) as Report);
  }

  async #fetched(address: string, signal: AbortSignal): Promise<Response> {
    const answer = await fetch(address, { signal, headers: this.#headers });
    if (!answer.ok) throw new Error(`${address} was answered ${answer.status}`);
    return answer;
  }

  /** Does what an attribute says now. */
  #apply(name: string): void {
    if (this.#now === null) return;
    const { view, cycle, model, legend } = this.#now;
    if (name === "gate" && this.hasAttribute("gate")) cycle.seek(Number(this.getAttribute("gate")) || 1);
    if (name === "play") cycle.playing.set(this.hasAttribute("play") && !matchMedia("(prefers-reduced-motion: reduce)").matches);
    if (name !== "colour") return;
    const variant = model.variants.find((candidate) => candidate.name === this.getAttribute("colour")) ?? null;
    view.paint.colour(variant);
    view.redraw();
    show(legend, variant !== null);
    if (variant === null) return;
    const scale = h("span", { class: "scale" });
    scale.style.background = `linear-gradient(to right, ${variant.colours.join(", ")})`;
    const unit = variant.unit === "degrees" ? "°" : variant.unit;
    legend.replaceChildren(h("span", {}, String(variant.range[0])), scale, h("span", {}, `${variant.range[1]} ${unit}`));
  }
}

function keys(view: View): void {
  const actions: Record<string, () => void> = {
    ArrowLeft: () => view.turn(-8, 0),
    ArrowRight: () => view.turn(8, 0),
    ArrowUp: () => view.turn(0, 8),
    ArrowDown: () => view.turn(0, -8),
    "+": () => view.zoom(0.9),
    "-": () => view.zoom(1.1),
    Home: () => view.home(),
  };
  view.canvas.addEventListener("keydown", (event) => {
    const action = actions[event.key];
    if (action === undefined) return;
    event.preventDefault();
    action();
  });
}

if (customElements.get("ventricle-viewer") === undefined) customElements.define("ventricle-viewer", VentricleViewer);
