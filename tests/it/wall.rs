//! The wall as tetrahedra: in order in every reconstruction, and as a VTK file that says what the report says.

use crate::{
    served::{Directory, Served},
    shared,
    surfaces::{beating, oblique},
};
use base64::{Engine as _, engine::general_purpose::STANDARD};
use flate2::read::ZlibDecoder;
use glam::DVec3;
use std::{fs, io::Read as _, process::Command, time::Duration};
use ventricle::{
    analysis::analyse,
    export::{ExportError, vtu},
    mesh::{Mesh, wall::signed_volume_mm3},
    phantom::{self, Imaging, Phantom, Shape, Ventricle},
    pipeline::{Reconstruction, Surface, monitor::Silent, parameters::Parameters, reconstruct, thickness::Thickness},
    report::{self, Timing},
    study::Study,
};

/// A VTK file, read array by array.
struct Opened(String);

impl Opened {
    fn new(bytes: &[u8]) -> Self {
        Self(String::from_utf8(bytes.to_vec()).unwrap())
    }

    fn bytes(&self, name: &str) -> Vec<u8> {
        let start = self.0.find(&format!("Name=\"{name}\"")).unwrap_or_else(|| panic!("no array {name}"));
        let (head, rest) = self.0[start..].split_once('>').unwrap();
        assert!(head.contains("format=\"binary\""), "{head}");
        // Four 32-bit numbers are 24 characters of base64; the block follows with an alphabet of its own.
        let (head, data) = rest.split_once('<').unwrap().0.split_at(24);
        let head: Vec<u32> = numbers(&STANDARD.decode(head).unwrap(), u32::from_le_bytes);
        let data = STANDARD.decode(data).unwrap();
        let mut raw = Vec::new();
        ZlibDecoder::new(&data[..]).read_to_end(&mut raw).unwrap();
        assert_eq!(head, [1, raw.len() as u32, 0, data.len() as u32], "{name}");
        raw
    }

    fn doubles(&self, name: &str) -> Vec<f64> {
        numbers(&self.bytes(name), f64::from_le_bytes)
    }

    fn singles(&self, name: &str) -> Vec<f64> {
        numbers(&self.bytes(name), f32::from_le_bytes).into_iter().map(f64::from).collect()
    }

    fn points(&self) -> Vec<DVec3> {
        vectors(&self.doubles("Points"))
    }

    /// Volumes from points and connectivity, in mm³.
    fn volumes(&self) -> Vec<f64> {
        let points = self.points();
        let connectivity = numbers(&self.bytes("connectivity"), u32::from_le_bytes);
        connectivity.chunks_exact(4).map(|cell| signed_volume_mm3(std::array::from_fn(|corner| points[cell[corner] as usize]))).collect()
    }
}

fn numbers<T, const N: usize>(bytes: &[u8], number: fn([u8; N]) -> T) -> Vec<T> {
    assert!(bytes.len().is_multiple_of(N));
    bytes.chunks_exact(N).map(|bytes| number(bytes.try_into().unwrap())).collect()
}

fn vectors(values: &[f64]) -> Vec<DVec3> {
    values.chunks_exact(3).map(DVec3::from_slice).collect()
}

fn assert_in_order(study: &Study, level: u32, what: &str) -> Reconstruction {
    let mut parameters = Parameters::paper();
    parameters.mesh.level = level;
    let result = reconstruct(study, &parameters, &Silent).unwrap();
    for (gate, found) in (1..).zip(&result.gates) {
        let (wall, order) = (found.wall().unwrap(), &found.wall_order);
        assert_eq!((wall.inverted(), order.inverted, order.turned), (0, 0, 0), "{what}, level {level}, gate {gate}: {order:?}");
        let sum_ml = wall.volumes_mm3().sum::<f64>() / 1000.0;
        assert!((sum_ml / found.myocardial_ml() - 1.0).abs() < 1e-9, "{what}, level {level}, gate {gate}: {sum_ml} ml");
        for surface in Surface::BOTH {
            let mesh = &found.fits.get(surface).mesh;
            assert_eq!(mesh.inverted_triangles(mesh.centroid()), 0, "{what}, level {level}, gate {gate}, {}", surface.name());
        }
        // Less than an edge at 162 vertices, and on average less than a tenth of a mm: what is published is what was fitted.
        assert!(order.largest_move_mm < 8.0 && order.mean_move_mm < 0.1, "{what}, level {level}, gate {gate}: {order:?}");
    }
    assert!(result.warnings.iter().all(|warning| warning.code != "wall_inverted"));
    result
}

