import { number, t, told } from "../languages/index.ts";
import { h, svg } from "../page/dom.ts";
import { middleOf, RINGS, SEGMENTS } from "../scene/segments.ts";
import type { PolarMaps } from "../../client/src/index.ts";
import { decimalsOf, type Shown, withUnit } from "./shared.ts";

type PolarMap = PolarMaps["maps"][number];

/** Pixels of the coloured disc, and units of the drawing over it. */
const DISC_PX = 320;
const RADIUS = 100;
const SIZE = 2 * RADIUS + 34;

/** A polar map: its colours on a canvas, its segments over them, which can be pointed at and reached by keys. */
export function bullsEye(map: PolarMap, shown: Shown): HTMLElement {
  const colours = shown.model.variants.find((variant) => variant.name === map.quantity)?.colours ?? ["#000000", "#ffffff"];
  const canvas = h("canvas", { width: DISC_PX, height: DISC_PX, "aria-hidden": "true" });
  paintDisc(canvas, map, shown.maps, colours);
  const quantity = told("quantity", map.quantity);
  const half = SIZE / 2;
  const parts = Array.from({ length: SEGMENTS }, (_, index) => segmentOf(index + 1, map, shown));
  const letters = [
    [t("maps.anterior"), 0, -RADIUS - 8],
    [t("maps.septal"), -RADIUS - 9, 0],
    [t("maps.inferior"), 0, RADIUS + 9],
    [t("maps.lateral"), RADIUS + 9, 0],
  ] as const;
  const drawing = svg(
    "svg",
    { viewBox: `${-half} ${-half} ${SIZE} ${SIZE}`, role: "listbox", "aria-label": t("maps.list", { quantity }), tabindex: 0 },
    ...parts,
    ...letters.map(([text, x, y]) => svg("text", { x, y, class: "wall" }, text)),
  );
  listen(drawing, parts, shown);
  return h("div", { class: "bulls-eye" }, canvas, drawing);
}

function segmentOf(segment: number, map: PolarMap, shown: Shown): SVGGElement {
  const value = map.segments[segment - 1] ?? null;
  const text = value === null ? "–" : number(value, value > -10 && value < 10 ? decimalsOf(map.unit) : 0);
  // As it is written in the drawing: what is seen and what is read aloud are one.
  const full = value === null ? `${text} ${t("model.noValue")}` : withUnit(text, map.unit);
  const label = t("maps.segment", { number: segment, name: told("segment", String(segment)), value: full });
  const { radius, degrees } = middleOf(segment);
  const [x, y] = place(radius, degrees);
  const part = svg(
    "g",
    { role: "option", id: `${map.quantity}-${segment}`, "aria-label": label, "aria-selected": "false", "data-segment": segment },
    svg("path", { d: outline(segment), class: "segment" }),
    svg("text", { x, y, class: "mean", "aria-hidden": "true" }, text),
  );
  shown.segment.watch((now) => {
    part.classList.toggle("chosen", now === segment);
    part.setAttribute("aria-selected", String(now === segment));
  }, shown.signal);
  return part;
}

/** Pointing and the arrow keys choose the segment everywhere on the page. */
function listen(drawing: SVGSVGElement, parts: readonly SVGGElement[], shown: Shown): void {
  const choose = (segment: number | null): void => {
    shown.segment.set(segment);
    const id = segment === null ? null : parts[segment - 1]?.id;
    if (id) drawing.setAttribute("aria-activedescendant", id);
    else drawing.removeAttribute("aria-activedescendant");
  };
  parts.forEach((part, index) => part.addEventListener("pointerenter", () => choose(index + 1)));
  drawing.addEventListener("pointerleave", () => choose(null));
  drawing.addEventListener("blur", () => choose(null));
  drawing.addEventListener("keydown", (event) => {
    const now = shown.segment.get() ?? 0;
    const next = { ArrowRight: now + 1, ArrowDown: now + 1, ArrowLeft: now - 1, ArrowUp: now - 1, Home: 1, End: SEGMENTS }[event.key];
    if (event.key === "Escape") choose(null);
    if (next === undefined) return;
    event.preventDefault();
    choose(((next - 1 + SEGMENTS) % SEGMENTS) + 1);
  });
}

