//! The glTF files: read back, measured, and checked by the Khronos validator.

use glam::DVec3;
use gltf::{Glb, Gltf, Semantic, accessor::Accessor, mesh::util::ReadIndices};
use ndarray::Array3;
use serde_json::Value;
use std::{path::Path, process::Command};
use ventricle::{
    analysis::analyse,
    drawing::scale::Scale,
    export::{
        ExportError, glb,
        stored::{StoredCycle, StoredSurface},
        variants,
    },
    mesh::Mesh,
    pipeline::{
        Evolution, Fit, GateReconstruction, PerSurface, Reconstruction, Region, Surface, parameters::Parameters, rest::Stop,
        wall::WallOrder,
    },
    report,
    study::{Acquisition, Format, Gate, Orientation, Study},
    volume::{Grid, Volume},
};

/// A bright wall between two ellipsoids that beat: endocardial axes shrink by a third and back, the wall keeps its volume.
pub(crate) fn beating(gates: usize, level: u32, orientation: Option<Orientation>) -> (Study, Reconstruction) {
    let grid = Grid { shape: [36, 36, 36], spacing_mm: [5.0; 3] };
    let mut acquisition = Acquisition::unknown(Format::Phantom);
    acquisition.study_instance_uid = Some("2.25.1".to_owned());
    acquisition.rr_interval_ms = Some(800.0);
    let centre = DVec3::new(90.0, 80.0, 90.0);
    // Semi-axes of the cavity and of the whole at a gate.
    let axes = |gate: usize| {
        let phase = std::f64::consts::TAU * gate as f64 / gates as f64;
        let inner = DVec3::new(24.0, 25.0, 45.0) * (1.0 - (1.0 - phase.cos()) / 6.0);
        (inner, inner * (1.0 + 60_000.0 / inner.element_product()).cbrt())
    };
    let gate = |gate: usize| {
        let (inner, outer) = axes(gate);
        // From 5 to 100 over the width of a voxel, so that it does not matter much how the grid lies.
        let inside = |point: DVec3, axes: DVec3| 0.5 + (1.0 - ((point - centre) / axes).length()) * axes.x / grid.spacing_mm[0];
        let bright = |point: DVec3| inside(point, outer).clamp(0.0, 1.0) - inside(point, inner).clamp(0.0, 1.0);
        let counts = Array3::from_shape_fn(grid.shape, |(z, y, x)| 5.0 + 95.0 * bright(grid.position_mm([z, y, x])) as f32);
        Gate { volume: Volume { grid, counts }, duration_ms: Some(800.0 / gates as f64) }
    };
    let study = Study { grid, gates: (0..gates).map(gate).collect(), orientation, acquisition, warnings: Vec::new() };
    let sphere = Mesh::icosphere(level);
    let fit = |axes: DVec3| Fit {
        mesh: sphere.map(|point| centre + axes * point),
        steps: 100,
        evolution: Some(Evolution {
            frozen: 1.0,
            within_one_voxel: 0.97,
            mean_distance_mm: 1.5,
            gvf_residual: [1e-5; 3],
            gvf_iterations: [150; 3],
            stop: Stop::AllFrozen,
            trace: None,
        }),
    };
    let gates = (0..gates)
        .map(|index| {
            let (inner, outer) = axes(index);
            GateReconstruction { fits: PerSurface { endocardial: fit(inner), epicardial: fit(outer) }, wall_order: WallOrder::default() }
        })
        .collect();
    let region =
        Region { centre_mm: [90.0, 80.0], axis_slope: [0.0; 2], radius_mm: 60.0, first_slice: 1, last_slice: 4, base_at_last_slice: true };
    let reconstruction = Reconstruction {
        gates,
        region: Some(region),
        to_base: DVec3::Z,
        pose: None,
        model: None,
        parameters: Parameters::paper(),
        warnings: Vec::new(),
    };
    (study, reconstruction)
}

/// The surfaces over the cycle, with the colours of their own analysis.
fn cycle(study: &Study, reconstruction: &Reconstruction) -> Result<Vec<u8>, ExportError> {
    let whole = beating(reconstruction.gates.len().max(1), 2, study.orientation);
    // What cannot be drawn cannot be analysed either: then the analysis is another's.
    let sound = reconstruction.gates.iter().all(|gate| {
        let vertices = |surface| gate.fits.get(surface).mesh.positions.len();
        vertices(Surface::Endocardial) == vertices(Surface::Epicardial)
            && Surface::BOTH.iter().all(|&surface| gate.fits.get(surface).mesh.positions.iter().all(|position| position.is_finite()))
    });
    let analysis = if sound && !reconstruction.gates.is_empty() { analyse(study, reconstruction) } else { analyse(&whole.0, &whole.1) };
    glb::cycle(study, reconstruction, &analysis)
}

