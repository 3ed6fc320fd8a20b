//! Surfaces as binary glTF 2.0: one file any viewer opens, beating over the R-R interval.
//!
//! A root node `ventricle` stands at the heart's place in the patient; under it the nodes `endocardial` (opaque) and `epicardial`
//! (translucent) hold one mesh each. The base mesh is gate 1, and there is one morph target a gate (the first is all zero, so that target
//! `n` is gate `n`), with weight 1 for the gate shown. One animation runs through the gates and back to the first. Colours can be chosen
//! ([`super::variants`]). `extras` say what glTF has no words for: units, frame, volumes, UIDs, what colours mean.

use super::{
    ExportError,
    buffer::{Arrays, container, single},
    frame::SceneFrame,
    variants::{self, NO_VALUE, Variants},
};
use crate::{
    analysis::Analysis,
    drawing::polar::NEUTRAL,
    mesh::Mesh,
    pipeline::{GateReconstruction, Reconstruction, Surface},
    study::Study,
};
use gltf_json::{
    Animation, Asset, Extras, Index, Material, Node, Root, Scene,
    accessor::Accessor,
    animation::{Channel, Interpolation, Property, Sampler, Target},
    extensions::{
        mesh::{KhrMaterialsVariants as Mappings, Mapping},
        root::KhrMaterialsVariants as Names,
        scene::khr_materials_variants::Variant,
    },
    extras::RawValue,
    material::{AlphaMode, PbrBaseColorFactor, PbrMetallicRoughness, StrengthFactor},
    mesh::{Mode, MorphTarget, Primitive, Semantic},
    texture::{Info, MagFilter, MinFilter, Sampler as TextureSampler, Texture, WrappingMode},
    validation::Checked,
};
use serde_json::{Value, json};
use std::collections::BTreeMap;

/// Both surfaces over the whole cycle; a still of both for a study of one gate.
pub fn cycle(study: &Study, reconstruction: &Reconstruction, analysis: &Analysis) -> Result<Vec<u8>, ExportError> {
    let frame = SceneFrame::of(study, reconstruction);
    let mut scene = SceneBuilder::new();
    let times = CycleTimes::of(study, reconstruction.gates.len());
    let keyframes = (reconstruction.gates.len() > 1).then(|| scene.push_keyframes(&times));
    let variants = Variants::of(reconstruction, analysis)?;
    let colours = scene.push_variants(&variants);
    let mut nodes = Vec::new();
    for surface in Surface::BOTH {
        nodes.push(scene.push_surface(&frame, surface, &reconstruction.gates, 1, Some((&variants, &colours)))?);
    }
    if let Some((input, output)) = keyframes {
        scene.animate(&nodes, input, output);
    }
    let mut extras = study_extras(study, &frame);
    extras["rr_interval_s"] = if reconstruction.gates.len() > 1 { json!(times.rr_interval_s) } else { Value::Null };
    extras["rr_interval_source"] = json!(times.source);
    extras["gates"] =
        (1..).zip(&reconstruction.gates).zip(&times.starts_s).map(|((number, gate), start)| gate_extras(number, gate, *start)).collect();
    let [anterior, septal, base] = analysis.places.axes.map(|axis| single(frame.direction(axis)));
    extras["walls"] = json!({ "anterior": anterior, "septal": septal, "base": base, "rotation": analysis.places.rotation });
    extras["variants"] = variants.legend();
    extras["no_value"] = json!(NO_VALUE);
    scene.finish(&frame, nodes, &extras)
}

/// One surface of one gate (counted from 0), standing still at the same place as in [`cycle`].
pub fn surface(study: &Study, reconstruction: &Reconstruction, gate: usize, surface: Surface) -> Result<Vec<u8>, ExportError> {
    let gates = reconstruction.gates.len();
    let shown = reconstruction.gates.get(gate).ok_or(ExportError::NoSuchGate { gate: gate + 1, gates })?;
    let frame = SceneFrame::of(study, reconstruction);
    let mut scene = SceneBuilder::new();
    let node = scene.push_surface(&frame, surface, std::slice::from_ref(shown), gate + 1, None)?;
    let mut extras = study_extras(study, &frame);
    extras["gate"] = json!(gate + 1);
    extras["surface"] = json!(surface.name());
    extras["volume_ml"] = json!(shown.volume_ml(surface));
    scene.finish(&frame, vec![node], &extras)
}

/// When each gate begins.
struct CycleTimes {
    starts_s: Vec<f64>,
    rr_interval_s: f64,
    source: &'static str,
}

