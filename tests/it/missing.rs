//! Missing data (paper §7.6): walls of which 10, 32 and 53 % take up nothing. What is recovered, and whether what is missing is told.
//!
//! `cargo test --test it missing -- --nocapture` prints the volumes of the tables in `docs/numerics.md`.

use std::sync::OnceLock;
use ventricle::{
    analysis::analyse,
    phantom::{self, Defect, Phantom, Simulation, Site},
    pipeline::{
        Reconstruction, Surface,
        monitor::Silent,
        parameters::{Parameters, RegionMarks, Seed},
        reconstruct,
    },
    report,
    study::{Affected, Warning},
};

const SITES: [Site; 3] = [Site::Apical, Site::Anterior, Site::Inferior];
const EXTENTS: [f64; 3] = [0.10, 0.32, 0.53];

/// The phantom with a part of its wall emptied.
fn emptied(phantom: &Phantom, site: Site, extent: f64) -> Phantom {
    let mut phantom = phantom.clone();
    phantom.uptake.defects.push(Defect { site, extent, severity: 1.0 });
    phantom
}

/// The marks that a user who knows the upright phantom would give (§8: centre, useful slices and filtering circle by hand).
fn exact_marks(phantom: &Phantom, simulation: &Simulation) -> RegionMarks {
    let truth = &simulation.truth.gates[simulation.truth.end_diastolic_gate - 1];
    let (apex, base) = (truth.apex_mm.unwrap(), truth.base_mm.unwrap());
    let spacing_mm = phantom.imaging.grid.spacing_mm[0];
    let slice = |z_mm: f64, half: f64| Some((z_mm / spacing_mm + half).round() as usize);
    RegionMarks {
        centre_mm: Some([f64::midpoint(apex[0], base[0]), f64::midpoint(apex[1], base[1])]),
        radius_mm: phantom.shape.surfaces(0.0).map(|surfaces| surfaces.epicardium.widest_radius_mm() + 15.0),
        first_slice: slice(apex[2].min(base[2]), 1.5),
        last_slice: slice(apex[2].max(base[2]), 0.5),
    }
}

/// The reconstruction with the region estimated.
fn recovered(phantom: &Phantom) -> Reconstruction {
    reconstruct(&phantom::simulate(phantom).unwrap().study, &Parameters::paper(), &Silent).unwrap()
}

/// The reconstructions with the region estimated and marked.
fn recovered_both_ways(phantom: &Phantom) -> [Reconstruction; 2] {
    let simulation = phantom::simulate(phantom).unwrap();
    [RegionMarks::default(), exact_marks(phantom, &simulation)].map(|region| {
        let parameters = Parameters { region, ..Parameters::paper() };
        reconstruct(&simulation.study, &parameters, &Silent).unwrap()
    })
}

/// A beating ventricle without a third of its wall, and its reconstruction; two tests look at it.
fn anterior_gap() -> &'static (Simulation, Reconstruction) {
    static GAP: OnceLock<(Simulation, Reconstruction)> = OnceLock::new();
    GAP.get_or_init(|| {
        let simulation = phantom::simulate(&emptied(&Phantom::normal(), Site::Anterior, 0.32)).unwrap();
        let found = reconstruct(&simulation.study, &Parameters::paper(), &Silent).unwrap();
        (simulation, found)
    })
}

fn volumes(found: &Reconstruction) -> [f64; 2] {
    Surface::BOTH.map(|surface| found.gates[0].volume_ml(surface))
}

fn ejection_fraction_percent(found: &Reconstruction) -> f64 {
    let cavity = || found.gates.iter().map(|gate| gate.volume_ml(Surface::Endocardial));
    100.0 * (1.0 - cavity().fold(f64::INFINITY, f64::min) / cavity().fold(0.0, f64::max))
}

fn told(found: &Reconstruction) -> Vec<&Warning> {
    found.warnings.iter().filter(|warning| warning.code == "partial_border").collect()
}

#[test]
fn a_still_ventricle_keeps_its_volumes_where_a_gap_can_be_bridged() {
    let intact = recovered_both_ways(&Phantom::heart_like()).map(|found| volumes(&found));
    eprintln!("intact, estimated and marked: {intact:.1?} ml");
    for site in SITES {
        for extent in EXTENTS {
            let both = recovered_both_ways(&emptied(&Phantom::heart_like(), site, extent));
            for ((marked, found), intact) in [false, true].into_iter().zip(&both).zip(intact) {
                let part = [0, 1].map(|surface| 100.0 * volumes(found)[surface] / intact[surface]);
                eprintln!("marked {marked}, {site:?} {extent}: {:.1?} ml, {part:.1?} % of the intact", volumes(found));
                if site == Site::Apical {
                    let seen = told(found);
                    assert_eq!(seen.len(), 2, "{site:?} {extent}, marked {marked}: {seen:?}");
                    assert!(seen.iter().all(|warning| warning.affected.as_ref().is_some_and(|affected| affected.apex_unseen)));
                }
                // A sector is bridged; an apex is only where a mark says so.
                if site != Site::Apical || marked {
                    assert!(part.iter().all(|part| (85.0..=115.0).contains(part)), "{site:?} {extent}, marked {marked}: {part:.1?}");
                }
            }
        }
    }
}