/// An oblique short-axis frame of either handedness.
pub(crate) fn oblique(mirrored: bool) -> Orientation {
    let columns = DVec3::new(0.6, 0.8, 0.0);
    let rows = DVec3::new(0.0, 0.0, -1.0);
    let slices = columns.cross(rows) * if mirrored { -1.0 } else { 1.0 };
    Orientation { columns, rows, slices, origin_mm: DVec3::new(-40.0, -120.0, 250.0) }
}

/// A file opened by the `gltf` crate, with its binary chunk.
struct Opened {
    document: Gltf,
    binary: Vec<u8>,
}

impl Opened {
    fn new(bytes: &[u8]) -> Self {
        let binary = Glb::from_slice(bytes).unwrap().bin.unwrap().into_owned();
        Self { document: Gltf::from_slice(bytes).unwrap(), binary }
    }

    fn node(&self, name: &str) -> gltf::Node<'_> {
        self.document.nodes().find(|node| node.name() == Some(name)).unwrap()
    }

    fn floats(&self, accessor: &Accessor<'_>) -> Vec<f32> {
        let view = accessor.view().unwrap();
        let start = view.offset() + accessor.offset();
        let bytes = &self.binary[start..start + accessor.count() * accessor.size()];
        bytes.chunks_exact(4).map(|bytes| f32::from_le_bytes(bytes.try_into().unwrap())).collect()
    }

    fn vectors(&self, accessor: &Accessor<'_>) -> Vec<DVec3> {
        let vector = |v: &[f32]| DVec3::new(f64::from(v[0]), f64::from(v[1]), f64::from(v[2]));
        self.floats(accessor).chunks_exact(3).map(vector).collect()
    }

    /// The mesh of a node with the weights a player would set, in m, about the root node.
    fn mesh(&self, name: &str, weights: &[f32]) -> Mesh {
        let mesh = self.node(name).mesh().unwrap();
        let primitive = mesh.primitives().next().unwrap();
        let mut positions = self.vectors(&primitive.get(&Semantic::Positions).unwrap());
        for (target, &weight) in primitive.morph_targets().zip(weights) {
            for (position, displacement) in positions.iter_mut().zip(self.vectors(&target.positions().unwrap())) {
                *position += displacement * f64::from(weight);
            }
        }
        // The wall and the lid of the valve plane.
        let indices: Vec<u32> = mesh.primitives().flat_map(|primitive| self.indices(&primitive)).collect();
        Mesh { positions, triangles: indices.chunks_exact(3).map(|t| [t[0], t[1], t[2]]).collect() }
    }

    fn indices(&self, primitive: &gltf::Primitive<'_>) -> Vec<u32> {
        match primitive.reader(|_| Some(&self.binary)).read_indices().unwrap() {
            ReadIndices::U16(indices) => indices.map(u32::from).collect(),
            ReadIndices::U32(indices) => indices.collect(),
            ReadIndices::U8(_) => panic!("8-bit indices"),
        }
    }

    /// Red, green and blue of the texture of this name.
    fn picture(&self, name: &str) -> Vec<u8> {
        let image = self.document.images().find(|image| image.name() == Some(name)).unwrap();
        let gltf::image::Source::View { view, mime_type: "image/png" } = image.source() else { panic!("{name} is no PNG within the file") };
        let mut decoder = png::Decoder::new(std::io::Cursor::new(&self.binary[view.offset()..view.offset() + view.length()]));
        decoder.set_transformations(png::Transformations::EXPAND);
        let mut reader = decoder.read_info().unwrap();
        let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
        let info = reader.next_frame(&mut pixels).unwrap();
        assert_eq!((info.width, info.height, info.color_type), (256, 256, png::ColorType::Rgb));
        pixels
    }

    fn extras(&self) -> Value {
        serde_json::from_str(self.document.default_scene().unwrap().extras().as_ref().unwrap().get()).unwrap()
    }
}

fn one_hot(hot: usize, length: usize) -> Vec<f32> {
    (0..length).map(|index| f32::from(u8::from(index == hot))).collect()
}

fn relative(a: f64, b: f64) -> f64 {
    (a / b - 1.0).abs()
}

