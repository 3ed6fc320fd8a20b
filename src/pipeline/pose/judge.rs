//! Stage four: what speaks for a shell being a ventricle's wall, and whether it is enough.

use super::{
    held::Held,
    prepare::Field,
    shape::Shell,
    shell_fit::{self, Density, LEAST_ELONGATION, ShellFit, each_near, quantile},
    templates::{self, inside_mm, wall_points},
};
use std::f64::consts::TAU;

/// Brighter than a side means by this factor.
const BRIGHTER: f64 = 1.15;
/// Perfused is what has this part of the wall's counts.
const PERFUSED: f64 = 0.5;

/// A tip with less than this part perfused is not seen.
const TIP_SEEN: f64 = 0.2;
/// A ring or tube is open at both ends, and so is a ventricle that lost its apex, but that is wider between its ends: its shell explains .87
/// and more, a torus' at most .83, a tube's .87.
const LEAST_EXPLAINED_WITHOUT_TIP: f64 = 0.86;
/// The same where the flipped pose is as good: tubes' at most .87, ventricles' .89 and more.
const LEAST_EXPLAINED_OF_RINGS: f64 = 0.885;

/// Least mean of the perfused parts of wall and rim: cups have .50 and less, ventricles with a defect of half their wall .55 and more.
const LEAST_WHOLE: f64 = 0.525;
/// A cup is as short as a shell may be (length over radius 2.0, 2.1 with noise). One longer than this with .49 was a ventricle with half of its wall dark
/// on one side; guts and rings have .27 and less.
const LONG: f64 = 2.3;
const LEAST_WHOLE_OF_LONG: f64 = 0.45;

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
    /// Counts behind the valve plane, as part of the wall's.
    pub behind: f64,
    /// Part of the mid-wall points in the field of view.
    pub inside: f64,
    /// Of the meridians that are perfused half way up, the part of the points next to the valve plane that is perfused too: the wall ends at
    /// the valve plane, not before it.
    pub rim: f64,
    /// Part of the seen points around the tip that is perfused; 0 with a large apical defect.
    pub tip: f64,
}

/// A fitted shell with its evidence and the sum of it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Judged {
    pub fit: ShellFit,
    pub evidence: Evidence,
    pub score: f64,
}

impl Evidence {
    /// Mean of the perfused parts of wall and rim. A cup that is no ventricle ends half way to where the fitted shell does, all around. In a
    /// ventricle with a defect of half its wall the rest reaches the valve plane.
    fn whole(&self) -> f64 {
        f64::midpoint(self.perfused, self.rim)
    }
}

impl Judged {
    /// Whether there is a wall around the tip.
    pub(super) fn tip_is_seen(&self) -> bool {
        self.evidence.tip >= TIP_SEEN
    }
}

/// Measures a fitted shell; `None` where nothing is known around it.
pub(super) fn judge(field: &Field, fit: &ShellFit, held: &Held) -> Option<Judged> {
    let evidence = evidence(field, fit, held)?;
    Some(Judged { fit: *fit, evidence, score: score(&evidence, &fit.shell) })
}

fn evidence(field: &Field, fit: &ShellFit, held: &Held) -> Option<Evidence> {
    let shell = &fit.shell;
    let [explained, explained_most] = shell_fit::explained(field, fit, held)?;
    let (mut wall, mut cavity, mut opening, mut behind) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    let deep = f64::min(11.0, 0.55 * shell.radius_mm);
    each_near(field, shell, Density::Half, |_, place, value| {
        if place.outside_mm.abs() < 4.0 && place.height_mm > 4.0 {
            wall.push(value);
        }
        if place.outside_mm < -deep && place.height_mm > 0.0 {
            cavity.push(value);
        }
        if place.across.length() < 0.5 * shell.radius_mm && place.height_mm.abs() < 7.0 {
            opening.push(value);
        }
        if place.across.length() < 0.7 * shell.radius_mm && (-16.0..-6.0).contains(&place.height_mm) {
            behind.push(value);
        }
    });
    let level = quantile(&mut wall, 0.7)?;
    // What is not seen speaks neither for nor against.
    let unseen = 0.5 * level;
    let cavity = quantile(&mut cavity, 0.5).unwrap_or(unseen) / level;
    let opening = quantile(&mut opening, 0.5).unwrap_or(unseen) / level;
    let behind = quantile(&mut behind, 0.5).unwrap_or(unseen) / level;
    let frame = shell.frame();
    let points = wall_points(shell);
    let placed: Vec<_> = points.iter().map(|&(point, normal)| (shell.base_mm + frame * point, frame * normal)).collect();
    let at_wall: Vec<Option<f64>> = placed.iter().map(|&(point, _)| field.at(point)).collect();
    let mut seen: Vec<f64> = at_wall.iter().copied().flatten().collect();
    let inside = seen.len() as f64 / points.len() as f64;
    let bright = quantile(&mut seen, 0.85)?;
    let (mut perfused, mut ridge) = (0_usize, 0_usize);
    // Height as part of the length, meridian (22.5 degrees apart), whether perfused.
    let spots: Vec<(f64, usize, bool)> = points
        .iter()
        .zip(&at_wall)
        .filter_map(|((point, _), counts)| {
            let meridian = (point.y.atan2(point.x).rem_euclid(TAU) / TAU * 16.0).round() as usize % 16;
            counts.map(|counts| (point.z / shell.length_mm, meridian, counts > PERFUSED * bright))
        })
        .collect();
    let share = |part: &dyn Fn(f64, usize) -> bool| {
        let of: Vec<bool> = spots.iter().filter(|spot| part(spot.0, spot.1)).map(|spot| spot.2).collect();
        of.iter().filter(|&&perfused| perfused).count() as f64 / of.len().max(1) as f64
    };
    let alive = |meridian: usize| spots.iter().any(|spot| spot.1 == meridian && spot.2 && (0.3..0.8).contains(&spot.0));
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
        behind,
        inside,
        rim: share(&|height, meridian| height < 0.3 && alive(meridian)),
        tip: share(&|height, _| height > 0.85),
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
    at: f64,
    clear: f64,
}

