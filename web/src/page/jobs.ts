import type { Job } from "../../client/src/index.ts";

/** What the one stream of all reconstructions tells. */
export interface JobListener {
  /** The stream is open, for the first time or again: what happened meanwhile is in the list alone. */
  opened(): void;
  changed(job: Job): void;
  deleted(id: string): void;
  /** The stream broke; it is tried again. */
  lost(): void;
}

/** Milliseconds between two tries where the browser gave up. */
const AGAIN_MS = 3000;

/** Follows all reconstructions until the signal is aborted. */
export function followJobs(listener: JobListener, signal: AbortSignal): void {
  let timer: ReturnType<typeof setTimeout> | undefined;
  let source: EventSource | null = null;
  const data = (event: Event): unknown => JSON.parse((event as MessageEvent<string>).data);
  const open = (): void => {
    source = new EventSource("/v1/reconstructions/events");
    source.addEventListener("hello", () => listener.opened());
    source.addEventListener("job", (event) => listener.changed(data(event) as Job));
    source.addEventListener("deleted", (event) => listener.deleted((data(event) as { id: string }).id));
    source.addEventListener("error", () => {
      if (signal.aborted) return;
      listener.lost();
      if (source?.readyState !== EventSource.CLOSED) return;
      clearTimeout(timer);
      timer = setTimeout(open, AGAIN_MS);
    });
  };
  open();
  signal.addEventListener("abort", () => {
    clearTimeout(timer);
    source?.close();
  });
}
