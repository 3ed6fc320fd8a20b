//! Where the left ventricle lies, in whatever direction the slices cut it.
//!
//! The sum of the gates is searched in stages, each dearer and on fewer candidates than the one before: spherical shells (`shells`),
//! half-ellipsoid walls in all directions (`templates`), a shell of nine parameters fitted to the counts (`shell_fit`), the same from the other
//! end, and the evidence (`judge`). Nothing depends on how the grid's axes run.

mod held;
mod judge;
mod prepare;
mod shape;
mod shell_fit;
mod shell_sums;
mod shells;
mod solve;
mod templates;

use super::{
    PipelineError, Region,
    monitor::{self, Monitor},
    parameters::{PoseMarks, RegionMarks},
    region,
};
use crate::{
    study::{Study, Warning},
    volume::Grid,
};
use glam::DVec3;
use held::Held;
use judge::Judged;
use prepare::Field;
use serde::{Deserialize, Serialize};
use shape::Shell;
use shell_fit::{Density, ShellFit};

/// A pose whose [`PoseConfidence::score`] is below this should be flagged as uncertain: something measured lies within a seventh of the way
/// from its limit to a clear ventricle's value, or the counts hardly tell apex from base. Of phantoms only hearts without a perfused apex
/// and one in twenty with 53 % of the wall lost are below, of the fourteen real studies none (the lowest has .24).
pub const POSE_UNCERTAIN: f64 = 0.15;

/// The ventricle's long axis and width, in grid mm.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Pose {
    /// The tip of the mid-wall surface.
    pub apex_mm: DVec3,
    /// Where the long axis meets the valve plane.
    pub base_mm: DVec3,
    /// The largest radius of the mid-wall surface in mm.
    pub radius_mm: f64,
    /// How sure it is.
    pub confidence: PoseConfidence,
}

/// How sure a pose is, and from what.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct PoseConfidence {
    /// 0 (on the edge of being refused) to 1 (as clear as a phantom without noise): the smallest of the distances of what was measured to
    /// its limit, as part of the way from there to a clear ventricle's value, and of the flip margin as part of eight times that under which the ends are alike, unless they were told.
    pub score: f64,
    /// Part of the perfused mid-wall points that are brighter than both sides of the wall, 0-1.
    pub ridge: f64,
    /// Part of the counts' variance around the ventricle that a half-ellipsoid's shell explains, 0-1.
    pub explained: f64,
    /// How much better the pose fits than the one with apex and base exchanged; 0: not at all.
    pub flip_margin: f64,
    /// Whether an end was told by the request or by the file rather than by the counts.
    pub ends_given: bool,
}

impl Pose {
    /// Unit vector from apex to base.
    pub fn to_base(&self) -> DVec3 {
        (self.base_mm - self.apex_mm).normalize_or(DVec3::Z)
    }

    /// From the mid-wall tip to the valve plane in mm.
    pub fn length_mm(&self) -> f64 {
        self.base_mm.distance(self.apex_mm)
    }

    /// How slices cut the ventricle, if they cut it across: the axis is within 45 degrees of the stack's.
    pub fn region(&self, grid: &Grid) -> Option<Region> {
        let to_base = self.to_base();
        if to_base.z.abs() < std::f64::consts::FRAC_1_SQRT_2 {
            return None;
        }
        let dz = grid.spacing_mm[0];
        let slice = |z: f64| ((z / dz).round().max(0.0) as usize).min(grid.shape[0] - 1) + 1;
        let (low, high) = (self.apex_mm.z.min(self.base_mm.z), self.apex_mm.z.max(self.base_mm.z));
        let first_slice = slice(low + dz / 2.0 - 1e-6);
        let middle = self.apex_mm.midpoint(self.base_mm);
        Some(Region {
            centre_mm: [middle.x, middle.y],
            axis_slope: [to_base.x / to_base.z, to_base.y / to_base.z],
            radius_mm: self.radius_mm + region::CIRCLE_MARGIN_MM,
            first_slice,
            last_slice: slice(high - dz / 2.0 + 1e-6).max(first_slice),
            base_at_last_slice: to_base.z > 0.0,
        })
    }
}