/// Calibrated on phantoms and negatives of some seeds and checked on others (`docs/numerics.md`, "Finding the ventricle"): the worst ventricle
/// of the phantoms and the worst real study against the negatives that no other limit refuses.
fn limits(judged: &Judged) -> [Limit; 8] {
    let e = &judged.evidence;
    [
        Limit { what: "part of its wall brighter than both of its sides", value: e.ridge, at: 0.75, clear: 0.95 },
        Limit { what: "part of the counts' variance that a ventricle's wall explains", value: e.explained, at: 0.75, clear: 0.95 },
        Limit { what: "level of counts in its cavity against its wall", value: e.cavity, at: 0.65, clear: 0.35 },
        Limit { what: "level of counts in its opening against its wall", value: e.opening, at: 0.62, clear: 0.3 },
        Limit {
            what: "height of its widest section over its valve plane against its length",
            value: judged.fit.shell.widest,
            at: 0.47,
            clear: 0.38,
        },
        Limit { what: "level of counts behind its valve plane against its wall", value: e.behind, at: 0.7, clear: 0.4 },
        Limit {
            what: "part of its wall and of its rim at the valve plane that has a wall's counts",
            value: e.whole(),
            at: if judged.fit.shell.elongation() > LONG { LEAST_WHOLE_OF_LONG } else { LEAST_WHOLE },
            clear: 0.75,
        },
        Limit { what: "part of its wall in the field of view", value: e.inside, at: 0.75, clear: 0.92 },
    ]
}

/// How far inside the limits a shell is: 0 on the edge of one, 1 as clear as a phantom without noise in all.
pub(super) fn clearness(judged: &Judged) -> f64 {
    limits(judged).iter().map(|l| ((l.value - l.at) / (l.clear - l.at)).clamp(0.0, 1.0)).fold(1.0, f64::min)
}

/// Why a shell is no ventricle's wall; `None` if it may be one.
pub(super) fn objection(judged: &Judged, open_at_both_ends: bool, pointed_at: bool) -> Option<String> {
    // Somebody who points at the ventricle has seen it: then only what is nothing like a wall is refused.
    let slack = if pointed_at { 2.0 } else { 0.0 };
    let worst = limits(judged)
        .into_iter()
        .map(|l| ((l.value - l.at) / (l.clear - l.at), l))
        .min_by(|a, b| a.0.total_cmp(&b.0))
        .filter(|(margin, _)| *margin < -slack);
    let shell = &judged.fit.shell;
    let explained = judged.evidence.explained;
    let least = if open_at_both_ends { LEAST_EXPLAINED_OF_RINGS } else { LEAST_EXPLAINED_WITHOUT_TIP };
    if !pointed_at && !judged.tip_is_seen() && explained < least {
        return Some(format!(
            "the best candidate has no wall at its apex, and a ventricle's wall explains {:.1} % of the counts' variance about it; of a \
             ventricle with a dark apex it explains at least {:.1} %",
            100.0 * explained,
            100.0 * least
        ));
    }
    if let Some((_, Limit { what, value, at, clear })) = worst {
        let least = if clear > at { "at least" } else { "at most" };
        return Some(format!(
            "of the best candidate, the {what} is {:.0} %; of a ventricle it is {least} {:.0} %",
            100.0 * value,
            100.0 * at
        ));
    }
    let fits = (15.0..=48.0).contains(&shell.radius_mm) && (38.0..=120.0).contains(&shell.length_mm);
    if !(pointed_at || fits) {
        return Some(format!(
            "the best candidate has a radius of {:.0} mm and a length of {:.0} mm at mid-wall; ventricles have 15 to 48 and 38 to 120 mm",
            shell.radius_mm, shell.length_mm
        ));
    }
    None
}