#[test]
fn a_beating_ventricle_keeps_its_ejection_fraction_with_a_third_of_its_wall_gone() {
    let intact = recovered(&Phantom::normal());
    assert!(told(&intact).is_empty(), "{:?}", told(&intact));
    let intact = ejection_fraction_percent(&intact);
    let inferior = recovered(&emptied(&Phantom::normal(), Site::Inferior, 0.32));
    for (site, found) in [(Site::Anterior, &anterior_gap().1), (Site::Inferior, &inferior)] {
        let found = ejection_fraction_percent(found);
        eprintln!("{site:?}: EF {found:.1} %, intact {intact:.1} %");
        assert!((found - intact).abs() < 6.0, "{site:?}: EF {found:.1} %, intact {intact:.1} %");
    }
}

#[test]
fn an_anterior_gap_is_told_at_every_gate_with_its_place() {
    let (simulation, found) = anterior_gap();
    let spacing_mm = simulation.study.grid.spacing_mm[0];
    for (gate, truth) in simulation.truth.gates.iter().enumerate() {
        let warnings: Vec<&Warning> = told(found).into_iter().filter(|warning| warning.gate == Some(gate + 1)).collect();
        assert!((1..=2).contains(&warnings.len()), "gate {}: {warnings:?}", gate + 1);
        for warning in warnings {
            let Affected { first_slice, last_slice, arc, apex_unseen, .. } = warning.affected.clone().unwrap();
            let arc = arc.unwrap();
            assert!(!apex_unseen, "{warning:?}");
            assert_eq!((arc.towards.as_str(), arc.walls.as_slice()), ("first row", &["anterior".to_owned()][..]), "{warning:?}");
            // 32 % are the 115° about 270°; the blurred sides of the gap may add or take 25° each.
            assert!(arc.from_degrees.abs_diff(212) <= 25 && arc.to_degrees.abs_diff(328) <= 25, "{warning:?}");
            let slice = |z_mm: f64| (z_mm / spacing_mm).round() as usize + 1;
            let (apex, base) = (slice(truth.apex_mm.unwrap()[2]), slice(truth.base_mm.unwrap()[2]));
            // Next to the apex the rings are too small to have sectors.
            assert!(first_slice + 1 >= apex && first_slice <= apex + 5, "from {apex}: {warning:?}");
            assert!(last_slice.abs_diff(base) <= 2, "to {base}: {warning:?}");
            assert!(warning.message.contains("anterior"), "{warning:?}");
        }
    }
    let report = report::build("gap", &simulation.study, found, &analyse(&simulation.study, found), &report::Timing::default());
    let remark = report.warnings.iter().find(|remark| remark.code == "partial_border").unwrap();
    assert_eq!(remark.affected.as_ref().unwrap().arc.as_ref().unwrap().walls, ["anterior"]);
}

#[test]
fn walls_are_not_named_without_an_orientation() {
    let mut study = phantom::simulate(&emptied(&Phantom::heart_like(), Site::Anterior, 0.32)).unwrap().study;
    study.orientation = None;
    let found = reconstruct(&study, &Parameters::paper(), &Silent).unwrap();
    let arc = told(&found)[0].affected.clone().unwrap().arc.unwrap();
    assert_eq!(arc.towards, "first row");
    assert!(arc.walls.is_empty(), "{arc:?}");
}

#[test]
fn an_intact_ventricle_tells_nothing() {
    // The normal one's turn is above, with its ejection fraction.
    for phantom in [Phantom::paper(), Phantom::heart_like(), Phantom::demo()] {
        let found = recovered(&phantom);
        assert!(told(&found).is_empty(), "{:?}", told(&found));
    }
}

#[test]
fn the_base_is_told_by_the_patient_where_half_the_wall_is_missing_at_the_apex() {
    let found = recovered(&emptied(&Phantom::heart_like(), Site::Apical, 0.53));
    assert!(found.region.is_some_and(|region| region.base_at_last_slice), "{:?}", found.region);
    assert!(found.warnings.iter().all(|warning| warning.code != "slice_order_assumed"));
}

#[test]
fn every_seed_gives_one_topology_and_finite_motion() {
    let mut phantom = Phantom::normal();
    phantom.imaging.gates = 4;
    let study = phantom::simulate(&phantom).unwrap().study;
    for seed in [Seed::OwnEllipsoid, Seed::CommonEllipsoid, Seed::PreviousGate] {
        let mut parameters = Parameters::paper();
        parameters.mesh.seed = seed;
        let found = reconstruct(&study, &parameters, &Silent).unwrap();
        for surface in Surface::BOTH {
            let mesh = |gate: usize| &found.gates[gate % 4].fits.get(surface).mesh;
            for gate in 0..4 {
                assert_eq!(mesh(gate).triangles, mesh(gate + 1).triangles, "{seed:?}");
                let motion = mesh(gate).positions.iter().zip(&mesh(gate + 1).positions).map(|(from, to)| from.distance(*to));
                let longest = motion.fold(0.0, f64::max);
                // The valve plane moves by 13 mm in this ventricle and its wall by 10; a vertex that moves more than both is another particle.
                assert!(longest.is_finite() && longest > 0.0 && longest < 25.0, "{seed:?}, gate {}: {longest} mm", gate + 1);
            }
        }
    }
}
