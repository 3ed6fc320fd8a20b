import { bytes } from "../page/service.ts";

/** All slices of a plane at a gate, one under another: a grey value for each pixel. */
export interface Counts {
  width: number;
  greys: Uint8ClampedArray;
}

/** Fetches the counts of gates as they are asked for, each once. */
export function countsOf(id: string, signal: AbortSignal): (plane: string, gate: number) => Promise<Counts> {
  const kept = new Map<string, Promise<Counts>>();
  return (plane, gate) => {
    const path = `/v1/reconstructions/${id}/gates/${gate}/slices.png?plane=${plane}`;
    const known = kept.get(path);
    if (known !== undefined) return known;
    const fetched = bytes(path, signal).then(decode);
    kept.set(path, fetched);
    // What failed is asked for again.
    fetched.catch(() => kept.delete(path));
    return fetched;
  };
}

async function decode(file: ArrayBuffer): Promise<Counts> {
  const picture = await createImageBitmap(new Blob([file], { type: "image/png" }), { colorSpaceConversion: "none" });
  const canvas = new OffscreenCanvas(picture.width, picture.height);
  const context = canvas.getContext("2d", { willReadFrequently: true });
  if (context === null) throw new Error("This browser draws no pictures.");
  context.drawImage(picture, 0, 0);
  const { data } = context.getImageData(0, 0, picture.width, picture.height);
  const greys = new Uint8ClampedArray(picture.width * picture.height);
  for (let pixel = 0; pixel < greys.length; pixel += 1) greys[pixel] = data[4 * pixel] ?? 0;
  return { width: picture.width, greys };
}
