import { observed, type Observed } from "./observed.ts";

/** Where in the cardiac cycle everything on the page is. */
export interface Cycle {
  readonly gates: number;
  /** Part of the R-R interval, 0 to 1, as the model shows it: between gates when it plays. */
  readonly phase: Observed<number>;
  /** The gate shown, counted from 1. */
  readonly gate: Observed<number>;
  readonly playing: Observed<boolean>;
  /** Cycles shown in the time of one. */
  readonly speed: Observed<number>;
  /** Stops and shows a gate. */
  seek(gate: number): void;
}

/** When each gate begins and how long the cycle is, in s. */
export interface Timing {
  startsS: readonly number[];
  rrIntervalS: number;
}

/** A cycle at its first gate; it stands still until it is played. */
export function createCycle(timing: Timing, signal: AbortSignal): Cycle {
  const gates = timing.startsS.length;
  const starts = timing.startsS.map((start) => start / timing.rrIntervalS);
  const phase = observed(0);
  const gate = observed(1);
  const playing = observed(false);
  const speed = observed(1);
  phase.watch((part) => gate.set(gateAt(starts, part)), signal);
  let last: number | null = null;
  const step = (now: number): void => {
    if (signal.aborted || !playing.get()) {
      last = null;
      return;
    }
    const passedS = last === null ? 0 : (now - last) / 1000;
    last = now;
    phase.set((phase.get() + (passedS * speed.get()) / timing.rrIntervalS) % 1);
    requestAnimationFrame(step);
  };
  playing.watch((plays) => {
    if (plays && gates > 1) requestAnimationFrame(step);
  }, signal);
  return {
    gates,
    phase,
    gate,
    playing,
    speed,
    seek(number) {
      playing.set(false);
      const index = (((number - 1) % gates) + gates) % gates;
      phase.set(starts[index] ?? 0);
    },
  };
}

/** The gate nearest in time, from 1: the model is drawn between two. */
function gateAt(starts: readonly number[], part: number): number {
  let nearest = 0;
  let least = Infinity;
  starts.forEach((start, index) => {
    const apart = Math.abs(start - part);
    const around = Math.min(apart, 1 - apart);
    if (around < least - 1e-9) [least, nearest] = [around, index];
  });
  return nearest + 1;
}

/** How much each gate weighs in what is shown at a part of the cycle. */
export function weights(timing: Timing, part: number): number[] {
  const starts = timing.startsS.map((start) => start / timing.rrIntervalS);
  const result = starts.map(() => 0);
  const before = Math.max(0, starts.findLastIndex((start) => start <= part + 1e-9));
  const after = (before + 1) % starts.length;
  const from = starts[before] ?? 0;
  const to = after === 0 ? 1 : (starts[after] ?? 1);
  const way = Math.min(1, Math.max(0, (part - from) / (to - from)));
  result[before] = 1 - way;
  result[after] = (result[after] ?? 0) + way;
  return result;
}
