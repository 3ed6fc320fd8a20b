import type { Report } from "../../client/src/index.ts";
import { number, t } from "../languages/index.ts";
import { type Child, h } from "../page/dom.ts";

/** A row of the table: value, standard error, interval and what it is per m² of body surface. */
interface Measure {
  name: string;
  unit: string;
  value: number;
  uncertainty: { standard_error: number; low_95: number; high_95: number } | null;
  indexed: number | null;
}

/** The figures of the left ventricle, the ejection fraction first. */
export function numbersPanel(report: Report): HTMLElement {
  const measures = measuresOf(report);
  const ef = report.function ?? null;
  return h(
    "section",
    { class: "card numbers-panel", "aria-labelledby": "numbers-title" },
    h("h2", { id: "numbers-title" }, t("numbers.title")),
    ef === null
      ? h("p", {}, t("numbers.ungated"))
      : h(
          "p",
          { class: "headline" },
          h("span", { class: "label" }, t("numbers.ef")),
          h("span", { class: "big", id: "ef" }, number(ef.ef_percent), h("small", {}, " %")),
          report.uncertainty ? h("span", { class: "faint" }, `± ${number(report.uncertainty.ef_percent?.standard_error ?? 0)} %`) : null,
        ),
    tableOf(measures, report),
    report.body?.surface_area_m2 === null || report.body === undefined ? h("p", { class: "faint small" }, t("numbers.noBody")) : null,
    h("details", {}, h("summary", {}, t("numbers.more")), further(report)),
  );
}

function measuresOf(report: Report): Measure[] {
  const { function: cycle, uncertainty, body, gates, myocardium } = report;
  const sure = (of: "edv_ml" | "esv_ml" | "ef_percent" | "mass_g") => uncertainty?.[of] ?? null;
  const mass: Measure = { name: t("numbers.mass"), unit: "g", value: myocardium.mass_g, uncertainty: sure("mass_g"), indexed: body?.mass_g_per_m2 ?? null };
  if (!cycle) {
    const volume = gates[0]?.endocardial_ml ?? 0;
    return [{ name: t("numbers.volume"), unit: "ml", value: volume, uncertainty: sure("edv_ml"), indexed: null }, mass];
  }
  return [
    { name: t("numbers.edv"), unit: "ml", value: cycle.edv_ml, uncertainty: sure("edv_ml"), indexed: body?.edv_ml_per_m2 ?? null },
    { name: t("numbers.esv"), unit: "ml", value: cycle.esv_ml, uncertainty: sure("esv_ml"), indexed: body?.esv_ml_per_m2 ?? null },
    { name: t("numbers.sv"), unit: "ml", value: cycle.sv_ml, uncertainty: null, indexed: body?.sv_ml_per_m2 ?? null },
    { name: t("numbers.ef"), unit: "%", value: cycle.ef_percent, uncertainty: sure("ef_percent"), indexed: null },
    mass,
  ];
}

function tableOf(measures: readonly Measure[], report: Report): HTMLElement {
  const unsure = measures.some((measure) => measure.uncertainty !== null);
  const indexed = measures.some((measure) => measure.indexed !== null);
  const heads: Child[] = [
    h("th", { scope: "col" }, t("numbers.what")),
    h("th", { scope: "col", class: "number" }, t("numbers.value")),
    unsure && h("th", { scope: "col", class: "number" }, "± SE"),
    unsure && h("th", { scope: "col", class: "number wide" }, t("numbers.interval")),
    indexed && h("th", { scope: "col", class: "number" }, t("numbers.indexed")),
  ];
  const rows = measures.map(({ name, unit, value, uncertainty: sure, indexed: per }) =>
    h(
      "tr",
      {},
      h("th", { scope: "row" }, name),
      h("td", { class: "number strong" }, `${number(value)} ${unit}`),
      unsure && h("td", { class: "number" }, sure === null ? "–" : number(sure.standard_error)),
      unsure && h("td", { class: "number wide" }, sure === null ? "–" : `${number(sure.low_95)} – ${number(sure.high_95)}`),
      indexed && h("td", { class: "number" }, per === null ? "–" : `${number(per)} ${unit}/m²`),
    ),
  );
  const quality = h(
    "tr",
    {},
    h("th", { scope: "row" }, t("numbers.quality")),
    h("td", { class: "number strong" }, number(report.quality.score, 2)),
    unsure && h("td", {}),
    unsure && h("td", { class: "wide" }),
    indexed && h("td", {}),
  );
  return h("table", { class: "measures" }, h("thead", {}, h("tr", {}, ...heads)), h("tbody", {}, ...rows, quality));
}

function further(report: Report): HTMLElement {
  const { perfusion, phase, cycle, model } = report;
  const rows: (readonly [string, string])[] = [];
  if (perfusion) {
    const value = t("numbers.perfusionDefect.value", { extent: number(perfusion.extent_percent), threshold: number(perfusion.threshold_percent) });
    rows.push([t("numbers.perfusionDefect"), value]);
  }
  if (phase) {
    rows.push([t("numbers.phaseSd"), `${number(phase.sd_degrees, 1)}°`], [t("numbers.phaseBandwidth"), `${number(phase.bandwidth_95_degrees)}°`]);
  }
  const rate = (name: string, value: number | null | undefined) => {
    if (value !== null && value !== undefined) rows.push([name, `${number(value, 2)} ${t("numbers.perSecond")}`]);
  };
  rate(t("numbers.per"), cycle?.peak_emptying_rate_edv_per_s);
  rate(t("numbers.pfr"), cycle?.peak_filling_rate_edv_per_s);
  if (model) rows.push([t("numbers.psf"), `${number(model.psf.fwhm_mm, 1)} mm`]);
  return h("dl", { class: "pairs" }, ...rows.map(([name, value]) => h("div", {}, h("dt", {}, name), h("dd", {}, value))));
}
