import { Color, DoubleSide, FrontSide, MeshLambertMaterial, type IUniform } from "three";
import type { Model, Variant } from "./load.ts";
import { DISC_RADIUS } from "./segments.ts";

/** Paint of both surfaces, which can be changed while it is shown. */
export interface Paint {
  /** Colours by a quantity; null is plain. */
  colour(variant: Variant | null): void;
  /** Whether the outer surface is seen through. */
  seeThrough(translucent: boolean): void;
  /** Lifts a segment out of the rest; null none. */
  highlight(segment: number | null): void;
}

/** Plain colours: blood red inside, a pale wall outside; grey where there is no wall. */
const ENDOCARDIAL = new Color(0xb3261e);
const EPICARDIAL = new Color(0xe9cdb6);
const LID = new Color(0x8d969e);
/** How much of the pale outer surface is seen when it is translucent. */
const TRANSLUCENT = 0.3;
/** Part of a map's colour that light does not change, so that it can be compared with the legend. */
const OWN_LIGHT = 0.62;

/** Paints the model. */
export function paint(model: Model): Paint {
  const chosen: IUniform<number> = { value: 0 };
  const walls = { endocardial: wallMaterial(chosen), epicardial: wallMaterial(chosen) };
  const lids = { endocardial: new MeshLambertMaterial({ color: LID }), epicardial: new MeshLambertMaterial({ color: LID }) };
  for (const name of ["endocardial", "epicardial"] as const) {
    model[name].meshes.forEach((mesh) => {
      mesh.material = mesh.geometry.hasAttribute("uv") ? walls[name] : lids[name];
      mesh.renderOrder = name === "endocardial" ? 0 : 1;
      mesh.frustumCulled = false;
    });
  }
  const paint: Paint = {
    colour(variant) {
      for (const [name, plain] of [["endocardial", ENDOCARDIAL], ["epicardial", EPICARDIAL]] as const) {
        const wall = walls[name];
        wall.map = variant?.texture ?? null;
        wall.emissiveMap = wall.map;
        wall.color.copy(variant === null ? plain : new Color(1 - OWN_LIGHT, 1 - OWN_LIGHT, 1 - OWN_LIGHT));
        wall.emissive.setScalar(variant === null ? 0 : OWN_LIGHT);
        wall.needsUpdate = true;
        lids[name].color.copy(variant === null ? plain : LID);
      }
    },
    seeThrough(translucent) {
      for (const material of [walls.epicardial, lids.epicardial]) {
        material.transparent = translucent;
        material.opacity = translucent ? TRANSLUCENT : 1;
        material.depthWrite = !translucent;
        material.side = translucent ? DoubleSide : FrontSide;
        material.needsUpdate = true;
      }
    },
    highlight(segment) {
      chosen.value = segment ?? 0;
    },
  };
  paint.colour(null);
  paint.seeThrough(true);
  return paint;
}

/** The segment is told for each pixel from its place in the polar map, so that its borders are sharp however coarse the mesh is. */
function wallMaterial(chosen: IUniform<number>): MeshLambertMaterial {
  const material = new MeshLambertMaterial();
  material.onBeforeCompile = (shader) => {
    shader.uniforms["chosenSegment"] = chosen;
    shader.vertexShader = shader.vertexShader
      .replace("#include <common>", "#include <common>\nvarying vec2 vPolar;")
      .replace("#include <uv_vertex>", "#include <uv_vertex>\nvPolar = uv;");
    shader.fragmentShader = shader.fragmentShader
      .replace("#include <common>", `#include <common>\nvarying vec2 vPolar;\nuniform float chosenSegment;\n${SEGMENT_OF}`)
      .replace("#include <opaque_fragment>", `${LIFT}\n#include <opaque_fragment>`);
  };
  return material;
}

const SEGMENT_OF = `
float segmentOf(vec2 place) {
  vec2 from = (place - 0.5) / ${DISC_RADIUS};
  float radius = length(from);
  if (radius > 1.03) return -1.0;
  if (radius < 0.25) return 17.0;
  float turn = degrees(atan(-from.x, -from.y));
  if (turn < 0.0) turn += 360.0;
  if (radius < 0.5) return 13.0 + mod(floor(turn / 90.0 + 0.5), 4.0);
  return (radius < 0.75 ? 7.0 : 1.0) + mod(floor(turn / 60.0 + 0.5), 6.0);
}`;

const LIFT = `
if (chosenSegment > 0.5) {
  if (abs(segmentOf(vPolar) - chosenSegment) < 0.5) {
    outgoingLight = mix(outgoingLight, vec3(1.0), 0.28);
    diffuseColor.a = max(diffuseColor.a, 0.85);
  } else {
    outgoingLight *= 0.55;
  }
}`;