/// Ventricles and marks of them are this long.
const LENGTHS_MM: (f64, f64) = (25.0, 140.0);

/// That the ends that are given lie inside a grid, and, if both are, a ventricle's length apart.
///
/// Errors: [`PipelineError::RegionOutside`] names the mark, its value and the limits.
pub fn check_marks(grid: &Grid, marks: &PoseMarks) -> Result<(), PipelineError> {
    let fail = |why: String| Err(PipelineError::RegionOutside { why });
    let last = grid.position_mm(grid.shape.map(|voxels| voxels - 1));
    for (name, mark) in [("apex_mm", marks.apex_mm), ("base_mm", marks.base_mm)] {
        if let Some(at) = mark {
            // Half a voxel outside the outermost centres is the edge of the image.
            let half = grid.step_mm() / 2.0;
            let point = DVec3::from_array(at);
            if !(point.is_finite() && point.cmpge(-half).all() && point.cmple(last + half).all()) {
                let [x, y, z] = at;
                return fail(format!(
                    "`{name}` is [{x:?}, {y:?}, {z:?}], but the grid reaches from [0, 0, 0] to [{:.1}, {:.1}, {:.1}] mm",
                    last.x, last.y, last.z
                ));
            }
        }
    }
    if let (Some(apex), Some(base)) = (marks.apex_mm, marks.base_mm) {
        let length = DVec3::from_array(apex).distance(DVec3::from_array(base));
        let (least, most) = LENGTHS_MM;
        if !(least..=most).contains(&length) {
            return fail(format!("`apex_mm` and `base_mm` are {length:.1} mm apart; ventricles are {least:.0} to {most:.0} mm long"));
        }
    }
    Ok(())
}

/// Poses that are fitted to all nodes.
const MOST_FINE: usize = 3;
/// Below this flip margin the counts do not tell apex from base.
const ALIKE: f64 = 0.05;
/// The same where no wall is seen at the tip (large apical defects): there margins of up to .54 were wrong.
const ALIKE_WITHOUT_TIP: f64 = 0.6;
/// Below this margin, with no wall at either tip, a ring is taken to be open at both ends: tubes and rings have at most .03, ventricles
/// with 32 % of the wall lost at the apex .02-.11.
const ALIKE_OPEN: f64 = 0.08;

/// Finds the ventricle in the sum of a study's gates; marks that are given win.
///
/// Errors: [`PipelineError::NoLeftVentricle`] says what was looked for and not found, [`PipelineError::RegionOutside`] which mark does not fit.
pub fn find(study: &Study, marks: &PoseMarks, region: &RegionMarks, monitor: &dyn Monitor) -> Result<(Pose, Vec<Warning>), PipelineError> {
    // A single slice has no room for marks, but it may be searched (and refused for what it is).
    if *region != RegionMarks::default() {
        region::check_marks(&study.grid, region)?;
    }
    check_marks(&study.grid, marks)?;
    let held = Held::new(&study.grid, marks, region);
    monitor::check(monitor)?;
    let mut field = Field::of(study).ok_or_else(|| PipelineError::NoLeftVentricle { why: "all counts are zero".into() })?;
    field.restrict(|point| held.allows(point, None));
    monitor::check(monitor)?;
    if held.both_ends().is_some() {
        let pose = between(&field, &held, monitor)?;
        return Ok((pose, Vec::new()));
    }
    let mut found = search(&field, &held, monitor)?;
    if held.radius_mm.is_some() && held.centre_mm.is_none() {
        // The circle lies about the ventricle that was found.
        let centre = found.leader.fit.shell.middle_mm().truncate();
        field.restrict(|point| held.allows(point, Some(centre)));
        if let Some(again) = refined(&field, found.leader.fit, &held, (Density::Half, 2), monitor)? {
            found.leader = again;
        }
    }
    conclude(&found, &held, study)
}

/// The best pose and the best one with its ends exchanged.
struct Found {
    leader: Judged,
    flipped: Option<Judged>,
}

