import { type BufferGeometry, type Material, type Mesh, type MeshStandardMaterial, type Object3D, type Texture, Vector3 } from "three";
import { GLTFLoader } from "three/addons/loaders/GLTFLoader.js";
import type { Timing } from "../page/cycle.ts";

/** A quantity that colours the wall. */
export interface Variant {
  name: string;
  unit: string;
  /** Values at both ends of the colours. */
  range: readonly [number, number];
  /** The scale from low to high. */
  colours: readonly string[];
  /** Name of the vertex attribute with its values, as three.js has it. */
  attribute: string;
  /** The polar map, which the wall's texture coordinates lie in. */
  texture: Texture;
}

/** One surface: its wall and the lid of its valve plane share vertices and morph together. */
export interface Surface {
  meshes: readonly Mesh<BufferGeometry, Material | Material[]>[];
}

/** What `surfaces.glb` holds. */
export interface Model {
  root: Object3D;
  endocardial: Surface;
  epicardial: Surface;
  timing: Timing;
  variants: readonly Variant[];
  /** Stands where a vertex has no value. */
  noValue: number;
  /** Where the walls lie in the scene, and whether the scene is the patient's. */
  anterior: Vector3;
  septal: Vector3;
  base: Vector3;
  isPatient: boolean;
}

/** The surfaces' file, read. */
export async function readModel(file: ArrayBuffer): Promise<Model> {
  const gltf = await new GLTFLoader().parseAsync(file, "");
  const root = gltf.scene.getObjectByName("ventricle") ?? gltf.scene;
  // Named as the scene: the first is the scene itself, its child the ventricle.
  const holder = root.getObjectByName("endocardial")?.parent ?? root;
  const said = gltf.scene.userData as SceneExtras;
  const names = ((gltf.parser.json as GltfJson).extensions?.KHR_materials_variants?.variants ?? []).map((variant) => variant.name);
  const variants: Variant[] = [];
  for (const told of said.variants ?? []) {
    const material = materialOf(gltf.parser.json as GltfJson, names.indexOf(told.variant));
    if (material === null) continue;
    const loaded = (await gltf.parser.getDependency("material", material)) as MeshStandardMaterial;
    if (loaded.map === null) continue;
    const { unit, range, colours } = told;
    variants.push({ name: told.variant, unit, range, colours, attribute: told.attribute.toLowerCase(), texture: loaded.map });
  }
  const vector = (numbers: readonly number[] | undefined, otherwise: Vector3) => (numbers ? new Vector3(...numbers) : otherwise);
  return {
    root: holder,
    endocardial: surfaceOf(holder, "endocardial"),
    epicardial: surfaceOf(holder, "epicardial"),
    timing: { startsS: said.gates.map((gate) => gate.start_s), rrIntervalS: said.rr_interval_s ?? 1 },
    variants,
    noValue: said.no_value ?? -9999,
    anterior: vector(said.walls?.anterior, new Vector3(0, 0, 1)),
    septal: vector(said.walls?.septal, new Vector3(-1, 0, 0)),
    base: vector(said.walls?.base, new Vector3(0, 1, 0)),
    isPatient: said.frame === "patient",
  };
}

interface SceneExtras {
  frame: string;
  gates: { gate: number; start_s: number }[];
  rr_interval_s: number | null;
  variants?: { variant: string; unit: string; range: [number, number]; colours: string[]; attribute: string }[];
  walls?: { anterior: number[]; septal: number[]; base: number[] };
  no_value?: number;
}

interface GltfJson {
  extensions?: { KHR_materials_variants?: { variants: { name: string }[] } };
  meshes?: { primitives: { extensions?: { KHR_materials_variants?: { mappings: { material: number; variants: number[] }[] } } }[] }[];
}

/** The material of the wall, the first primitive, in a variant. */
function materialOf(json: GltfJson, variant: number): number | null {
  const mappings = json.meshes?.[0]?.primitives[0]?.extensions?.KHR_materials_variants?.mappings ?? [];
  return mappings.find((mapping) => mapping.variants.includes(variant))?.material ?? null;
}

function surfaceOf(root: Object3D, name: string): Surface {
  const node = root.getObjectByName(name);
  if (node === undefined) throw new Error(`The surfaces' file has no ${name} surface.`);
  const meshes: Mesh<BufferGeometry, Material | Material[]>[] = [];
  node.traverse((object) => {
    if ((object as Mesh).isMesh) meshes.push(object as Mesh<BufferGeometry, Material | Material[]>);
  });
  return { meshes };
}