#[test]
fn every_tetrahedron_of_a_reconstruction_has_a_positive_volume() {
    let imaging = Imaging { gates: 2, ..Imaging::default() };
    for (name, phantom, levels) in [
        ("paper", Phantom::paper(), 2..=4),
        ("demo", Phantom { imaging: imaging.clone(), ..Phantom::demo() }, 3..=3),
        ("small", Phantom { imaging, ..Phantom::small() }, 4..=4),
    ] {
        let study = phantom::simulate(&phantom).unwrap().study;
        for level in levels {
            let result = assert_in_order(&study, level, name);
            assert!(level < 3 || result.gates[0].wall_order.inverted_before > 0, "{name}: nothing was to be done, so nothing was shown");
        }
    }
}

#[test]
fn real_studies_have_walls_in_order_at_the_finest_level() {
    let Some(studies) = shared::gated_short_axis() else { return };
    for real in studies.iter().step_by(5) {
        assert_in_order(&real.study, 4, &real.name);
    }
}

#[test]
fn the_file_holds_the_wall_of_the_report_in_every_frame() {
    for orientation in [None, Some(oblique(false)), Some(oblique(true))] {
        let (study, reconstruction) = beating(3, 3, orientation);
        let report = report::build("x", &study, &reconstruction, &analyse(&study, &reconstruction), &Timing::default());
        for gate in 0..3 {
            let file = Opened::new(&vtu::wall(&study, &reconstruction, gate).unwrap());
            let expected = reconstruction.gates[gate].wall().unwrap();
            let volumes = file.volumes();
            assert_eq!((volumes.len(), file.bytes("types")), (3840, vec![10; 3840]));
            assert!(volumes.iter().all(|&volume| volume > 0.0), "{orientation:?}");
            let sum_ml = volumes.iter().sum::<f64>() / 1000.0;
            assert!((sum_ml / report.gates[gate].myocardial_ml - 1.0).abs() < 1e-9, "{orientation:?}: {sum_ml} ml");
            assert_eq!(file.doubles("volume_mm3"), volumes);
            let offsets = numbers(&file.bytes("offsets"), u32::from_le_bytes);
            assert!((1..).zip(&offsets).all(|(cell, &offset)| offset == 4 * cell));
            let placed = |point: DVec3| orientation.map_or(point, |orientation| orientation.patient_mm(point));
            assert_eq!(file.points(), expected.positions.iter().map(|&point| placed(point)).collect::<Vec<_>>());
            assert_eq!(numbers(&file.bytes("in_patient_frame"), u32::from_le_bytes), [u32::from(orientation.is_some())]);
            assert_eq!(numbers(&file.bytes("gate"), u32::from_le_bytes), [gate as u32 + 1]);
            assert_eq!(file.bytes("surface"), [vec![0; 642], vec![1; 642]].concat());
            // Gate 1 is the end-diastolic one.
            let first = reconstruction.gates[0].wall().unwrap();
            let displacements = vectors(&file.singles("displacement_mm"));
            for ((displacement, from), to) in displacements.iter().zip(&first.positions).zip(&expected.positions) {
                assert!(displacement.distance(placed(*to) - placed(*from)) < 1e-5, "{displacement}");
            }
            assert_eq!(displacements.iter().all(|way| *way == DVec3::ZERO), gate == 0);
            let thickness = Thickness::of(&reconstruction.gates[gate], reconstruction.to_base);
            let told = file.singles("thickness_mm");
            for (value, told) in thickness.mm.endocardial.iter().chain(&thickness.mm.epicardial).zip(&told) {
                assert!((value - told).abs() < 1e-5, "{value} {told}");
            }
        }
    }
}

