/** Style of the component. A constructed sheet is no inline style, so that the host's Content-Security-Policy does not matter to it. */
export function styleSheet(): CSSStyleSheet {
  const sheet = new CSSStyleSheet();
  sheet.replaceSync(`
    :host { display: flex; flex-direction: column; min-width: 200px; min-height: 260px; height: 420px; color: inherit; font: 14px/1.4 system-ui, sans-serif; font-variant-numeric: tabular-nums; }
    :host([hidden]), [hidden] { display: none; }
    .stage { position: relative; flex: 1; min-height: 0; }
    canvas { position: absolute; inset: 0; width: 100%; height: 100%; display: block; cursor: grab; touch-action: none; }
    canvas:focus-visible, button:focus-visible, input:focus-visible { outline: 3px solid Highlight; outline-offset: -3px; }
    .bar { display: flex; flex-wrap: wrap; align-items: center; gap: 6px 12px; padding: 6px 8px; }
    button { font: inherit; min-height: 32px; min-width: 84px; cursor: pointer; }
    input { flex: 1 1 100px; min-width: 0; }
    .legend { display: flex; align-items: center; gap: 6px; }
    .scale { width: 110px; height: 10px; border-radius: 5px; border: 1px solid GrayText; }
    .said { position: absolute; inset: auto 8px 8px; margin: 0; }
  `);
  return sheet;
}
