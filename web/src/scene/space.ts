import { Vector3 } from "three";
import { t } from "../languages/index.ts";
import { h } from "../page/dom.ts";
import type { View } from "./view.ts";

/** Where the heart floats before the eyes, in m, and how many times its size. */
const BEFORE_EYES = new Vector3(0, -0.1, -0.6);
const TIMES = 2;

/** Buttons for augmented and virtual reality, each there only where the device has it. */
export function spaceButtons(view: View, signal: AbortSignal): HTMLElement {
  const buttons = h("span", { class: "space" });
  const { xr } = navigator;
  if (xr === undefined) return buttons;
  for (const [mode, label] of [["immersive-ar", t("model.ar")], ["immersive-vr", t("model.vr")]] as const) {
    xr.isSessionSupported(mode).then(
      (supported) => {
        if (supported && !signal.aborted) buttons.append(h("button", { type: "button", onclick: () => void enter(view, xr, mode) }, label));
      },
      () => undefined,
    );
  }
  return buttons;
}

async function enter(view: View, xr: XRSystem, mode: XRSessionMode): Promise<void> {
  const session = await xr.requestSession(mode);
  view.renderer.xr.enabled = true;
  view.renderer.xr.setReferenceSpaceType("local");
  session.addEventListener("end", () => {
    view.renderer.xr.enabled = false;
    view.place(null, 1);
    view.home();
  });
  view.place(BEFORE_EYES, TIMES);
  await view.renderer.xr.setSession(session);
}
