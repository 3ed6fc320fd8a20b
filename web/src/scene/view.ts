import { DirectionalLight, HemisphereLight, PerspectiveCamera, Scene, Vector3, WebGLRenderer } from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";
import { weights } from "../page/cycle.ts";
import type { Model } from "./load.ts";
import { paint, type Paint } from "./materials.ts";
import { measurement, type Measurement } from "./measure.ts";
import { pick, type Hit } from "./pick.ts";

/** The model on a canvas. */
export interface View {
  readonly canvas: HTMLCanvasElement;
  readonly paint: Paint;
  readonly measurement: Measurement;
  readonly renderer: WebGLRenderer;
  /** Shows a part of the cycle, 0 to 1. */
  pose(phase: number): void;
  shown(surface: "endocardial" | "epicardial", visible: boolean): void;
  /** Turns by degrees to the right and up, as the arrow keys do. */
  turn(right: number, up: number): void;
  zoom(factor: number): void;
  home(): void;
  /** What lies at a place of the canvas in CSS pixels; its middle when none is given. */
  at(x?: number, y?: number): Hit | null;
  /** Draws at the next frame. */
  redraw(): void;
  /** Where the heart stands and how large, for a session in space; null back on the page. */
  place(at: Vector3 | null, scale: number): void;
  onDistance: ((mm: number | null) => void) | null;
}

/** Vertical field of view in degrees, and how many radii of the heart the camera is away. */
const FIELD_OF_VIEW = 28;
const DISTANCE_RADII = 5.3;
/** A heart's radius, in m, where the model does not tell a better one. */
const RADIUS_M = 0.05;

/** Draws the model on a canvas, which fills its parent, until the signal is aborted. Throws where the browser has no WebGL. */
export function createView(canvas: HTMLCanvasElement, model: Model, signal: AbortSignal): View {
  const renderer = new WebGLRenderer({ canvas, antialias: true, alpha: true });
  const scene = new Scene();
  const camera = new PerspectiveCamera(FIELD_OF_VIEW, 1, 0.005, 20);
  scene.add(model.root, new HemisphereLight(0xffffff, 0x6f7a86, 1.5), camera);
  model.root.position.set(0, 0, 0);
  const lamp = new DirectionalLight(0xffffff, 1.5);
  lamp.position.set(0.4, 0.7, 1);
  camera.add(lamp);
  const painted = paint(model);
  const measured = measurement(model.root);
  const controls = new OrbitControls(camera, canvas);
  controls.enablePan = false;
  controls.minDistance = 2 * RADIUS_M;
  controls.maxDistance = 14 * RADIUS_M;
  let asked = 0;
  const view: View = {
    canvas,
    paint: painted,
    measurement: measured,
    renderer,
    onDistance: null,
    pose(phase) {
      const influences = weights(model.timing, phase);
      for (const surface of [model.endocardial, model.epicardial]) {
        for (const mesh of surface.meshes) mesh.morphTargetInfluences?.splice(0, influences.length, ...influences);
      }
      view.redraw();
    },
    shown(surface, visible) {
      for (const mesh of model[surface].meshes) mesh.visible = visible;
      view.redraw();
    },
    turn(right, up) {
      const from = camera.position.clone().sub(controls.target);
      from.applyAxisAngle(camera.up, (-right * Math.PI) / 180);
      const across = new Vector3().crossVectors(camera.up, from).normalize();
      const raised = from.clone().applyAxisAngle(across, (-up * Math.PI) / 180);
      // Not over the pole, where left and right would change places.
      if (Math.abs(raised.clone().normalize().dot(camera.up)) < 0.98) from.copy(raised);
      camera.position.copy(controls.target).add(from);
      controls.update();
      view.redraw();
    },
    zoom(factor) {
      const from = camera.position.clone().sub(controls.target);
      const far = Math.min(controls.maxDistance, Math.max(controls.minDistance, from.length() * factor));
      camera.position.copy(controls.target).add(from.setLength(far));
      controls.update();
      view.redraw();
    },
    home() {
      // The patient's front and a bit from the left, where the ventricle lies; without a patient the apex down, anterior and lateral in front.
      const from = model.isPatient ? new Vector3(0.55, 0.2, 1) : model.anterior.clone().addScaledVector(model.septal, -0.7);
      camera.up.copy(model.isPatient ? new Vector3(0, 1, 0) : model.base);
      camera.position.copy(from.setLength(DISTANCE_RADII * RADIUS_M));
      controls.target.set(0, 0, 0);
      controls.update();
      view.redraw();
    },
    at(x, y) {
      // It may have been turned since it was drawn.
      camera.updateMatrixWorld();
      const box = canvas.getBoundingClientRect();
      const [left, top] = [x ?? box.width / 2, y ?? box.height / 2];
      return pick(model, camera, (left / box.width) * 2 - 1, 1 - (top / box.height) * 2);
    },
    redraw() {
      if (asked === 0 && !renderer.xr.isPresenting) asked = requestAnimationFrame(draw);
    },
    place(at, scale) {
      model.root.position.copy(at ?? new Vector3());
      model.root.scale.setScalar(scale);
      view.redraw();
    },
  };
  const draw = (): void => {
    asked = 0;
    if (signal.aborted) return;
    view.onDistance?.(measured.update());
    renderer.render(scene, camera);
  };
  renderer.xr.addEventListener("sessionstart", () => renderer.setAnimationLoop(draw));
  renderer.xr.addEventListener("sessionend", () => {
    renderer.setAnimationLoop(null);
    view.redraw();
  });
  controls.addEventListener("change", () => view.redraw());
  const fit = (): void => {
    const { clientWidth: width, clientHeight: height } = canvas.parentElement ?? canvas;
    if (width === 0 || height === 0 || renderer.xr.isPresenting) return;
    renderer.setPixelRatio(Math.min(2, devicePixelRatio));
    renderer.setSize(width, height, false);
    camera.aspect = width / height;
    // A narrow canvas must not cut the heart at its sides.
    camera.fov = camera.aspect < 1 ? (2 * Math.atan(Math.tan((FIELD_OF_VIEW * Math.PI) / 360) / camera.aspect) * 180) / Math.PI : FIELD_OF_VIEW;
    camera.updateProjectionMatrix();
    view.redraw();
  };
  const resized = new ResizeObserver(fit);
  resized.observe(canvas.parentElement ?? canvas);
  signal.addEventListener("abort", () => {
    resized.disconnect();
    cancelAnimationFrame(asked);
    controls.dispose();
    for (const mesh of [...model.endocardial.meshes, ...model.epicardial.meshes]) mesh.geometry.dispose();
    for (const variant of model.variants) variant.texture.dispose();
    renderer.dispose();
  });
  view.home();
  fit();
  return view;
}