#[test]
fn every_morph_target_has_the_volume_of_its_gate_in_the_report() {
    for orientation in [None, Some(oblique(false)), Some(oblique(true))] {
        let (study, reconstruction) = beating(8, 3, orientation);
        let report = report::build("x", &study, &reconstruction, &analyse(&study, &reconstruction), &report::Timing::default());
        let file = cycle(&study, &reconstruction).unwrap();
        let opened = Opened::new(&file);
        for gate in &report.gates {
            for (name, volume_ml) in [("endocardial", gate.endocardial_ml), ("epicardial", gate.epicardial_ml)] {
                let mesh = opened.mesh(name, &one_hot(gate.gate - 1, 8));
                assert!(mesh.is_closed());
                // Positive only when the triangles face outward; m³ to ml.
                let read_ml = mesh.signed_volume_mm3() * 1e6;
                assert!(relative(read_ml, volume_ml) < 1e-4, "gate {} {name}: {read_ml} for {volume_ml}", gate.gate);
                assert_eq!(mesh.inverted_triangles(mesh.centroid()), 0);
            }
            let told = &opened.extras()["gates"][gate.gate - 1];
            // serde_json reads the last bit of a number only approximately.
            assert!(relative(told["endocardial_ml"].as_f64().unwrap(), gate.endocardial_ml) < 1e-15);
            assert!(relative(told["epicardial_ml"].as_f64().unwrap(), gate.epicardial_ml) < 1e-15);
        }
    }
}

#[test]
fn vertices_stand_where_the_patient_has_them() {
    let orientation = oblique(true);
    let (study, reconstruction) = beating(8, 2, Some(orientation));
    let file = cycle(&study, &reconstruction).unwrap();
    let opened = Opened::new(&file);
    let (translation, ..) = opened.node("ventricle").transform().decomposed();
    let at = DVec3::from_array(translation.map(f64::from));
    for (gate, expected) in reconstruction.gates.iter().enumerate() {
        let shown = opened.mesh("epicardial", &one_hot(gate, 8));
        for (position, grid_mm) in shown.positions.iter().zip(&expected.fits.epicardial.mesh.positions) {
            let patient = orientation.patient_mm(*grid_mm);
            let scene = DVec3::new(patient.x, patient.z, -patient.y) / 1000.0;
            assert!((*position + at).distance(scene) < 1e-6);
        }
    }
    // Near its own origin, so that a viewer that ignores the root still frames it.
    let base = opened.mesh("epicardial", &one_hot(0, 8));
    assert!(base.positions.iter().all(|position| position.length() < 0.1));
    assert_eq!(opened.extras()["frame"], "patient");
    assert_eq!(opened.extras()["study_instance_uid"], "2.25.1");
}

#[test]
fn the_cycle_plays_the_gates_at_their_times_and_returns_to_the_first() {
    let (mut study, reconstruction) = beating(8, 2, None);
    let durations = [50.0, 150.0, 100.0, 100.0, 100.0, 100.0, 100.0, 100.0];
    for (gate, duration) in study.gates.iter_mut().zip(durations) {
        gate.duration_ms = Some(duration);
    }
    for (rr_interval_ms, end_s) in [(Some(800.0), 0.8), (Some(1000.0), 1.0), (None, 0.8)] {
        study.acquisition.rr_interval_ms = rr_interval_ms;
        let opened = Opened::new(&cycle(&study, &reconstruction).unwrap());
        let animations: Vec<_> = opened.document.animations().collect();
        assert_eq!(animations.len(), 1);
        let channels: Vec<_> = animations[0].channels().collect();
        let targets: Vec<_> = channels.iter().map(|channel| channel.target().node().name().unwrap()).collect();
        assert_eq!(targets, ["endocardial", "epicardial"]);
        for channel in &channels {
            assert_eq!(channel.target().property(), gltf::animation::Property::MorphTargetWeights);
            assert_eq!(channel.sampler().interpolation(), gltf::animation::Interpolation::Linear);
            let times = opened.floats(&channel.sampler().input());
            let mut expected = vec![0.0];
            for duration in durations {
                expected.push(expected.last().unwrap() + duration / 800.0 * end_s);
            }
            assert_eq!(times.len(), 9);
            for (time, expected) in times.iter().zip(expected) {
                assert!((f64::from(*time) - expected).abs() < 1e-6, "{times:?}");
            }
            let weights = opened.floats(&channel.sampler().output());
            let expected: Vec<f32> = [0, 1, 2, 3, 4, 5, 6, 7, 0].into_iter().flat_map(|gate| one_hot(gate, 8)).collect();
            assert_eq!(weights, expected);
        }
        assert_eq!(opened.extras()["rr_interval_s"], end_s);
    }
    for gate in &mut study.gates {
        gate.duration_ms = None;
    }
    let extras = Opened::new(&cycle(&study, &reconstruction).unwrap()).extras();
    assert_eq!((&extras["rr_interval_s"], &extras["rr_interval_source"]), (&1.0.into(), &"assumed".into()));
}

