import type { Job, PolarMaps, Report, Slices } from "../../client/src/index.ts";
import type { Cycle } from "../page/cycle.ts";
import type { Observed } from "../page/observed.ts";
import type { Model } from "../scene/load.ts";

/** What the parts of a study's page show, and how they know of each other. */
export interface Shown {
  job: Job;
  report: Report;
  maps: PolarMaps;
  /** Null for a study of before slices were stored. */
  slices: Slices | null;
  model: Model;
  cycle: Cycle;
  /** The segment under the pointer or the focus, on whichever part it is. */
  segment: Observed<number | null>;
  /** The quantity that colours the model; null is plain. */
  quantity: Observed<string | null>;
  signal: AbortSignal;
}

/** Digits after the point that a unit is read with. */
export function decimalsOf(unit: string): number {
  return unit === "mm" ? 1 : 0;
}

/** A value with its unit, as it is written. */
export function withUnit(value: string, unit: string): string {
  return unit === "degrees" ? `${value}°` : `${value} ${unit}`;
}