/** A place of the map in the drawing: anterior up, septal left. */
function place(radius: number, degrees: number): [number, number] {
  const angle = (degrees * Math.PI) / 180;
  return [-radius * RADIUS * Math.sin(angle), -radius * RADIUS * Math.cos(angle)];
}

function outline(segment: number): string {
  const ring = RINGS.find((candidate) => segment >= candidate.first && segment < candidate.first + candidate.count);
  if (ring === undefined) return "";
  const point = (radius: number, degrees: number) => place(radius, degrees).map((part) => part.toFixed(2)).join(" ");
  const outer = ring.outer * RADIUS;
  const inner = ring.inner * RADIUS;
  if (ring.count === 1) return `M ${point(ring.outer, 0)} A ${outer} ${outer} 0 1 0 ${point(ring.outer, 180)} A ${outer} ${outer} 0 1 0 ${point(ring.outer, 0)} Z`;
  const turn = 360 / ring.count;
  const from = turn * (segment - ring.first) - turn / 2;
  const to = from + turn;
  return `M ${point(ring.outer, from)} A ${outer} ${outer} 0 0 0 ${point(ring.outer, to)} L ${point(ring.inner, to)} A ${inner} ${inner} 0 0 1 ${point(ring.inner, from)} Z`;
}

function paintDisc(canvas: HTMLCanvasElement, map: PolarMap, maps: PolarMaps, colours: readonly string[]): void {
  const context = canvas.getContext("2d");
  if (context === null) return;
  const picture = context.createImageData(DISC_PX, DISC_PX);
  const scale = colours.map(rgb);
  const [low = 0, high = 1] = map.range;
  const middle = DISC_PX / 2;
  for (let y = 0; y < DISC_PX; y += 1) {
    for (let x = 0; x < DISC_PX; x += 1) {
      const [right, down] = [(x + 0.5 - middle) / middle, (y + 0.5 - middle) / middle];
      const radius = Math.hypot(right, down);
      if (radius > 1) continue;
      const turn = (Math.atan2(-right, -down) / (2 * Math.PI) + 1) % 1;
      const value = valueAt(map, maps, radius, turn);
      const colour = value === null ? [141, 150, 158] : blend(scale, (value - low) / (high - low));
      // The rim is one pixel soft.
      const alpha = Math.min(1, (1 - radius) * middle);
      picture.data.set([...colour, 255 * alpha], 4 * (y * DISC_PX + x));
    }
  }
  context.putImageData(picture, 0, 0);
}

/** Between the middles of four cells; the nearest one's where one of them has no value, or where values are directions. */
function valueAt(map: PolarMap, maps: PolarMaps, radius: number, turn: number): number | null {
  const ring = Math.min(maps.rings - 1, Math.max(0, radius * maps.rings - 0.5));
  const sector = turn * maps.sectors - 0.5;
  const at = (r: number, s: number) => map.values[Math.min(r, maps.rings - 1)]?.[(s + maps.sectors) % maps.sectors] ?? null;
  const [r, s] = [Math.floor(ring), Math.floor(sector)];
  const four = [at(r, s), at(r, s + 1), at(r + 1, s), at(r + 1, s + 1)];
  const nearest = at(Math.round(ring), Math.round(sector));
  if (map.unit === "degrees" || four.includes(null)) return nearest;
  const [a = 0, b = 0, c = 0, d = 0] = four as number[];
  const [p, q] = [ring - r, sector - s];
  return (a * (1 - q) + b * q) * (1 - p) + (c * (1 - q) + d * q) * p;
}

function blend(scale: readonly number[][], part: number): number[] {
  const at = Math.min(1, Math.max(0, part)) * (scale.length - 1);
  const below = Math.min(scale.length - 2, Math.floor(at));
  const [from = [0, 0, 0], to = [0, 0, 0]] = [scale[below], scale[below + 1]];
  return from.map((channel, index) => channel + ((to[index] ?? 0) - channel) * (at - below));
}

function rgb(hex: string): number[] {
  return [1, 3, 5].map((start) => Number.parseInt(hex.slice(start, start + 2), 16));
}
