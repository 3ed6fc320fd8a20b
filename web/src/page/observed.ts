/** A value that tells when it changes. */
export interface Observed<T> {
  get(): T;
  set(value: T): void;
  /** Calls at once and at each change until the signal is aborted. */
  watch(told: (value: T) => void, signal: AbortSignal): void;
}

/** A value that tells when it changes. */
export function observed<T>(initial: T): Observed<T> {
  let current = initial;
  const listeners = new Set<(value: T) => void>();
  return {
    get: () => current,
    set(value) {
      if (Object.is(value, current)) return;
      current = value;
      for (const told of [...listeners]) told(value);
    },
    watch(told, signal) {
      if (signal.aborted) return;
      listeners.add(told);
      signal.addEventListener("abort", () => listeners.delete(told));
      told(current);
    },
  };
}
