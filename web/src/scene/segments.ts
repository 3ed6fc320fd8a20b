/** Rings of the seventeen segments (Cerqueira et al. 2002) from the rim to the tip: outer and inner radius, first segment, how many. */
export const RINGS = [
  { inner: 0.75, outer: 1, first: 1, count: 6 },
  { inner: 0.5, outer: 0.75, first: 7, count: 6 },
  { inner: 0.25, outer: 0.5, first: 13, count: 4 },
  { inner: 0, outer: 0.25, first: 17, count: 1 },
] as const;

/** Segments in all. */
export const SEGMENTS = 17;

/** Radius of the polar disc in a texture whose side is 1, as the service draws it. */
export const DISC_RADIUS = 0.44;

/** The segment at a place of the polar map; null outside of the wall. */
export function segmentAt(radius: number, degrees: number): number | null {
  const ring = RINGS.find((candidate) => radius >= candidate.inner && radius <= candidate.outer + (candidate.first === 1 ? 0.03 : 0));
  if (ring === undefined) return null;
  const turn = 360 / ring.count;
  return ring.first + (Math.round((((degrees % 360) + 360) % 360) / turn) % ring.count);
}

/** The segment at a texture coordinate of the wall. */
export function segmentAtTexture(u: number, v: number): number | null {
  const right = (u - 0.5) / DISC_RADIUS;
  const down = (v - 0.5) / DISC_RADIUS;
  return segmentAt(Math.hypot(right, down), (Math.atan2(-right, -down) * 180) / Math.PI);
}

/** The middle of a segment in the polar map. */
export function middleOf(segment: number): { radius: number; degrees: number } {
  const ring = RINGS.find((candidate) => segment >= candidate.first && segment < candidate.first + candidate.count);
  if (ring === undefined || ring.first === SEGMENTS) return { radius: 0, degrees: 0 };
  return { radius: (ring.inner + ring.outer) / 2, degrees: (360 / ring.count) * (segment - ring.first) };
}