impl CycleTimes {
    /// The gates' own durations, scaled to the R-R interval, or equal parts of it. The interval is the acquisition's, else the sum of the
    /// durations, else one second, which `source` then says.
    fn of(study: &Study, gates: usize) -> Self {
        let usable = |ms: &f64| ms.is_finite() && *ms > 0.0;
        let durations_ms: Option<Vec<f64>> = study.gates.iter().map(|gate| gate.duration_ms.filter(usable)).collect();
        let durations_ms = durations_ms.filter(|durations| durations.len() == gates);
        let (rr_interval_s, source) = match (study.acquisition.rr_interval_ms.filter(usable), &durations_ms) {
            (Some(ms), _) => (ms / 1000.0, "acquisition"),
            (None, Some(durations)) => (durations.iter().sum::<f64>() / 1000.0, "gate_durations"),
            (None, None) => (1.0, "assumed"),
        };
        let shares = durations_ms.unwrap_or_else(|| vec![1.0; gates]);
        let whole: f64 = shares.iter().sum();
        let mut passed = 0.0;
        let starts_s = shares
            .iter()
            .map(|share| {
                let start = rr_interval_s * passed / whole;
                passed += share;
                start
            })
            .collect();
        Self { starts_s, rr_interval_s, source }
    }
}

/// A glTF document in the making.
struct SceneBuilder {
    root: Root,
    arrays: Arrays,
}

impl SceneBuilder {
    fn new() -> Self {
        let generator = Some(format!("ventricle {}", env!("CARGO_PKG_VERSION")));
        Self { root: Root { asset: Asset { generator, ..Asset::default() }, ..Root::default() }, arrays: Arrays::default() }
    }

    /// A node with one surface at all the given gates, the first of which has this number; it is the base mesh.
    fn push_surface(
        &mut self,
        frame: &SceneFrame,
        surface: Surface,
        gates: &[GateReconstruction],
        first_number: usize,
        coloured: Option<(&Variants, &Colours)>,
    ) -> Result<Index<Node>, ExportError> {
        let mut placed = Vec::with_capacity(gates.len());
        for (gate, fit) in (first_number..).zip(gates.iter().map(|gate| gate.fits.get(surface))) {
            if !fit.mesh.positions.iter().all(|position| position.is_finite()) {
                return Err(ExportError::NotFinite { gate, surface });
            }
            let mesh = frame.mesh(&fit.mesh);
            placed.push(Placed { positions: mesh.positions.iter().copied().map(single).collect(), normals: unit_normals(&mesh), mesh });
        }
        let base = placed.first().ok_or(ExportError::Empty)?;
        for (gate, other) in (first_number..).zip(&placed) {
            if other.mesh.triangles != base.mesh.triangles || other.positions.len() != base.positions.len() {
                return Err(ExportError::Topology { gate, surface });
            }
        }
        if coloured.is_some_and(|(variants, _)| variants.places.len() != base.positions.len()) {
            return Err(ExportError::Topology { gate: first_number, surface });
        }
        let mut attributes = BTreeMap::from([
            (Checked::Valid(Semantic::Positions), self.arrays.push_vectors(&base.positions)),
            (Checked::Valid(Semantic::Normals), self.arrays.push_vectors(&base.normals)),
        ]);
        for (semantic, accessor) in coloured.iter().flat_map(|(_, colours)| &colours.attributes) {
            attributes.insert(Checked::Valid(semantic.clone()), *accessor);
        }
        let (wall, lid): (Vec<[u32; 3]>, Vec<[u32; 3]>) =
            base.mesh.triangles.iter().partition(|triangle| {
                !coloured.is_some_and(|(variants, _)| triangle.iter().all(|&vertex| variants.in_lid[vertex as usize]))
            });
        let parts: Vec<(Index<Accessor>, bool)> = [(wall, false), (lid, true)]
            .into_iter()
            .filter(|(triangles, _)| !triangles.is_empty())
            .map(|(triangles, is_lid)| (self.arrays.push_triangles(&triangles, base.positions.len()), is_lid))
            .collect();
        let targets: Option<Vec<MorphTarget>> = (placed.len() > 1).then(|| {
            let displaced = |from: &[[f32; 3]], to: &[[f32; 3]]| -> Vec<[f32; 3]> {
                from.iter().zip(to).map(|(from, to)| std::array::from_fn(|axis| to[axis] - from[axis])).collect()
            };
            placed
                .iter()
                .map(|gate| MorphTarget {
                    positions: Some(self.arrays.push_vectors(&displaced(&base.positions, &gate.positions))),
                    normals: Some(self.arrays.push_vectors(&displaced(&base.normals, &gate.normals))),
                    tangents: None,
                })
                .collect()
        });
        let weights = targets.as_ref().map(|targets| one_hot(0, targets.len()));
        // `targetNames` is where three.js, Blender and others look for the names of morph targets.
        let names: Vec<String> = (first_number..).take(placed.len()).map(|gate| format!("gate {gate}")).collect();
        let material = self.root.push(material(surface));
        let primitives = parts
            .into_iter()
            .map(|(indices, is_lid)| Primitive {
                // No material of the lid has a texture.
                attributes: attributes
                    .iter()
                    .filter(|(semantic, _)| !(is_lid && matches!(semantic, Checked::Valid(Semantic::TexCoords(_)))))
                    .map(|(semantic, accessor)| (semantic.clone(), *accessor))
                    .collect(),
                extensions: coloured.map(|(_, colours)| gltf_json::extensions::mesh::Primitive {
                    khr_materials_variants: Some(Mappings { mappings: colours.mappings(material, is_lid) }),
                }),
                extras: None,
                indices: Some(indices),
                material: Some(material),
                mode: Checked::Valid(Mode::Triangles),
                targets: targets.clone(),
            })
            .collect();
        let mesh = self.root.push(gltf_json::Mesh {
            extensions: None,
            extras: if weights.is_some() { extras(&json!({ "targetNames": names }))? } else { None },
            name: Some(surface.name().to_owned()),
            primitives,
            weights,
        });
        let volumes: Vec<f64> = gates.iter().map(|gate| gate.volume_ml(surface)).collect();
        let extras = extras(&json!({ "surface": surface.name(), "volumes_ml": volumes }))?;
        Ok(self.root.push(Node { mesh: Some(mesh), name: Some(surface.name().to_owned()), extras, ..Node::default() }))
    }