fn search(field: &Field, held: &Held, monitor: &dyn Monitor) -> Result<Found, PipelineError> {
    let fail = |why: &str| PipelineError::NoLeftVentricle { why: why.into() };
    let candidates = candidates(field, held, monitor)?;
    if candidates.is_empty() {
        return Err(fail("there is no shell of 18 to 46 mm radius with a dark inside and a dark outside"));
    }
    let starts = templates::starts(field, &candidates, held, monitor)?;
    let mut coarse = Vec::new();
    for start in &starts {
        if let Some(fit) = shell_fit::fit(field, &start.shell, held, (Density::Quarter, 3), monitor)? {
            coarse.extend(judge::judge(field, &fit, held));
        }
    }
    coarse.sort_by(|a, b| b.score.total_cmp(&a.score));
    let mut leaders: Vec<Judged> = Vec::new();
    for judged in coarse {
        if leaders.len() < MOST_FINE && leaders.iter().all(|other| !templates::alike(&other.fit.shell, &judged.fit.shell)) {
            leaders.push(judged);
        }
    }
    let mut flips = Vec::new();
    if !held.tells_ends() {
        for judged in leaders.iter().take(2) {
            if let Some(fit) = shell_fit::fit(field, &exchanged(&judged.fit.shell), held, (Density::Quarter, 3), monitor)? {
                flips.extend(judge::judge(field, &fit, held));
            }
        }
    }
    let mut fine = Vec::new();
    for judged in leaders.iter().chain(&flips) {
        fine.extend(refined(field, judged.fit, held, (Density::Half, 2), monitor)?);
    }
    fine.sort_by(|a, b| b.score.total_cmp(&a.score));
    let leader = *fine.first().ok_or_else(|| fail("no wall of a ventricle's shape could be fitted to the counts"))?;
    let flipped = fine.iter().find(|other| is_flip(&leader.fit.shell, &other.fit.shell)).copied();
    Ok(Found { leader, flipped })
}

/// Where shells are; marks tell it themselves.
fn candidates(field: &Field, held: &Held, monitor: &dyn Monitor) -> Result<Vec<shells::Candidate>, PipelineError> {
    let everywhere = |points: Vec<DVec3>| {
        let each = |centre_mm: DVec3| shells::RADII_MM.map(|radius_mm| shells::Candidate { centre_mm, radius_mm, correlation: 0.0 });
        points.into_iter().flat_map(each).collect()
    };
    if let Some(mark) = held.apex_mm.or(held.base_mm) {
        return Ok(everywhere(vec![mark]));
    }
    if let Some(centre) = held.centre_mm {
        let (low, high) = (field.origin_mm.z, field.last_mm().z);
        let levels = ((high - low) / 8.0).ceil().max(1.0) as usize;
        let level = |index: usize| centre.extend(low + (high - low) * index as f64 / levels as f64);
        return Ok(everywhere((0..=levels).map(level).collect()));
    }
    shells::candidates(field, monitor)
}

/// The same wall with the valve plane where the tip was.
fn exchanged(shell: &Shell) -> Shell {
    Shell { base_mm: shell.apex_mm(), to_apex: -shell.to_apex, length_mm: shell.length_mm.max(2.1 * shell.radius_mm), ..*shell }
}

/// Whether one shell is about the other with its ends exchanged.
fn is_flip(a: &Shell, b: &Shell) -> bool {
    a.middle_mm().distance(b.middle_mm()) < 30.0 && a.to_apex.dot(b.to_apex) < -0.7
}

fn refined(
    field: &Field,
    fit: ShellFit,
    held: &Held,
    effort: (Density, usize),
    monitor: &dyn Monitor,
) -> Result<Option<Judged>, PipelineError> {
    let fit = shell_fit::fit_from(field, fit, held, effort, monitor)?;
    Ok(fit.and_then(|fit| judge::judge(field, &fit, held)))
}

