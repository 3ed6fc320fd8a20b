import { type Camera, type Intersection, Raycaster, Vector2, Vector3, type Mesh } from "three";
import type { Model, Variant } from "./load.ts";
import { segmentAtTexture } from "./segments.ts";

/** A point of a surface, told by its triangle so that it goes along with the beat. */
export interface Anchor {
  mesh: Mesh;
  corners: readonly [number, number, number];
  /** Parts of the three corners. */
  parts: readonly [number, number, number];
}

/** What lies under a pointer. */
export interface Hit {
  anchor: Anchor;
  segment: number | null;
}

/** The frontmost visible point at normalised device coordinates. */
export function pick(model: Model, camera: Camera, x: number, y: number): Hit | null {
  const caster = new Raycaster();
  caster.setFromCamera(new Vector2(x, y), camera);
  const meshes = [...model.epicardial.meshes, ...model.endocardial.meshes].filter((mesh) => mesh.parent?.visible !== false && mesh.visible);
  const [first] = caster.intersectObjects(meshes, false);
  return first === undefined ? null : hitOf(first);
}

/** The value of a quantity at a point; null where there is none. */
export function valueAt(anchor: Anchor, variant: Variant, noValue: number): number | null {
  const values = anchor.mesh.geometry.getAttribute(variant.attribute);
  if (values === undefined) return null;
  const three = anchor.corners.map((corner) => values.getX(corner));
  if (three.some((value) => value <= noValue + 1)) return null;
  // A direction has no mean between 359 and 1: the nearest corner tells it.
  if (variant.range[1] === 360) return three[anchor.parts.indexOf(Math.max(...anchor.parts))] ?? null;
  return three.reduce((sum, value, corner) => sum + value * (anchor.parts[corner] ?? 0), 0);
}

/** Where the point is now, in the coordinates of the surfaces' node. */
export function positionOf(anchor: Anchor, into: Vector3): Vector3 {
  const corner = new Vector3();
  into.set(0, 0, 0);
  anchor.corners.forEach((vertex, index) => {
    anchor.mesh.getVertexPosition(vertex, corner);
    into.addScaledVector(corner, anchor.parts[index] ?? 0);
  });
  return into;
}

function hitOf(found: Intersection): Hit | null {
  const mesh = found.object as Mesh;
  const { face } = found;
  if (!face) return null;
  const [a, b, c] = [face.a, face.b, face.c].map((vertex) => mesh.getVertexPosition(vertex, new Vector3()));
  if (a === undefined || b === undefined || c === undefined) return null;
  const point = mesh.worldToLocal(found.point.clone());
  const parts = barycentric(point, a, b, c);
  return {
    anchor: { mesh, corners: [face.a, face.b, face.c], parts },
    segment: found.uv && mesh.geometry.hasAttribute("uv") ? segmentAtTexture(found.uv.x, found.uv.y) : null,
  };
}

function barycentric(point: Vector3, a: Vector3, b: Vector3, c: Vector3): [number, number, number] {
  const [ab, ac, ap] = [b.clone().sub(a), c.clone().sub(a), point.clone().sub(a)];
  const [d00, d01, d11, d20, d21] = [ab.dot(ab), ab.dot(ac), ac.dot(ac), ap.dot(ab), ap.dot(ac)];
  const area = d00 * d11 - d01 * d01;
  const v = (d11 * d20 - d01 * d21) / area;
  const w = (d00 * d21 - d01 * d20) / area;
  return [1 - v - w, v, w];
}
