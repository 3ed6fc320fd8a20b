//! Table 5 and figure 9 (§7.5): the volumes of a cardiac cycle and its ejection fraction.

use super::{PaperError, printed};
use crate::{
    drawing::markdown::{Table, grouped, signed},
    phantom::{self, Phantom, Truth},
    pipeline::{self, Reconstruction, Surface, monitor::Silent, parameters::Parameters},
    report::Function,
};

/// A reconstructed cycle and its truth.
#[derive(Debug, Clone)]
pub struct Cycle {
    /// What was found.
    pub found: Reconstruction,
    /// What is true.
    pub truth: Truth,
}

/// The simulated normal ventricle of eight gates, on the paper's grid, with the parameters of §7.5 and the region estimated.
pub fn measure() -> Result<Cycle, PaperError> {
    let simulation = phantom::simulate(&Phantom::normal())?;
    let found = pipeline::reconstruct(&simulation.study, &Parameters::paper(), &Silent)?;
    Ok(Cycle { found, truth: simulation.truth })
}

/// The table, and the printed one with its arithmetic.
pub fn markdown(cycle: &Cycle) -> String {
    let gates = cycle.found.gates.len();
    let mut ours = Table::new(["mm³", "1", "2", "3", "4", "5", "6", "7", "8"]);
    let mut row = |name: &str, cell: &dyn Fn(usize) -> String| ours.row(std::iter::once(name.to_owned()).chain((0..gates).map(cell)));
    let volume = |gate: usize, surface: Surface| cycle.found.gates[gate].volume_ml(surface) * 1000.0;
    let exact = |gate: usize| &cycle.truth.gates[gate];
    row("Int., found", &|gate| grouped(volume(gate, Surface::Endocardial)));
    row("Int., exact", &|gate| grouped(exact(gate).endocardial_ml * 1000.0));
    row("Ext., found", &|gate| grouped(volume(gate, Surface::Epicardial)));
    row("Ext., exact", &|gate| grouped(exact(gate).epicardial_ml * 1000.0));
    row("Wall, found", &|gate| grouped(cycle.found.gates[gate].myocardial_ml() * 1000.0));
    row("Wall, exact", &|gate| grouped(exact(gate).myocardial_ml * 1000.0));
    let mut paper = Table::new(["mm³, **paper**", "1", "2", "3", "4", "5", "6", "7", "8"]);
    let mut row = |name: &str, values: [f64; 8]| paper.row(std::iter::once(name.to_owned()).chain(values.map(grouped)));
    row("Int.", printed::CYCLE_INTERNAL_MM3);
    row("Ext.", printed::CYCLE_EXTERNAL_MM3);
    row("Wall", printed::CYCLE_WALL_MM3);
    row("Ext. − Int.", printed::cycle_wall_mm3());
    let mut ejection = Table::new(["figure 9", "EDV (ml)", "gate", "ESV (ml)", "gate", "EF (%)"]);
    let mut row = |name: &str, function: Option<Function>| {
        if let Some(of) = function {
            let volumes = [
                format!("{:.1}", of.edv_ml),
                of.end_diastolic_gate.to_string(),
                format!("{:.1}", of.esv_ml),
                of.end_systolic_gate.to_string(),
            ];
            ejection.row(std::iter::once(name.to_owned()).chain(volumes).chain([format!("{:.1}", of.ef_percent)]));
        }
    };
    let cavities: Vec<f64> = (0..gates).map(|gate| volume(gate, Surface::Endocardial) / 1000.0).collect();
    let exact_cavities: Vec<f64> = cycle.truth.gates.iter().map(|gate| gate.endocardial_ml).collect();
    row("found", Function::of_cavity(&cavities));
    row("exact", Function::of_cavity(&exact_cavities));
    row("**paper**, from its Table 5", printed::cycle_function());
    let walls: Vec<f64> = (0..gates).map(|gate| cycle.found.gates[gate].myocardial_ml()).collect();
    format!("{ours}\n{paper}\n{ejection}\n{}", spread(&walls))
}

/// One sentence about how far the wall's volume varies, here and in the paper.
fn spread(walls_ml: &[f64]) -> String {
    let range = |values: &[f64]| {
        let mean = values.iter().sum::<f64>() / values.len().max(1) as f64;
        let off = |value: f64| 100.0 * (value / mean - 1.0);
        let (low, high) = values.iter().fold((f64::MAX, f64::MIN), |(low, high), &value| (low.min(value), high.max(value)));
        format!("{} to {} %", signed(off(low), 1), signed(off(high), 1))
    };
    format!(
        "The wall's volume lies within {} of its mean over the cycle here, and within {} in the paper.\n",
        range(walls_ml),
        range(&printed::CYCLE_WALL_MM3)
    )
}
