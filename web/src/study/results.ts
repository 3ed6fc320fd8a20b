import { h } from "../page/dom.ts";
import { againPanel } from "./again.ts";
import { curvePanel } from "./curve.ts";
import { downloadsPanel } from "./downloads.ts";
import { mapsPanel } from "./maps.ts";
import { modelPanel } from "./model.ts";
import { numbersPanel } from "./numbers.ts";
import { parametersPanel } from "./parameters.ts";
import type { Shown } from "./shared.ts";
import { slicesPanel } from "./slices.ts";
import { warningsPanel } from "./warnings.ts";

/** The results of a study, in the order in which they are read. */
export function results(shown: Shown): HTMLElement {
  return h(
    "div",
    { class: "results" },
    modelPanel(shown),
    h("div", { class: "side" }, numbersPanel(shown.report), curvePanel(shown)),
    warningsPanel(shown.report),
    mapsPanel(shown),
    slicesPanel(shown),
    h("div", { class: "pair" }, downloadsPanel(shown), parametersPanel(shown.report)),
    againPanel(shown),
  );
}
