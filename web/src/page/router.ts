/** What is shown at a path; the signal is aborted when another page comes. */
export type Route = (path: string, signal: AbortSignal) => HTMLElement;

let render: (() => void) | null = null;

/** Shows in an element what belongs to the address, now and whenever it changes. */
export function route(into: HTMLElement, of: Route): () => void {
  let shown: AbortController | null = null;
  render = () => {
    shown?.abort();
    shown = new AbortController();
    into.replaceChildren(of(location.pathname, shown.signal));
  };
  addEventListener("popstate", () => render?.());
  render();
  return render;
}

/** Goes to a path of these pages. */
export function go(path: string): void {
  history.pushState(null, "", path);
  render?.();
  scrollTo(0, 0);
  // Where a reader begins on the new page.
  document.querySelector<HTMLElement>("h1")?.focus();
}

/** A link's listener that stays on the page. */
export function follow(event: MouseEvent): void {
  if (event.metaKey || event.ctrlKey || event.shiftKey || !(event.currentTarget instanceof HTMLAnchorElement)) return;
  event.preventDefault();
  go(event.currentTarget.pathname);
}
