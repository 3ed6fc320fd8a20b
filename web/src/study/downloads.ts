import { t } from "../languages/index.ts";
import { h } from "../page/dom.ts";
import type { Shown } from "./shared.ts";

/** All results as files; those of one gate are of the gate shown. */
export function downloadsPanel(shown: Shown): HTMLElement {
  const base = `/v1/reconstructions/${shown.job.id}`;
  const link = (text: string, path: string, name: string | null) => h("li", {}, h("a", { href: `${base}/${path}`, download: name, target: name === null ? "_blank" : null, rel: name === null ? "noopener" : null }, text));
  const ofGate = (text: string, file: string) => {
    const item = link(text, "", file);
    const anchor = item.querySelector("a");
    shown.cycle.gate.watch((gate) => {
      anchor?.setAttribute("href", `${base}/gates/${gate}/${file}`);
      anchor?.setAttribute("download", `gate-${gate}-${file}`);
    }, shown.signal);
    return item;
  };
  return h(
    "section",
    { class: "card downloads-panel", "aria-labelledby": "downloads-title" },
    h("h2", { id: "downloads-title" }, t("downloads.title")),
    h(
      "ul",
      { class: "links" },
      link(t("downloads.page"), "report.html", null),
      link(t("downloads.surfaces"), "surfaces.glb", "surfaces.glb"),
      ofGate(t("downloads.endocardial"), "endocardial.stl"),
      ofGate(t("downloads.epicardial"), "epicardial.stl"),
      ofGate(t("downloads.wall"), "wall.vtu"),
      link(t("downloads.report"), "report", "report.json"),
      link(t("downloads.polar"), "polar-maps", "polar-maps.json"),
      shown.slices === null ? null : link(t("downloads.slices"), "slices", "slices.json"),
      link(t("downloads.sr"), "sr.dcm", "sr.dcm"),
      link(t("downloads.fhir"), "fhir", "fhir.json"),
    ),
  );
}
