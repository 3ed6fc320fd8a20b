import { BufferGeometry, Group, Line, LineBasicMaterial, Mesh, MeshBasicMaterial, SphereGeometry, Vector3, type Object3D } from "three";
import { positionOf, type Anchor } from "./pick.ts";

/** Two points on the surfaces and the line between them, which go along with the beat. */
export interface Measurement {
  /** Sets the next point; a third begins anew. */
  add(anchor: Anchor): void;
  clear(): void;
  /** Draws where the points are now. Distance in mm, null before there are two. */
  update(): number | null;
  points(): number;
}

const MARK_RADIUS_M = 0.0012;

/** A measurement drawn under this node, which is in metres. */
export function measurement(root: Object3D): Measurement {
  let anchors: Anchor[] = [];
  const paint = { color: 0xffd23f, depthTest: false, transparent: true };
  const marks = [0, 1].map(() => new Mesh(new SphereGeometry(MARK_RADIUS_M, 16, 12), new MeshBasicMaterial(paint)));
  const line = new Line(new BufferGeometry().setFromPoints([new Vector3(), new Vector3()]), new LineBasicMaterial(paint));
  const drawn = new Group();
  drawn.add(...marks, line);
  for (const part of [...marks, line]) [part.renderOrder, part.visible, part.frustumCulled] = [10, false, false];
  root.add(drawn);
  return {
    add(anchor) {
      anchors = anchors.length < 2 ? [...anchors, anchor] : [anchor];
    },
    clear() {
      anchors = [];
    },
    points: () => anchors.length,
    update() {
      const places = anchors.map((anchor) => positionOf(anchor, new Vector3()));
      marks.forEach((mark, index) => {
        const place = places[index];
        mark.visible = place !== undefined;
        if (place !== undefined) mark.position.copy(place);
      });
      const [from, to] = places;
      line.visible = from !== undefined && to !== undefined;
      if (from === undefined || to === undefined) return null;
      line.geometry.setFromPoints([from, to]);
      return from.distanceTo(to) * 1000;
    },
  };
}