#[test]
fn normals_are_unit_and_outward_at_every_gate() {
    let (study, reconstruction) = beating(4, 3, Some(oblique(true)));
    let opened = Opened::new(&cycle(&study, &reconstruction).unwrap());
    for name in ["endocardial", "epicardial"] {
        let mesh = opened.node(name).mesh().unwrap();
        let primitive = mesh.primitives().next().unwrap();
        let base = opened.vectors(&primitive.get(&Semantic::Normals).unwrap());
        for (gate, target) in primitive.morph_targets().enumerate() {
            let shown = opened.mesh(name, &one_hot(gate, 4));
            let centre = shown.centroid();
            for ((normal, change), position) in base.iter().zip(opened.vectors(&target.normals().unwrap())).zip(&shown.positions) {
                let normal = *normal + change;
                assert!((normal.length() - 1.0).abs() < 1e-5);
                assert!(normal.dot(*position - centre) > 0.0);
            }
        }
    }
}

#[test]
fn an_ungated_study_stands_still_and_one_surface_comes_alone() {
    let (study, reconstruction) = beating(1, 3, None);
    let opened = Opened::new(&cycle(&study, &reconstruction).unwrap());
    assert_eq!(opened.document.animations().count(), 0);
    assert!(opened.document.meshes().all(|mesh| mesh.weights().is_none() && mesh.primitives().all(|p| p.morph_targets().count() == 0)));
    assert_eq!(opened.extras()["frame"], "grid");

    let (study, reconstruction) = beating(8, 3, None);
    let opened = Opened::new(&glb::surface(&study, &reconstruction, 4, Surface::Epicardial).unwrap());
    assert_eq!(opened.document.meshes().count(), 1);
    let volume_ml = opened.mesh("epicardial", &[]).signed_volume_mm3() * 1e6;
    assert!(relative(volume_ml, reconstruction.gates[4].volume_ml(Surface::Epicardial)) < 1e-4);
    assert_eq!(opened.extras()["gate"], 5);
    assert!(matches!(glb::surface(&study, &reconstruction, 8, Surface::Epicardial), Err(ExportError::NoSuchGate { gate: 9, gates: 8 })));
}

#[test]
fn what_cannot_be_drawn_is_refused_by_gate_and_surface() {
    let (study, mut reconstruction) = beating(3, 2, None);
    reconstruction.gates[1].fits.epicardial.mesh = Mesh::icosphere(1);
    let refused = cycle(&study, &reconstruction);
    assert!(matches!(refused, Err(ExportError::Topology { gate: 2, surface: Surface::Epicardial })), "{refused:?}");
    let (study, mut reconstruction) = beating(3, 2, None);
    reconstruction.gates[2].fits.endocardial.mesh.positions[7].y = f64::NAN;
    let refused = cycle(&study, &reconstruction);
    assert!(matches!(refused, Err(ExportError::NotFinite { gate: 3, surface: Surface::Endocardial })), "{refused:?}");
    reconstruction.gates.clear();
    assert!(matches!(cycle(&study, &reconstruction), Err(ExportError::Empty)));
}

