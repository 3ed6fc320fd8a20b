import type { Report } from "../../client/src/index.ts";
import { t, told } from "../languages/index.ts";
import { h } from "../page/dom.ts";

/** What speaks against the result, in words. */
export function warningsPanel(report: Report): HTMLElement {
  const items = report.warnings.map((warning) =>
    h(
      "li",
      { class: report.quality.flags.includes(warning.code) ? "flagged" : null },
      h("strong", {}, told("flag", warning.code), warning.gate ? ` (${t("warnings.gate", { gate: warning.gate })})` : ""),
      // The service's own sentence is English.
      h("span", { lang: "en" }, warning.message),
    ),
  );
  const caution = report.cycle?.caution ?? null;
  if (caution !== null) items.push(h("li", {}, h("strong", {}, t("curve.title")), h("span", { lang: "en" }, caution)));
  return h(
    "section",
    { class: "card warnings-panel", "aria-labelledby": "warnings-title" },
    h("h2", { id: "warnings-title" }, t("warnings.title")),
    items.length === 0 ? h("p", { class: "faint" }, t("warnings.none")) : h("ul", { class: "warnings" }, ...items),
  );
}
