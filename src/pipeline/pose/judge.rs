//! Stage four: what speaks for a shell being a ventricle's wall, and whether it is enough.

use super::{
    held::Held,
    prepare::Field,
    shape::Shell,
    shell_fit::{self, Density, LEAST_ELONGATION, ShellFit, each_near, quantile},
    templates::{self, inside_mm, wall_points},
};

/// Brighter than a side means by this factor.
const BRIGHTER: f64 = 1.15;
/// Perfused is what has this part of the wall's counts.
const PERFUSED: f64 = 0.5;

/// What was measured of a shell.
#[derive(Debug, Clone, Copy)]
pub(super) struct Evidence {
    /// Part of the perfused mid-wall points brighter than both sides of the wall.
    pub ridge: f64,
    /// Part of the counts' variance that the shell explains.
    pub explained: f64,
    /// The same without the tenth of the points that is explained worst.
    pub explained_most: f64,
    /// Part of the mid-wall points with at least half of the wall's counts.
    pub perfused: f64,
    /// Counts in the cavity, as part of the wall's.
    pub cavity: f64,
    /// Counts in the opening at the valve plane, as part of the wall's.
    pub opening: f64,
    /// Part of the mid-wall points in the field of view.
    pub inside: f64,
}

/// A fitted shell with its evidence and the sum of it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Judged {
    pub fit: ShellFit,
    pub evidence: Evidence,
    pub score: f64,
}

/// Measures a fitted shell; `None` where nothing is known around it.
pub(super) fn judge(field: &Field, fit: &ShellFit, held: &Held) -> Option<Judged> {
    let evidence = evidence(field, fit, held)?;
    Some(Judged { fit: *fit, evidence, score: score(&evidence, &fit.shell) })
}

fn evidence(field: &Field, fit: &ShellFit, held: &Held) -> Option<Evidence> {
    let shell = &fit.shell;
    let [explained, explained_most] = shell_fit::explained(field, fit, held)?;
    let (mut wall, mut cavity, mut opening) = (Vec::new(), Vec::new(), Vec::new());
    let deep = f64::min(11.0, 0.55 * shell.radius_mm);
    each_near(field, shell, Density::Full, |_, place, value| {
        if place.outside_mm.abs() < 4.0 && place.height_mm > 4.0 {
            wall.push(value);
        }
        if place.outside_mm < -deep && place.height_mm > 0.0 {
            cavity.push(value);
        }
        if place.across.length() < 0.5 * shell.radius_mm && place.height_mm.abs() < 7.0 {
            opening.push(value);
        }
    });
    let level = quantile(&mut wall, 0.7)?;
    // What is not seen speaks neither for nor against.
    let unseen = 0.5 * level;
    let cavity = quantile(&mut cavity, 0.5).unwrap_or(unseen) / level;
    let opening = quantile(&mut opening, 0.5).unwrap_or(unseen) / level;
    let frame = shell.frame();
    let points = wall_points(shell);
    let placed: Vec<_> = points.iter().map(|&(point, normal)| (shell.base_mm + frame * point, frame * normal)).collect();
    let at_wall: Vec<Option<f64>> = placed.iter().map(|&(point, _)| field.at(point)).collect();
    let mut seen: Vec<f64> = at_wall.iter().copied().flatten().collect();
    let inside = seen.len() as f64 / points.len() as f64;
    let bright = quantile(&mut seen, 0.85)?;
    let (mut perfused, mut ridge) = (0_usize, 0_usize);
    for (&(point, normal), &counts) in placed.iter().zip(&at_wall) {
        let Some(counts) = counts.filter(|&counts| counts > PERFUSED * bright) else { continue };
        perfused += 1;
        let darker = |distance: f64| field.at(point + normal * distance).is_none_or(|beside| counts > BRIGHTER * beside);
        ridge += usize::from(darker(-inside_mm(shell.radius_mm)) && darker(templates::OUTSIDE_MM));
    }
    Some(Evidence {
        ridge: ridge as f64 / perfused.max(1) as f64,
        explained,
        explained_most,
        perfused: perfused as f64 / seen.len().max(1) as f64,
        cavity,
        opening,
        inside,
    })
}

/// One number to compare poses by; weights of the prototype.
fn score(evidence: &Evidence, shell: &Shell) -> f64 {
    0.5 * evidence.explained_most + evidence.explained + 0.4 * evidence.ridge + 0.15 * evidence.perfused
        - 0.6 * (LEAST_ELONGATION + 0.05 - shell.elongation()).max(0.0)
        - 1.5 * (shell.widest - 0.42).max(0.0)
        + 0.25 * (1.0 - evidence.cavity).min(0.6)
        + 0.8 * (1.0 - evidence.opening).min(0.9)
        - 0.5 * (0.9 - evidence.inside).max(0.0)
}

/// A limit of acceptance: what is measured, where it lies, and what a clear ventricle has.
struct Limit {
    what: &'static str,
    value: f64,
    limit: f64,
    clear: f64,
}

fn limits(judged: &Judged) -> [Limit; 5] {
    let e = &judged.evidence;
    [
        Limit { what: "part of its wall brighter than both of its sides", value: e.ridge, limit: 0.85, clear: 1.0 },
        Limit { what: "part of the counts' variance that a ventricle's wall explains", value: e.explained, limit: 0.75, clear: 0.95 },
        Limit { what: "counts in its cavity against its wall", value: e.cavity, limit: 0.65, clear: 0.35 },
        Limit { what: "counts in its opening against its wall", value: e.opening, limit: 0.62, clear: 0.3 },
        Limit { what: "part of its wall in the field of view", value: e.inside, limit: 0.8, clear: 1.0 },
    ]
}

/// How far inside the limits a shell is: 0 on the edge of one, 1 as clear as a phantom without noise in all.
pub(super) fn clearness(judged: &Judged) -> f64 {
    limits(judged).iter().map(|l| ((l.value - l.limit) / (l.clear - l.limit)).clamp(0.0, 1.0)).fold(1.0, f64::min)
}

/// Why a shell is no ventricle's wall; `None` if it may be one.
pub(super) fn objection(judged: &Judged, pointed_at: bool) -> Option<String> {
    // Somebody who points at the ventricle has seen it: then only what is nothing like a wall is refused.
    let slack = if pointed_at { 2.0 } else { 0.0 };
    let worst = limits(judged)
        .into_iter()
        .map(|l| ((l.value - l.limit) / (l.clear - l.limit), l))
        .min_by(|a, b| a.0.total_cmp(&b.0))
        .filter(|(margin, _)| *margin < -slack);
    let shell = &judged.fit.shell;
    if let Some((_, Limit { what, value, limit, clear })) = worst {
        let least = if clear > limit { "at least" } else { "at most" };
        return Some(format!(
            "of the best candidate, the {what} is {:.0} %; of a ventricle it is {least} {:.0} %",
            100.0 * value,
            100.0 * limit
        ));
    }
    if !pointed_at && !((15.0..=48.0).contains(&shell.radius_mm) && (38.0..=120.0).contains(&shell.length_mm)) {
        return Some(format!(
            "the best candidate has a radius of {:.0} mm and a length of {:.0} mm at mid-wall; ventricles have 15 to 48 and 38 to 120 mm",
            shell.radius_mm, shell.length_mm
        ));
    }
    None
}
