import { number, t, told } from "../languages/index.ts";
import { h } from "../page/dom.ts";
import { bullsEye } from "./bulls-eye.ts";
import { decimalsOf, type Shown, withUnit } from "./shared.ts";

/** The polar maps of all quantities; one of them may colour the model. */
export function mapsPanel(shown: Shown): HTMLElement {
  const read = h("p", { class: "readout", "aria-live": "polite" });
  shown.segment.watch((segment) => (read.textContent = segment === null ? t("maps.hint") : sentence(shown, segment)), shown.signal);
  
  const { source } = shown.maps.rotation;
  return h(
    "section",
    { class: "card maps-panel", "aria-labelledby": "maps-title" },
    h("h2", { id: "maps-title" }, t("maps.title")),
    read,
    h("div", { class: "maps" }, ...shown.maps.maps.map((map) => mapOf(map, shown))),
    h("p", { class: "faint" }, told("maps.rotation", source)),
  );
}

function mapOf(map: Shown["maps"]["maps"][number], shown: Shown): HTMLElement {
  const title = told("quantity", map.quantity);
  const colour = h("button", { type: "button", class: "quiet", "aria-pressed": "false" }, t("maps.colour"));
  colour.addEventListener("click", () => shown.quantity.set(shown.quantity.get() === map.quantity ? null : map.quantity));
  const [low = 0, high = 0] = map.range;
  const bar = h("span", { class: "bar" });
  const colours = shown.model.variants.find((variant) => variant.name === map.quantity)?.colours ?? [];
  bar.style.background = `linear-gradient(to right, ${colours.join(", ")})`;
  const element = h(
    "figure",
    { class: "map" },
    h("figcaption", {}, title),
    bullsEye(map, shown),
    h("div", { class: "legend" }, h("span", {}, number(low)), bar, h("span", {}, withUnit(number(high), map.unit))),
    colour,
  );
  shown.quantity.watch((now) => {
    colour.setAttribute("aria-pressed", String(now === map.quantity));
    colour.setAttribute("aria-label", `${t("maps.colour")}: ${title}`);
    colour.textContent = now === map.quantity ? t("maps.coloured") : t("maps.colour");
    element.classList.toggle("chosen", now === map.quantity);
  }, shown.signal);
  return element;
}

/** All that is known of a segment. */
function sentence(shown: Shown, segment: number): string {
  const parts = shown.maps.maps.map((map) => {
    const value = map.segments[segment - 1] ?? null;
    const text = value === null ? t("model.noValue") : withUnit(number(value, decimalsOf(map.unit)), map.unit);
    return `${told("quantity", map.quantity)} ${text}`;
  });
  return t("maps.segment", { number: segment, name: told("segment", String(segment)), value: parts.join(" · ") });
}