    /// The materials of the variants, and what every vertex carries for them, once for both surfaces.
    fn push_variants(&mut self, variants: &Variants) -> Colours {
        let sampler = self.root.push(TextureSampler {
            mag_filter: Some(Checked::Valid(MagFilter::Linear)),
            min_filter: Some(Checked::Valid(MinFilter::LinearMipmapLinear)),
            wrap_s: Checked::Valid(WrappingMode::ClampToEdge),
            wrap_t: Checked::Valid(WrappingMode::ClampToEdge),
            ..TextureSampler::default()
        });
        let mut attributes = vec![(Semantic::TexCoords(0), self.arrays.push_places(&variants.places))];
        let mut walls = Vec::with_capacity(variants.quantities.len());
        for coloured in &variants.quantities {
            let name = coloured.quantity.name();
            attributes
                .push((Semantic::Extras(variants::attribute(coloured.quantity).to_owned()), self.arrays.push_scalars(&coloured.values)));
            let source = self.arrays.push_image(name, coloured.texture.clone());
            let texture =
                self.root.push(Texture { name: Some(name.to_owned()), sampler: Some(sampler), source, extensions: None, extras: None });
            walls.push(self.root.push(opaque(name, [1.0; 4], Some(Info { index: texture, tex_coord: 0, extensions: None, extras: None }))));
        }
        // As the textures are around the disc: they are in sRGB, a factor is linear.
        let [r, g, b] = NEUTRAL.map(|part| ((part + 0.055) / 1.055).powf(2.4));
        let lid = self.root.push(opaque("valve plane", [r, g, b, 1.0], None));
        let variants = variants.names().map(|name| Variant { name: name.to_owned() }).collect();
        let extensions = self.root.extensions.get_or_insert_default();
        extensions.khr_materials_variants = Some(Names { variants });
        self.root.extensions_used.push("KHR_materials_variants".to_owned());
        Colours { attributes, walls, lid }
    }

    /// Times and weights: every gate at its start, and gate 1 again at the end of the interval.
    fn push_keyframes(&mut self, times: &CycleTimes) -> (Index<Accessor>, Index<Accessor>) {
        let gates = times.starts_s.len();
        let instants: Vec<f32> = times.starts_s.iter().chain([&times.rr_interval_s]).map(|&time| time as f32).collect();
        let weights: Vec<f32> = (0..=gates).flat_map(|frame| one_hot(frame % gates, gates)).collect();
        (self.arrays.push_keyframes(&instants), self.arrays.push_keyframes(&weights))
    }

    fn animate(&mut self, nodes: &[Index<Node>], input: Index<Accessor>, output: Index<Accessor>) {
        let sampler = Sampler { extensions: None, extras: None, input, interpolation: Checked::Valid(Interpolation::Linear), output };
        let channel = |&node: &Index<Node>| Channel {
            sampler: Index::new(0),
            target: Target { extensions: None, extras: None, node, path: Checked::Valid(Property::MorphTargetWeights) },
            extensions: None,
            extras: None,
        };
        self.root.push(Animation {
            extensions: None,
            extras: None,
            channels: nodes.iter().map(channel).collect(),
            name: Some("cycle".to_owned()),
            samplers: vec![sampler],
        });
    }

