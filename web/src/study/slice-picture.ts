import type { Slices } from "../../client/src/index.ts";
import type { Counts } from "./counts.ts";

export type Plane = Slices["planes"][number];

/** Grey values that are drawn black and white. */
export interface Window {
  low: number;
  high: number;
}

/** Colours of the contours: seen on grey of any brightness, and told apart by people who see no red. */
const CONTOURS = [
  ["endocardial", "#ff5a4d"],
  ["epicardial", "#36d0e0"],
] as const;

/** Draws a slice and its contours so that it fills the canvas; without counts the contours alone. */
export function drawSlice(
  canvas: HTMLCanvasElement,
  plane: Plane,
  slice: number,
  gate: number,
  counts: Counts | null,
  window: Window,
  contours: boolean,
): void {
  const context = canvas.getContext("2d");
  if (context === null) return;
  const { width, height } = plane;
  context.setTransform(1, 0, 0, 1, 0, 0);
  context.fillStyle = "#000";
  context.fillRect(0, 0, canvas.width, canvas.height);
  const scale = [canvas.width / width, canvas.height / height] as const;
  if (counts !== null) {
    const small = new OffscreenCanvas(width, height);
    const within = small.getContext("2d");
    if (within === null) return;
    within.putImageData(greysOf(counts, width, height, slice, window), 0, 0);
    context.imageSmoothingEnabled = true;
    context.imageSmoothingQuality = "high";
    context.drawImage(small, 0, 0, canvas.width, canvas.height);
  }
  const drawn = plane.gates[gate - 1]?.slices[slice];
  if (!contours || drawn === undefined) return;
  // Pixel centres are at whole numbers.
  context.setTransform(scale[0], 0, 0, scale[1], scale[0] / 2, scale[1] / 2);
  for (const [surface, colour] of CONTOURS) {
    context.beginPath();
    for (const line of drawn[surface]) line.forEach(([x = 0, y = 0], index) => (index === 0 ? context.moveTo(x, y) : context.lineTo(x, y)));
    context.save();
    context.setTransform(1, 0, 0, 1, 0, 0);
    context.strokeStyle = colour;
    context.lineWidth = Math.max(1.2, canvas.width / 260);
    context.lineJoin = "round";
    context.stroke();
    context.restore();
  }
}

function greysOf(counts: Counts, width: number, height: number, slice: number, { low, high }: Window): ImageData {
  const picture = new ImageData(width, height);
  const from = slice * width * height;
  for (let pixel = 0; pixel < width * height; pixel += 1) {
    const grey = (255 * ((counts.greys[from + pixel] ?? 0) - low)) / Math.max(1, high - low);
    picture.data.set([grey, grey, grey, 255], 4 * pixel);
  }
  return picture;
}

/** Height over width of a slice as it is in the body. */
export function aspectOf(plane: Plane): number {
  const [right = 1, down = 1] = plane.pixel_mm;
  return (plane.height * down) / (plane.width * right);
}