#[test]
fn thickness_is_that_of_the_wall_and_not_of_the_valve_plane() {
    // Half spheres of 20 and 30 mm, the base at either end of the stack. The closest point lies on the radius, where it is not in the rim of
    // the other surface: the rim's 4 mm and an edge of at most 2.3. From there the way to the wall below the rim is at most 11.1 mm.
    const BELOW_RIM_MM: f64 = 6.5;
    for base in [1.0, -1.0] {
        let (_, mut reconstruction) = beating(1, 4, None);
        reconstruction.to_base = DVec3::Z * base;
        let cut = |radius: f64| Mesh::icosphere(4).map(|p| (p * radius).with_z(base * (base * p.z * radius).min(0.0)));
        let gate = &mut reconstruction.gates[0];
        gate.fits.endocardial.mesh = cut(20.0);
        gate.fits.epicardial.mesh = cut(30.0);
        let thickness = Thickness::of(gate, DVec3::Z * base);
        let range = thickness.range().unwrap();
        assert!((range.mean_mm - 10.0).abs() < 0.05 && range.min_mm > 9.9 && range.max_mm < 11.1, "{range:?}");
        for surface in Surface::BOTH {
            let mesh = &gate.fits.get(surface).mesh;
            for ((position, &in_lid), mm) in mesh.positions.iter().zip(thickness.in_lid.get(surface)).zip(thickness.mm.get(surface)) {
                let height = base * position.z;
                // The rim's 4 mm, and an edge more where normals at it are mixed.
                assert!(!in_lid || height > -6.0, "{position}");
                assert!(in_lid || height <= -4.0, "{position}");
                let across = if surface == Surface::Endocardial { 30.0 / 20.0 } else { 20.0 / 30.0 };
                assert!(in_lid || height * across > -BELOW_RIM_MM || (9.9..10.1).contains(mm), "{position}: {mm} mm");
                assert!(mm.is_finite());
            }
        }
        let summary = report::build(
            "x",
            &beating(1, 2, None).0,
            &reconstruction,
            &analyse(&beating(1, 2, None).0, &reconstruction),
            &Timing::default(),
        )
        .gates
        .remove(0)
        .wall;
        assert_eq!((summary.tetrahedra, summary.thickness_definition.as_str()), (15_360, "closest_point"));
        let told = summary.thickness_mm.unwrap();
        assert_eq!((told.mean, told.max, told.min), (range.mean_mm, range.max_mm, range.min_mm));
    }
}

#[test]
fn what_has_no_wall_is_refused_by_gate() {
    let (study, mut reconstruction) = beating(2, 2, None);
    assert!(matches!(vtu::wall(&study, &reconstruction, 2), Err(ExportError::NoSuchGate { gate: 3, gates: 2 })));
    reconstruction.gates[1].fits.epicardial.mesh = Mesh::icosphere(3);
    assert!(matches!(vtu::wall(&study, &reconstruction, 1), Err(ExportError::NoWall { gate: 2 })));
    reconstruction.gates[0].fits.endocardial.mesh.positions[3].x = f64::NAN;
    let refused = vtu::wall(&study, &reconstruction, 0);
    assert!(matches!(refused, Err(ExportError::NotFinite { gate: 1, surface: Surface::Endocardial })), "{refused:?}");
}

#[test]
fn the_service_and_the_command_give_the_same_wall() {
    let phantom = Phantom { imaging: Imaging { gates: 2, ..Imaging::default() }, ..Phantom::of(Shape::Ventricle(Ventricle::NORMAL)) };
    let study = phantom::dicom::write(&phantom::simulate(&phantom).unwrap().study).unwrap();
    let folder = Directory::new("wall");
    let (file, walls) = (folder.0.join("study.dcm"), folder.0.join("walls"));
    fs::write(&file, &study).unwrap();
    let said = Command::new(env!("CARGO_BIN_EXE_ventricle")).arg("reconstruct").arg(&file).arg("--wall").arg(&walls).output().unwrap();
    assert!(said.status.success(), "{}", String::from_utf8_lossy(&said.stderr));

    let service = Served::start(&folder.0.join("data"), &[]);
    let posted = service.post("application/dicom", &study).json();
    let path = posted["links"]["self"].as_str().unwrap();
    let job = service.finished(posted["id"].as_str().unwrap(), Duration::from_mins(2));
    assert_eq!(job["state"], "succeeded", "{job}");
    let report = service.get(&format!("{path}/report")).json();
    for gate in 1..=2 {
        let answer = service.get(&format!("{path}/gates/{gate}/wall.vtu"));
        assert_eq!((answer.status, answer.media_type.as_str()), (200, "application/xml"));
        assert!(answer.body == fs::read(walls.join(format!("wall-{gate}.vtu"))).unwrap(), "gate {gate}: the files differ");
        let volumes = Opened::new(&answer.body).volumes();
        assert!(volumes.iter().all(|&volume| volume > 0.0));
        let told = &report["gates"][gate - 1];
        assert!((volumes.iter().sum::<f64>() / 1000.0 / told["myocardial_ml"].as_f64().unwrap() - 1.0).abs() < 1e-9);
        assert_eq!((&told["wall"]["tetrahedra"], &told["wall"]["inverted"]), (&volumes.len().into(), &0.into()));
    }
    assert_eq!(service.get(&format!("{path}/gates/3/wall.vtu")).status, 404);
}