    fn finish(mut self, frame: &SceneFrame, children: Vec<Index<Node>>, scene_extras: &Value) -> Result<Vec<u8>, ExportError> {
        let root_node = self.root.push(Node {
            children: Some(children),
            name: Some("ventricle".to_owned()),
            translation: Some(single(frame.centre_m)),
            ..Node::default()
        });
        let scene = self.root.push(Scene {
            extensions: None,
            extras: extras(scene_extras)?,
            name: Some("ventricle".to_owned()),
            nodes: vec![root_node],
        });
        self.root.scene = Some(scene);
        let binary = self.arrays.finish(&mut self.root);
        container(self.root.to_vec()?, binary)
    }
}

/// The materials of the variants after the plain one, and the attributes that go with them.
struct Colours {
    attributes: Vec<(Semantic, Index<Accessor>)>,
    walls: Vec<Index<Material>>,
    lid: Index<Material>,
}

impl Colours {
    /// Which material a primitive has in each variant.
    fn mappings(&self, plain: Index<Material>, is_lid: bool) -> Vec<Mapping> {
        let first = Mapping { material: plain.value() as u32, variants: vec![0] };
        let coloured = 1..=self.walls.len() as u32;
        let rest = if is_lid {
            vec![Mapping { material: self.lid.value() as u32, variants: coloured.collect() }]
        } else {
            coloured.zip(&self.walls).map(|(variant, wall)| Mapping { material: wall.value() as u32, variants: vec![variant] }).collect()
        };
        std::iter::once(first).chain(rest).collect()
    }
}

/// A mesh as the file holds it.
struct Placed {
    mesh: Mesh,
    positions: Vec<[f32; 3]>,
    normals: Vec<[f32; 3]>,
}

fn unit_normals(mesh: &Mesh) -> Vec<[f32; 3]> {
    mesh.normals().into_iter().map(single).collect()
}

fn one_hot(hot: usize, length: usize) -> Vec<f32> {
    (0..length).map(|index| if index == hot { 1.0 } else { 0.0 }).collect()
}

/// A material that is not seen through.
fn opaque(name: &str, factor: [f32; 4], texture: Option<Info>) -> Material {
    Material {
        name: Some(name.to_owned()),
        pbr_metallic_roughness: PbrMetallicRoughness {
            base_color_factor: PbrBaseColorFactor(factor),
            base_color_texture: texture,
            metallic_factor: StrengthFactor(0.0),
            roughness_factor: StrengthFactor(0.8),
            ..PbrMetallicRoughness::default()
        },
        ..Material::default()
    }
}

/// Blood red inside, a pale translucent wall outside, neither of them metal.
fn material(surface: Surface) -> Material {
    let (colour, alpha_mode, double_sided) = match surface {
        Surface::Endocardial => ([0.72, 0.13, 0.11, 1.0], AlphaMode::Opaque, false),
        Surface::Epicardial => ([0.93, 0.80, 0.70, 0.35], AlphaMode::Blend, true),
    };
    Material {
        alpha_mode: Checked::Valid(alpha_mode),
        double_sided,
        name: Some(surface.name().to_owned()),
        pbr_metallic_roughness: PbrMetallicRoughness {
            base_color_factor: PbrBaseColorFactor(colour),
            metallic_factor: StrengthFactor(0.0),
            roughness_factor: StrengthFactor(0.6),
            ..PbrMetallicRoughness::default()
        },
        ..Material::default()
    }
}

fn study_extras(study: &Study, frame: &SceneFrame) -> Value {
    let said = &study.acquisition;
    json!({
        "units": "m",
        "frame": frame.name(),
        "axes": frame.axes(),
        "study_instance_uid": said.study_instance_uid,
        "series_instance_uid": said.series_instance_uid,
        "sop_instance_uids": said.sop_instance_uids,
    })
}

fn gate_extras(number: usize, gate: &GateReconstruction, start_s: f64) -> Value {
    json!({
        "gate": number,
        "start_s": start_s,
        "endocardial_ml": gate.volume_ml(Surface::Endocardial),
        "epicardial_ml": gate.volume_ml(Surface::Epicardial),
    })
}

fn extras(value: &Value) -> Result<Extras, serde_json::Error> {
    RawValue::from_string(value.to_string()).map(Some)
}
