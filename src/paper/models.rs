//! Table 1 (§7.2): how near each deformable model comes to the border, and at what cost.

use super::{
    PaperError,
    experiment::{Experiment, Run},
    printed,
};
use crate::drawing::markdown::Table;
use crate::pipeline::{
    Surface,
    parameters::{Model, Parameters, Solver, SpringDirection},
    rest::Stop,
};

/// Time steps of the runs in s.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Steps {
    /// Plane (1), implicit.
    pub plane_1_s: f64,
    /// Plane (2), implicit.
    pub plane_2_s: f64,
    /// All explicit runs.
    pub explicit_s: f64,
}

impl Steps {
    /// Table 1's.
    pub const PRINTED: Self = Self { plane_1_s: 0.01, plane_2_s: 0.05, explicit_s: 0.0005 };
}

/// A model in the table.
#[derive(Debug, Clone, PartialEq)]
pub struct Candidate {
    /// Its name in the table.
    pub name: &'static str,
    /// What the paper prints for it, in percent.
    pub printed_percent: Option<f64>,
    /// Everything it runs with.
    pub parameters: Parameters,
    /// Whether it only shows what smoothing does, from the bounding ellipsoid.
    pub aside: bool,
}

/// A model on a surface.
#[derive(Debug, Clone)]
pub struct Row {
    /// Whether it started from the ellipsoid enlarged to the area of the printed mesh, outside the border, rather than from the bounding one.
    pub from_outside: bool,
    /// What ran.
    pub candidate: Candidate,
    /// On which surface.
    pub surface: Surface,
    /// What came of it.
    pub run: Run,
}

/// The paper's four columns and ours: the restricted spring-mass model in both directions.
///
/// §7.2: 642 particles, GVF constant 25, damping 25 %; smoothing belongs to the free model (§4).
pub fn candidates(steps: &Steps) -> Vec<Candidate> {
    let of = |name, printed_percent, model, solver, time_step_s| {
        let mut parameters = Parameters::paper();
        parameters.gvf.mu = 25.0;
        parameters.deform.model = model;
        parameters.deform.solver = solver;
        parameters.deform.time_step_s = time_step_s;
        parameters.deform.damping_percent = 25.0;
        parameters.deform.smoothing = model == Model::Free;
        // A particle of the explicit runs needs about 4000 steps of .0005 s from the ellipsoid to the border.
        parameters.deform.max_steps = 20_000;
        Candidate { name, printed_percent, parameters, aside: false }
    };
    let [plane_1, plane_2, spring_mass, free] = printed::WITHIN_ONE_VOXEL_PERCENT.map(Some);
    let restricted = |direction, name| {
        let mut candidate = of(name, None, Model::RestrictedSpringMass, Solver::Euler, steps.explicit_s);
        candidate.parameters.deform.spring_direction = direction;
        candidate
    };
    let mut unsmoothed = of("Free, not smoothed", None, Model::Free, Solver::Euler, steps.explicit_s);
    unsmoothed.parameters.deform.smoothing = false;
    unsmoothed.aside = true;
    let mut list = vec![
        of("Plane (1)", plane_1, Model::Plane, Solver::ImplicitEuler, steps.plane_1_s),
        of("Plane (2)", plane_2, Model::Plane, Solver::ImplicitEuler, steps.plane_2_s),
        of("Spring-mass", spring_mass, Model::SpringMass, Solver::Euler, steps.explicit_s),
        restricted(SpringDirection::AcrossField, "Restricted spring-mass, across the field"),
        restricted(SpringDirection::AlongField, "Restricted spring-mass, along the field"),
        of("Free", free, Model::Free, Solver::Euler, steps.explicit_s),
        of("Spring-mass, the step of plane (2)", None, Model::SpringMass, Solver::Euler, steps.plane_2_s),
        of("Free, the step of plane (2)", None, Model::Free, Solver::Euler, steps.plane_2_s),
        unsmoothed,
    ];
    let smoothed = |name, model, solver, time_step_s| {
        let mut candidate = of(name, None, model, solver, time_step_s);
        candidate.parameters.deform.smoothing = true;
        candidate.aside = true;
        candidate
    };
    list.push(smoothed("Plane (2), smoothed", Model::Plane, Solver::ImplicitEuler, steps.plane_2_s));
    list.push(smoothed("Spring-mass, smoothed", Model::SpringMass, Solver::Euler, steps.explicit_s));
    list
}

