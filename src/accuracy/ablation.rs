//! What each ingredient of the clinical preset buys: it is switched off, and the same studies are run again.

use super::{
    AccuracyError,
    family::{self, Group, Member},
    parallel,
    score::{self, Method, Outcome, Run, Score},
    statistics::{Agreement, mean},
};
use crate::{
    drawing::markdown::Table,
    phantom::PhantomError,
    pipeline::{
        Surface,
        parameters::{Parameters, RefineParameters},
    },
};

/// An ingredient that is switched off.
struct Without {
    name: &'static str,
    change: fn(&mut RefineParameters),
}

/// Those that the main runs do not hold. The width is that of the phantoms' middle: what a table of cameras would say.
const WITHOUT: [Without; 6] = [
    Without { name: "no tilt of the base", change: |refine| refine.base_tilt = false },
    Without { name: "no wall conservation", change: |refine| refine.wall_conservation = false },
    Without { name: "no temporal prior", change: |refine| refine.temporal_prior = false },
    Without { name: "no shape prior", change: |refine| refine.shape_prior = false },
    Without { name: "no uptake map", change: |refine| refine.uptake_map = false },
    Without { name: "PSF fixed at 11 mm", change: |refine| refine.psf_fwhm_mm = Some(11.0) },
];

/// The fixed part of the family: every eighth study without defects, every third with, every fourth small one.
pub fn subset() -> Vec<Member> {
    let all = family::members();
    let every = |group: Group, step: usize| all.iter().filter(move |member| member.group == group).step_by(step).cloned();
    every(Group::NoDefect, 8).chain(every(Group::Defect, 3)).chain(every(Group::Small, 4)).collect()
}

/// One study without each ingredient.
pub struct Ablated {
    /// The study's name.
    pub name: String,
    group: Group,
    outcomes: Vec<Outcome>,
}

/// Runs the subset without each ingredient.
///
/// Errors: a phantom that cannot be made, or no thread.
pub fn run(threads: usize) -> Result<Vec<Ablated>, AccuracyError> {
    let of = |_: usize, member: &Member| {
        let simulation = score::simulated(member)?;
        let without = |without: &Without| {
            let mut parameters = Parameters::clinical();
            (without.change)(&mut parameters.refine);
            score::outcome(member, &simulation, &parameters).0
        };
        Ok::<_, PhantomError>(Ablated { name: member.name.clone(), group: member.group, outcomes: WITHOUT.iter().map(without).collect() })
    };
    Ok(parallel::in_order(&subset(), threads, of)?.into_iter().collect::<Result<_, _>>()?)
}

/// A table a group. The whole preset, the given width and the gradient alone are taken from the main runs of the same studies.
pub fn markdown(runs: &[Run], ablated: &[Ablated]) -> String {
    let mut text = String::new();
    for (title, groups) in [("Without defects", &[Group::NoDefect][..]), ("With defects", &[Group::Defect]), ("Small", &[Group::Small])] {
        let chosen: Vec<&Ablated> = ablated.iter().filter(|one| groups.contains(&one.group)).collect();
        let mut table =
            Table::new(["", "failed", "EF (points)", "EDV (%)", "ESV (%)", "mass (%)", "endo (mm)", "epi (mm)", "wall spread (%)"]);
        let of_method = |method: Method| {
            chosen.iter().filter_map(move |one| Some(&runs.iter().find(|run| run.method == method && run.name == one.name)?.outcome))
        };
        for (name, method) in [("**everything**", Method::Clinical), ("PSF given", Method::PsfGiven)] {
            table.row(row(name, &of_method(method).collect::<Vec<_>>()));
        }
        for (place, without) in WITHOUT.iter().enumerate() {
            table.row(row(without.name, &chosen.iter().map(|one| &one.outcomes[place]).collect::<Vec<_>>()));
        }
        table.row(row("no model of the camera", &of_method(Method::Gradient).collect::<Vec<_>>()));
        text += &[title, &format!(" (n = {}):\n\n", chosen.len()), &table.to_string(), "\n"].concat();
    }
    text
}

fn row(name: &str, outcomes: &[&Outcome]) -> Vec<String> {
    let of = |value: fn(&Score) -> f64| Agreement::of(outcomes.iter().map(|outcome| outcome.score().map(value)));
    let cell = |value| of(value).text(1);
    let average = |value: fn(&Score) -> f64, decimals: usize| {
        let known: Vec<f64> = outcomes.iter().filter_map(|outcome| outcome.score()).map(value).collect();
        if known.is_empty() { "—".to_owned() } else { format!("{:.decimals$}", mean(&known)) }
    };
    vec![
        name.to_owned(),
        of(Score::ef_points).failed.to_string(),
        cell(Score::ef_points),
        cell(Score::edv_percent),
        cell(Score::esv_percent),
        cell(Score::mass_percent),
        average(|score| score.distance_mm(Surface::Endocardial), 2),
        average(|score| score.distance_mm(Surface::Epicardial), 2),
        average(|score| score.found.wall_spread_percent, 1),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_subset_has_every_group_of_ventricles() {
        let subset = subset();
        assert!((35..=50).contains(&subset.len()), "{}", subset.len());
        for group in [Group::NoDefect, Group::Defect, Group::Small] {
            assert!(subset.iter().filter(|member| member.group == group).count() >= 4, "{}", group.name());
        }
    }
}
