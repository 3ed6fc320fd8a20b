import uPlot from "uplot";
import type { Report } from "../../client/src/index.ts";
import { number, t } from "../languages/index.ts";
import { h } from "../page/dom.ts";
import type { Shown } from "./shared.ts";

/** Points that the fit is drawn with. */
const STEPS = 200;
const HEIGHT_PX = 240;

/** The volume of the cavity over the cycle, at the gate shown. */
export function curvePanel(shown: Shown): HTMLElement | null {
  const { report, signal } = shown;
  const curve = curveOf(report);
  if (curve === null) return null;
  const drawing = h("div", { class: "plot", "data-points": JSON.stringify(curve.measured) });
  const figure = h(
    "figure",
    {},
    drawing,
    h("figcaption", { class: "faint" }, t("curve.caption", { gates: curve.measured.length, harmonics: curve.harmonics })),
  );
  let plot: uPlot | null = null;
  const draw = (): void => {
    plot?.destroy();
    plot = plotOf(curve, drawing, shown);
  };
  const dark = matchMedia("(prefers-color-scheme: dark)");
  dark.addEventListener("change", draw, { signal });
  const resized = new ResizeObserver(() => {
    const width = Math.floor(drawing.clientWidth);
    if (width === 0) return;
    if (plot === null) draw();
    else if (plot.width !== width) plot.setSize({ width, height: HEIGHT_PX });
  });
  resized.observe(drawing);
  signal.addEventListener("abort", () => {
    resized.disconnect();
    plot?.destroy();
  });
  shown.cycle.phase.watch(() => plot?.redraw(false), signal);
  return h(
    "section",
    { class: "card curve-panel", "aria-labelledby": "curve-title" },
    h("h2", { id: "curve-title" }, t("curve.title")),
    figure,
    h("details", {}, h("summary", {}, t("curve.table")), tableOf(shown)),
  );
}

interface Curve {
  /** Part of R-R in percent and ml. */
  measured: readonly (readonly [number, number])[];
  fitted: readonly (readonly [number, number])[];
  harmonics: number;
}

/** The measured points, and the Fourier series of the report (docs/report.md, the time-volume curve). */
export function curveOf(report: Report): Curve | null {
  const { cycle } = report;
  if (!cycle) return null;
  const volume = (percent: number) =>
    cycle.harmonics.reduce(
      (sum, harmonic, index) =>
        sum + harmonic.amplitude_ml * Math.cos((2 * Math.PI * (index + 1) * percent) / 100 - (harmonic.phase_degrees * Math.PI) / 180),
      cycle.mean_ml,
    );
  const fitted = Array.from({ length: STEPS + 1 }, (_, step) => [(100 * step) / STEPS, volume((100 * step) / STEPS)] as const);
  return { measured: cycle.gates.map((gate) => [gate.rr_percent, gate.endocardial_ml] as const), fitted, harmonics: cycle.harmonics.length };
}

function plotOf(curve: Curve, into: HTMLElement, shown: Shown): uPlot {
  const style = getComputedStyle(into);
  const colour = (name: string) => style.getPropertyValue(name).trim();
  const xs = [...new Set([...curve.fitted, ...curve.measured].map(([x]) => x))].sort((a, b) => a - b);
  const fitted = new Map(curve.fitted);
  const measured = new Map(curve.measured);
  const axis = { stroke: colour("--muted"), grid: { stroke: colour("--line"), width: 1 }, ticks: { stroke: colour("--line"), width: 1 }, font: "12px system-ui, sans-serif", labelFont: "12px system-ui, sans-serif" };
  const top = Math.max(...curve.measured.map(([, ml]) => ml), ...curve.fitted.map(([, ml]) => ml));
  const marked = (plot: uPlot): void => {
    // The gate shown, and where the model is between two.
    const { ctx } = plot;
    const gate = curve.measured[shown.cycle.gate.get() - 1];
    const half = (curve.measured[0]?.[0] ?? 0) / 100;
    const x = Math.round(plot.valToPos(((shown.cycle.phase.get() + half) % 1) * 100, "x", true));
    ctx.save();
    ctx.strokeStyle = colour("--accent");
    ctx.lineWidth = devicePixelRatio;
    ctx.beginPath();
    ctx.moveTo(x, plot.bbox.top);
    ctx.lineTo(x, plot.bbox.top + plot.bbox.height);
    ctx.stroke();
    if (gate !== undefined) {
      ctx.fillStyle = colour("--accent");
      ctx.beginPath();
      ctx.arc(plot.valToPos(gate[0], "x", true), plot.valToPos(gate[1], "y", true), 6 * devicePixelRatio, 0, 2 * Math.PI);
      ctx.fill();
    }
    ctx.restore();
  };
  const plot = new uPlot(
    {
      width: Math.floor(into.clientWidth),
      height: HEIGHT_PX,
      padding: [10, 12, 0, 0],
      legend: { show: false },
      cursor: { y: false, points: { show: false }, drag: { x: false, y: false } },
      scales: { x: { time: false, range: [0, 100] }, y: { range: [0, Math.ceil((top * 1.08) / 10) * 10] } },
      axes: [
        { ...axis, label: t("curve.time"), labelSize: 20, size: 34 },
        { ...axis, label: t("curve.volume"), labelSize: 18, size: 44 },
      ],
      series: [
        {},
        { stroke: colour("--curve"), width: 2, spanGaps: true, points: { show: false } },
        { stroke: colour("--endocardial"), width: 0, paths: () => null, points: { show: true, size: 8, fill: colour("--endocardial") } },
      ],
      hooks: { draw: [marked] },
    },
    [xs, xs.map((x) => fitted.get(x) ?? null), xs.map((x) => measured.get(x) ?? null)],
    into,
  );
  plot.over.addEventListener("click", (event) => {
    const percent = plot.posToVal(event.offsetX, "x");
    const distances = curve.measured.map(([x]) => Math.abs(x - percent));
    shown.cycle.seek(distances.indexOf(Math.min(...distances)) + 1);
  });
  return plot;
}

function tableOf(shown: Shown): HTMLElement {
  const { report, cycle, signal } = shown;
  const rows = report.gates.map((gate) =>
    h(
      "tr",
      {},
      h("th", { scope: "row" }, h("button", { type: "button", class: "quiet", "aria-label": t("curve.select", { gate: gate.gate }), onclick: () => cycle.seek(gate.gate) }, String(gate.gate))),
      h("td", { class: "number" }, number(gate.endocardial_ml, 1)),
      h("td", { class: "number" }, number(gate.epicardial_ml, 1)),
    ),
  );
  cycle.gate.watch((now) => rows.forEach((row, index) => row.classList.toggle("current", index + 1 === now)), signal);
  const heads = [t("model.gate"), `${t("curve.endocardial")}, ml`, `${t("curve.epicardial")}, ml`];
  return h(
    "table",
    { class: "gates" },
    h("thead", {}, h("tr", {}, ...heads.map((text, index) => h("th", { scope: "col", class: index > 0 ? "number" : null }, text)))),
    h("tbody", {}, ...rows),
  );
}