#[test]
fn every_variant_colours_the_wall_with_its_map_and_leaves_the_lid() {
    let (mut study, reconstruction) = beating(8, 3, Some(oblique(false)));
    study.gates.iter_mut().for_each(|gate| gate.volume.counts.fill(0.0));
    let analysis = analyse(&study, &reconstruction);
    let bytes = glb::cycle(&study, &reconstruction, &analysis).unwrap();
    let json: Value = serde_json::from_slice(&Glb::from_slice(&bytes).unwrap().json).unwrap();
    assert_eq!(json["extensionsUsed"], serde_json::json!(["KHR_materials_variants"]));
    assert!(json["extensionsRequired"].is_null(), "a viewer without the extension shows it plain");
    let names: Vec<&str> =
        json["extensions"]["KHR_materials_variants"]["variants"].as_array().unwrap().iter().map(|v| v["name"].as_str().unwrap()).collect();
    // Without counts there is no phase.
    assert_eq!(names, ["plain", "perfusion", "end_diastolic_thickness", "end_systolic_thickness", "thickening", "motion"]);
    let opened = Opened::new(&bytes);
    let extras = opened.extras();
    let legend = extras["variants"].as_array().unwrap();
    assert_eq!(legend.len(), 5);
    for name in ["endocardial", "epicardial"] {
        let mesh = json["meshes"].as_array().unwrap().iter().find(|mesh| mesh["name"] == name).unwrap();
        let primitives = mesh["primitives"].as_array().unwrap();
        assert_eq!(primitives.len(), 2, "the wall and the lid");
        for (primitive, textured) in primitives.iter().zip([true, false]) {
            let material = |index: &Value| &json["materials"][usize::try_from(index.as_u64().unwrap()).unwrap()];
            assert_eq!(material(&primitive["material"])["name"], name, "plain without a choice");
            let mut mapped = Vec::new();
            for mapping in primitive["extensions"]["KHR_materials_variants"]["mappings"].as_array().unwrap() {
                let has_texture = !material(&mapping["material"])["pbrMetallicRoughness"]["baseColorTexture"].is_null();
                for variant in mapping["variants"].as_array().unwrap() {
                    assert_eq!(has_texture, textured && variant != 0);
                    mapped.push(variant.as_u64().unwrap());
                }
            }
            mapped.sort_unstable();
            assert_eq!(mapped, [0, 1, 2, 3, 4, 5]);
        }
    }
    // A vertex carries its value, and its texture has the value's colour where the vertex lies in it.
    let mesh = opened.node("epicardial").mesh().unwrap();
    let primitive = mesh.primitives().next().unwrap();
    let places = opened.floats(&primitive.get(&Semantic::TexCoords(0)).unwrap());
    let lid_only = opened.indices(&mesh.primitives().nth(1).unwrap());
    let (mut compared, mut close) = (0, 0);
    for (entry, values) in [
        (&legend[1], &analysis.walls.thickness_mm[analysis.end_diastole]),
        (&legend[3], &analysis.walls.thickening_percent),
        (&legend[4], &analysis.walls.motion_mm),
    ] {
        let attribute = entry["attribute"].as_str().unwrap();
        let carried = opened.floats(&primitive.get(&Semantic::Extras(attribute.trim_start_matches('_').to_owned())).unwrap());
        let texture = opened.picture(entry["variant"].as_str().unwrap());
        let range: Vec<f64> = entry["range"].as_array().unwrap().iter().map(|end| end.as_f64().unwrap()).collect();
        let scale = Scale::named(entry["colour_scale"].as_str().unwrap()).unwrap();
        for (vertex, value) in values.iter().enumerate() {
            let [u, v] = [places[2 * vertex], places[2 * vertex + 1]];
            let radius = (u - 0.5).hypot(v - 0.5) / 0.44;
            let Some(value) = value else {
                assert!(radius > 1.05 && (carried[vertex] - variants::NO_VALUE).abs() < f32::EPSILON, "the lid is outside of the disc");
                continue;
            };
            assert!(radius < 1.001 && (f64::from(carried[vertex]) - value).abs() < 1e-4);
            assert!(!lid_only.contains(&u32::try_from(vertex).unwrap()), "a vertex of the wall is a corner of the lid's triangles");
            let at = |part: f32| ((f64::from(part) * 256.0) as usize).min(255);
            let shown = &texture[3 * (at(v) * 256 + at(u))..][..3];
            let colour = |value: f64| scale.colour((value - range[0]) / (range[1] - range[0])).map(|part| f64::from(part) * 255.0);
            let apart =
                |expected: [f64; 3]| shown.iter().zip(expected).map(|(&byte, part)| (f64::from(byte) - part).abs()).fold(0.0, f64::max);
            // A cell of the map is a mean over its surroundings: off by a twentieth of the range at most, by an eighth where the value is steep.
            // What is beyond the range has its end's colour.
            let value = value.clamp(range[0], range[1]);
            let nearest = |most: i32| {
                let within = (-most..=most).map(|step| value + f64::from(step) / 200.0 * (range[1] - range[0]));
                within.map(|value| apart(colour(value))).fold(f64::INFINITY, f64::min)
            };
            assert!(nearest(25) < 3.0, "{attribute} at {vertex}: {value} is shown as {shown:?}, {} off", nearest(25));
            close += usize::from(nearest(10) < 3.0);
            compared += 1;
        }
    }
    assert!(compared > 1200 && 100 * close >= 97 * compared, "{close} of {compared}");
}

