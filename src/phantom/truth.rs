//! What is true of a simulated study, from closed forms.

use super::anatomy::Scene;
use super::regional::Borders;
use super::{Phantom, Shape, cycle};
use glam::DVec3;
use serde::{Deserialize, Serialize};

/// The exact values behind a study. Gate volumes are those of the shapes that were imaged, not of the continuous cycle.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Truth {
    /// Every gate, in time order.
    pub gates: Vec<GateTruth>,
    /// The largest endocardial volume of a gate in ml.
    pub edv_ml: f64,
    /// The smallest endocardial volume of a gate in ml.
    pub esv_ml: f64,
    /// `edv_ml − esv_ml`.
    pub sv_ml: f64,
    /// Stroke volume over end-diastolic volume of the gates, in percent; 0 when nothing beats.
    pub ef_percent: f64,
    /// The gate of the largest volume, counted from 1.
    pub end_diastolic_gate: usize,
    /// The gate of the smallest volume, counted from 1.
    pub end_systolic_gate: usize,
    /// Ejection fraction of the continuous cycle that the gates sample, in percent.
    pub continuous_ef_percent: f64,
    /// Share of the wall's volume with a defect, an upper bound where defects overlap; of the wall without [`super::Regional`] parts.
    pub defect_fraction: f64,
    /// Whether the whole ventricle lies within the grid at the end-diastolic gate; a grid that cuts it leaves the volumes as they are.
    pub within_grid: bool,
    /// Whether there is a ventricle to be found.
    pub has_ventricle: bool,
}

/// The exact values of one gate.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct GateTruth {
    /// Volume of the cavity up to the valve plane in ml.
    pub endocardial_ml: f64,
    /// Volume of cavity and wall up to the valve plane in ml.
    pub epicardial_ml: f64,
    /// Volume of the wall in ml.
    pub myocardial_ml: f64,
    /// Tip of the epicardium in grid mm `[x, y, z]` (gate's centre).
    pub apex_mm: Option<[f64; 3]>,
    /// Where the long axis meets the valve plane in grid mm `[x, y, z]` (gate's centre).
    pub base_mm: Option<[f64; 3]>,
}

/// The truth of a phantom.
pub(super) fn of(phantom: &Phantom) -> Truth {
    let imaging = &phantom.imaging;
    let gates: Vec<GateTruth> = (0..imaging.gates).map(|gate| gate_truth(phantom, gate)).collect();
    let volume = |gate: &usize| gates[*gate].endocardial_ml;
    let (mut largest, mut smallest) = (0, 0);
    for gate in 1..gates.len() {
        if volume(&gate) > volume(&largest) {
            largest = gate;
        }
        if volume(&gate) < volume(&smallest) {
            smallest = gate;
        }
    }
    let (edv_ml, esv_ml) = (volume(&largest), volume(&smallest));
    let continuous_ef_percent = match phantom.shape {
        Shape::Ventricle(_) => phantom.continuous_ends_ml().map_or(0.0, |(edv_ml, esv_ml)| ejection_fraction_percent(edv_ml, esv_ml)),
        Shape::Cylinder(_) | Shape::Decoy(_) | Shape::Empty => 0.0,
    };
    Truth {
        edv_ml,
        esv_ml,
        sv_ml: edv_ml - esv_ml,
        ef_percent: ejection_fraction_percent(edv_ml, esv_ml),
        end_diastolic_gate: largest + 1,
        end_systolic_gate: smallest + 1,
        continuous_ef_percent,
        defect_fraction: phantom.uptake.defects.iter().fold(0.0, |sum, defect| f64::min(sum + defect.extent, 1.0)),
        within_grid: Scene::at_phase(phantom, (largest as f64 + 0.5) / imaging.gates as f64).ventricle_is_within(&imaging.grid),
        has_ventricle: phantom.shape.is_ventricle(),
        gates,
    }
}

fn gate_truth(phantom: &Phantom, gate: usize) -> GateTruth {
    let imaging = &phantom.imaging;
    let samples = imaging.motion_samples;
    let (mut endocardial_ml, mut epicardial_ml) = (0.0, 0.0);
    for borders in cycle::gate_phases(gate, imaging.gates, samples).filter_map(|phase| Borders::at_phase(phantom, phase)) {
        let (cavity_ml, whole_ml) = borders.volumes_ml();
        endocardial_ml += cavity_ml / samples as f64;
        epicardial_ml += whole_ml / samples as f64;
    }
    let centre = (gate as f64 + 0.5) / imaging.gates as f64;
    let landmarks = Scene::at_phase(phantom, centre).landmarks_mm();
    let in_study = |point: DVec3| {
        let last_slice_mm = (imaging.grid.shape[0] - 1) as f64 * imaging.grid.spacing_mm[0];
        [point.x, point.y, if phantom.pose.reversed { last_slice_mm - point.z } else { point.z }]
    };
    GateTruth {
        endocardial_ml,
        epicardial_ml,
        myocardial_ml: epicardial_ml - endocardial_ml,
        apex_mm: landmarks.map(|(apex, _)| in_study(apex)),
        base_mm: landmarks.map(|(_, base)| in_study(base)),
    }
}

fn ejection_fraction_percent(edv_ml: f64, esv_ml: f64) -> f64 {
    if edv_ml > 0.0 { (edv_ml - esv_ml) / edv_ml * 100.0 } else { 0.0 }
}