/// The pose between two given ends: only its width is measured.
fn between(field: &Field, held: &Held, monitor: &dyn Monitor) -> Result<Pose, PipelineError> {
    let guess = Shell { base_mm: DVec3::ZERO, to_apex: DVec3::Z, radius_mm: 27.0, length_mm: 65.0, widest: templates::WIDEST };
    let placed = held.placed(guess);
    let start = Shell { radius_mm: (placed.length_mm / 2.4).clamp(16.0, 45.0), ..placed };
    let judged = refined(field, ShellFit::starting(start), held, (Density::Half, 3), monitor)?
        .ok_or_else(|| PipelineError::NoLeftVentricle { why: "there are no counts between the given apex and base".into() })?;
    Ok(pose(&judged, held, 1.0, true))
}

/// Accepts or refuses, and tells apex from base.
fn conclude(found: &Found, held: &Held, study: &Study) -> Result<(Pose, Vec<Warning>), PipelineError> {
    let Found { leader, flipped } = found;
    // No other end to compare with tells something only where there is a tip.
    let alone = if leader.tip_is_seen() { 1.0 } else { 0.0 };
    let margin = flipped.map_or(alone, |flipped| (leader.score - flipped.score).clamp(0.0, 1.0));
    let open_at_both_ends = flipped.is_some_and(|flipped| margin < ALIKE_OPEN && !leader.tip_is_seen() && !flipped.tip_is_seen());
    if let Some(why) = judge::objection(leader, open_at_both_ends, held.points_at_it()) {
        return Err(PipelineError::NoLeftVentricle { why });
    }
    if held.tells_ends() {
        return Ok((pose(leader, held, 1.0, true), Vec::new()));
    }
    // An apex without wall still has a little uptake; behind the valve plane it is darker.
    let darker = flipped.as_ref().filter(|flipped| {
        margin < ALIKE_WITHOUT_TIP && !leader.tip_is_seen() && !flipped.tip_is_seen() && flipped.evidence.behind < leader.evidence.behind
    });
    let (leader, other) = darker.map_or((leader, flipped.as_ref()), |flipped| (flipped, Some(leader)));
    if margin >= alike(leader) {
        return Ok((pose(leader, held, margin, false), Vec::new()));
    }
    let towards = |judged: &Judged| study.orientation.map_or(0.0, |o| o.direction(judged.fit.shell.to_apex).dot(LEFT_FRONT_FEET));
    // Within about 10 degrees of a right angle the orientation tells nothing either.
    let Some(chosen) = [Some(leader), other].into_iter().flatten().find(|judged| towards(judged) > 0.2) else {
        let warning = "The counts hardly tell the apex from the base, and nothing else in the file does: the ends may be exchanged.";
        return Ok((pose(leader, held, margin, false), vec![Warning::new("apex_and_base_alike", warning)]));
    };
    let warning =
        "The counts hardly tell the apex from the base; the end towards the patient's left, front and feet is taken to be the apex.";
    Ok((pose(chosen, held, margin, true), vec![Warning::new("ends_by_orientation", warning)]))
}

/// The flip margin below which the counts do not tell apex from base. Without a tip the margin says little: half a ventricle's wall looks much
/// the same from both ends.
fn alike(judged: &Judged) -> f64 {
    if judged.tip_is_seen() { ALIKE } else { ALIKE_WITHOUT_TIP }
}

/// Where the apex points in the patient (LPS).
const LEFT_FRONT_FEET: DVec3 = DVec3::new(0.577_350_269, -0.577_350_269, -0.577_350_269);

fn pose(judged: &Judged, held: &Held, flip_margin: f64, ends_given: bool) -> Pose {
    let shell = &judged.fit.shell;
    // Below the margin under which the ends are alike this is under an eighth, which is always uncertain.
    let sure_of_ends = if ends_given { 1.0 } else { (flip_margin / (8.0 * alike(judged))).clamp(0.0, 1.0) };
    Pose {
        apex_mm: held.apex_mm.unwrap_or(shell.apex_mm()),
        base_mm: held.base_mm.unwrap_or(shell.base_mm),
        radius_mm: shell.radius_mm,
        confidence: PoseConfidence {
            score: judge::clearness(judged).min(sure_of_ends),
            ridge: judged.evidence.ridge,
            explained: judged.evidence.explained,
            flip_margin,
            ends_given,
        },
    }
}
