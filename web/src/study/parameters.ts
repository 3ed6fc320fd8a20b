import type { Report } from "../../client/src/index.ts";
import { t } from "../languages/index.ts";
import { h } from "../page/dom.ts";

/** The parameters that were used: sent again they give the same report. */
export function parametersPanel(report: Report): HTMLElement {
  const rows = flat(report.parameters as Record<string, unknown>).map(([name, value]) =>
    h("tr", {}, h("th", { scope: "row" }, h("code", {}, name)), h("td", {}, h("code", {}, JSON.stringify(value)))),
  );
  const head = h("thead", {}, h("tr", {}, h("th", { scope: "col" }, t("parameters.name")), h("th", { scope: "col" }, t("parameters.value"))));
  const preset = String((report.parameters as { preset?: unknown }).preset ?? "");
  return h(
    "section",
    { class: "card parameters-panel", "aria-labelledby": "parameters-title" },
    h("h2", { id: "parameters-title" }, t("parameters.title")),
    h("p", {}, `${t("again.preset")}: `, h("code", {}, preset), ` · Ventricle ${report.software.version}`),
    h("details", {}, h("summary", {}, t("parameters.show")), h("table", { class: "parameters" }, head, h("tbody", {}, ...rows))),
  );
}

function flat(values: Record<string, unknown>, prefix = ""): [string, unknown][] {
  return Object.entries(values).flatMap(([name, value]): [string, unknown][] =>
    typeof value === "object" && value !== null && !Array.isArray(value)
      ? flat(value as Record<string, unknown>, `${prefix}${name}.`)
      : [[prefix + name, value]],
  );
}