#[test]
fn the_stored_file_is_read_back_as_it_was_written() {
    for orientation in [None, Some(oblique(true))] {
        let (study, reconstruction) = beating(8, 3, orientation);
        let analysis = analyse(&study, &reconstruction);
        let bytes = glb::cycle(&study, &reconstruction, &analysis).unwrap();
        let stored = StoredCycle::open(&bytes).unwrap();
        assert_eq!(stored.in_patient_frame(), orientation.is_some());
        let walls = stored.walls().unwrap();
        let [anterior, septal, base] = [walls.anterior, walls.septal, walls.base].map(DVec3::from_array);
        assert!([anterior, septal, base].iter().all(|axis| (axis.length() - 1.0).abs() < 1e-6));
        if orientation.is_some() {
            assert!(anterior.cross(base).dot(septal) > 0.999, "as in a patient: {anterior} {septal} {base}");
        }
        for gate in [1, 5, 8] {
            for surface in Surface::BOTH {
                let StoredSurface { points, normals, triangles } = stored.surface(surface, gate).unwrap();
                let mesh = Mesh { positions: points, triangles: triangles.into() };
                let volume_ml = reconstruction.gates[gate - 1].volume_ml(surface);
                assert!(mesh.is_closed() && relative(mesh.signed_volume_mm3() * 1e6, volume_ml) < 1e-4);
                assert!(normals.iter().all(|normal| (normal.length() - 1.0).abs() < 1e-5));
            }
        }
        assert!(matches!(stored.surface(Surface::Endocardial, 9), Err(ExportError::NotOurs { what: "gate" })));
        assert!(stored.surface(Surface::Endocardial, 0).is_err());
        let one = glb::surface(&study, &reconstruction, 0, Surface::Endocardial).unwrap();
        assert!(StoredCycle::open(&one).unwrap().surface(Surface::Epicardial, 1).is_err());
    }
    assert!(StoredCycle::open(b"glTF").is_err());
}

#[test]
fn eight_gates_of_642_vertices_stay_under_a_megabyte_and_a_half() {
    let (study, reconstruction) = beating(8, 3, Some(oblique(false)));
    let bytes = cycle(&study, &reconstruction).unwrap().len();
    println!("8 gates of 642 vertices: {bytes} bytes");
    assert!(bytes < 1_500_000, "{bytes}");
}

#[test]
fn the_khronos_validator_finds_neither_errors_nor_warnings() {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("surfaces");
    std::fs::create_dir_all(&folder).unwrap();
    let mut files = Vec::new();
    let mut keep = |name: &str, bytes: Vec<u8>| {
        let path = folder.join(format!("{name}.glb"));
        std::fs::write(&path, bytes).unwrap();
        files.push(path);
    };
    for (name, gates, level, orientation) in [
        ("grid", 8, 3, None),
        ("patient", 8, 3, Some(oblique(false))),
        ("mirrored-16", 16, 2, Some(oblique(true))),
        ("level-4", 8, 4, None),
        ("one-gate", 1, 3, None),
    ] {
        let (study, reconstruction) = beating(gates, level, orientation);
        keep(name, cycle(&study, &reconstruction).unwrap());
        keep(&format!("{name}-inner"), glb::surface(&study, &reconstruction, 0, Surface::Endocardial).unwrap());
    }
    let mut command = Command::new("node");
    command.arg(concat!(env!("CARGO_MANIFEST_DIR"), "/tests/tools/validate-gltf.mjs")).args(&files);
    let output = match command.output() {
        Ok(output) if output.status.code() != Some(2) => output,
        unavailable => {
            let why = unavailable.map_or_else(|error| error.to_string(), |output| String::from_utf8_lossy(&output.stderr).into_owned());
            #[expect(clippy::disallowed_methods, reason = "a test may ask whether it runs in CI")]
            let in_ci = std::env::var_os("CI").is_some();
            assert!(!in_ci, "the glTF validator must run: {why}");
            eprintln!("skipped: node or gltf-validator is absent ({})", why.trim());
            return;
        }
    };
    let found = String::from_utf8_lossy(&output.stdout);
    assert!(output.status.success(), "{found}{}", String::from_utf8_lossy(&output.stderr));
    let lines: Vec<Value> = found.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    assert_eq!(lines.len(), files.len());
    for line in lines {
        let found = ["errors", "warnings", "infos", "hints"].map(|kind| line[kind].as_u64().unwrap());
        assert_eq!(found, [0; 4], "{line}");
    }
}