/// Runs every candidate on both surfaces of the paper's phantom, from the bounding ellipsoid and from outside.
pub fn measure(steps: &Steps) -> Result<Vec<Row>, PaperError> {
    let candidates = candidates(steps);
    let columns: Vec<Candidate> = candidates.iter().filter(|candidate| !candidate.aside).cloned().collect();
    let mut rows = measure_from(false, &candidates)?;
    rows.extend(measure_from(true, &columns)?);
    Ok(rows)
}

/// Runs candidates on both surfaces of the paper's phantom; all have the first one's field.
pub fn measure_from(from_outside: bool, candidates: &[Candidate]) -> Result<Vec<Row>, PaperError> {
    let experiment = Experiment::paper_phantom()?;
    let Some(first) = candidates.first() else { return Ok(Vec::new()) };
    let flows = experiment.flows(&first.parameters)?;
    let mut rows = Vec::new();
    for candidate in candidates {
        for surface in Surface::BOTH {
            let seed = experiment.start(surface, candidate.parameters.mesh.level, from_outside);
            let run = experiment.run_from(seed, surface, flows.get(surface), &candidate.parameters, &mut |_| ())?;
            rows.push(Row { from_outside, candidate: candidate.clone(), surface, run });
        }
    }
    Ok(rows)
}

/// The two tables, by where the mesh starts.
pub fn markdown(rows: &[Row]) -> String {
    let of = |from_outside: bool| table(rows.iter().filter(|row| row.from_outside == from_outside));
    format!(
        "From the ellipsoid that bounds the border (§7.3):\n\n{}\nFrom that ellipsoid enlarged to the area that Table 2 prints for this mesh:\n\n{}",
        of(false),
        of(true)
    )
}

fn table<'a>(rows: impl Iterator<Item = &'a Row>) -> Table {
    let mut table = Table::new([
        "model",
        "solver",
        "Δt (s)",
        "surface",
        "< 1 voxel (%)",
        "paper (%)",
        "mean distance (mm)",
        "frozen (%)",
        "steps",
        "simulated (s)",
        "computed in (s)",
        "ended by",
    ]);
    for Row { candidate, surface, run, .. } in rows {
        table.row([
            candidate.name.to_owned(),
            solver_name(candidate.parameters.deform.solver).to_owned(),
            candidate.parameters.deform.time_step_s.to_string(),
            surface.name().to_owned(),
            format!("{:.1}", 100.0 * run.within_one_voxel),
            candidate.printed_percent.map_or_else(|| "—".to_owned(), |percent| percent.to_string()),
            format!("{:.2}", run.mean_distance_mm),
            format!("{:.1}", 100.0 * run.evolved.frozen),
            run.evolved.steps.to_string(),
            format!("{:.2}", run.simulated_s(&candidate.parameters)),
            format!("{:.2}", run.seconds),
            stop_name(run.evolved.stop).to_owned(),
        ]);
    }
    table
}

/// The name of a solver as the paper has it.
pub(super) fn solver_name(solver: Solver) -> &'static str {
    match solver {
        Solver::Euler => "Euler",
        Solver::Midpoint => "midpoint",
        Solver::Rk4 => "RK4",
        Solver::ImplicitEuler => "implicit Euler",
    }
}

fn stop_name(stop: Stop) -> &'static str {
    match stop {
        Stop::AllFrozen => "all frozen",
        Stop::AtRest => "at rest",
        Stop::StepLimit => "step limit",
    }
}
