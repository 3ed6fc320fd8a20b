//! Activity at a point: wall with its uptake and defects, blood, right ventricle, liver.
//!
//! Everything is relative to a wall of normal uptake, 1.

use super::decoy::{Decoy, Part};
use super::pose::Warp;
use super::regional::Borders;
use super::shape::{Shape, Surfaces};
use super::solid::Solid;
use super::{Phantom, pose::Pose};
use crate::volume::Grid;
use glam::{DMat3, DVec2, DVec3};
use serde::{Deserialize, Serialize};
use std::f64::consts::{PI, TAU};

/// What the tissues take up, as fractions of a normal wall.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Uptake {
    /// Everywhere outside the organs. 0.05-0.15 in perfusion studies.
    pub background: f64,
    /// In the cavities.
    pub blood_pool: f64,
    /// How far normal uptake varies over the wall: the least-taking part (septal, inferior, apical) has `1 − nonuniformity`.
    pub nonuniformity: f64,
    /// Perfusion defects; where several overlap their severities multiply.
    pub defects: Vec<Defect>,
    /// Uptake of the right ventricle's wall; 0: there is none. About 0.3 at rest.
    pub right_ventricle: f64,
    /// A liver under the inferior wall.
    pub liver: Option<Liver>,
}

impl Default for Uptake {
    fn default() -> Self {
        Self { background: 0.08, blood_pool: 0.12, nonuniformity: 0.0, defects: Vec::new(), right_ventricle: 0.0, liver: None }
    }
}

/// A part of the wall that takes up less.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Defect {
    /// Where it is.
    pub site: Site,
    /// Its share of the wall's volume, in `[0, 1]`, exact at every gate: an apical defect ends at the height that cuts off this share, the
    /// others are sectors from apex to base. Of a wall with [`super::Regional`] parts it is the share that it would be without them.
    pub extent: f64,
    /// Share of the uptake that is lost, in `[0, 1]`.
    pub severity: f64,
}

/// Where a defect lies.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Site {
    /// The tip.
    Apical,
    /// The wall towards row 0.
    Anterior,
    /// The wall towards the last row.
    Inferior,
    /// The wall towards column 0.
    Septal,
    /// The wall towards the last column.
    Lateral,
}

/// A ball of activity under the inferior wall.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Liver {
    /// Gap to the inferior wall's widest level at end diastole, in mm (of the undeformed shape).
    pub gap_mm: f64,
    /// Uptake as a fraction of the wall's; over 1 for a hot liver.
    pub uptake: f64,
}

/// Radius in mm of the ball that stands for the near lobe of the liver.
const LIVER_RADIUS_MM: f64 = 50.0;
/// Thickness in mm of the right ventricle's wall; 3-4 mm in adults.
const RIGHT_WALL_MM: f64 = 4.0;

/// The scene at one instant.
#[derive(Debug, Clone)]
pub(super) struct Scene {
    background: f64,
    ventricle: Option<LeftVentricle>,
    /// Something else in its place, and the blood in its hollow.
    decoy: Option<(Decoy, f64)>,
    liver: Option<(DVec3, f64)>,
    to_local: DMat3,
    centre_mm: DVec3,
}

#[derive(Debug, Clone)]
struct LeftVentricle {
    borders: Borders,
    warp: Warp,
    /// Greatest distance from the axis of anything of either ventricle, canonical, in mm.
    reach_mm: f64,
    blood: f64,
    nonuniformity: f64,
    /// Where, and the share of uptake that remains there.
    defects: Vec<(Territory, f64)>,
    right: Option<RightVentricle>,
}

/// A defect's region at one instant.
#[derive(Debug, Clone, Copy)]
enum Territory {
    BelowHeight { w_mm: f64 },
    Sector { centre: f64, half_angle: f64 },
}

/// A half ellipsoid on the septum, hollow, with its uptake.
#[derive(Debug, Clone, Copy)]
struct RightVentricle {
    centre: DVec3,
    semi_axes: DVec3,
    uptake: f64,
}

/// What a point belongs to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Tissue {
    Wall,
    Cavity,
    Outside,
}

impl Scene {
    /// The phantom at a phase of the cycle.
    pub(super) fn at_phase(phantom: &Phantom, phase: f64) -> Self {
        let uptake = &phantom.uptake;
        let end_diastole = phantom.shape.surfaces(0.0);
        let ventricle = Borders::at_phase(phantom, phase).zip(end_diastole).map(|(borders, end_diastole)| {
            let surfaces = borders.surfaces;
            let right = (uptake.right_ventricle > 0.0).then(|| RightVentricle::beside(&surfaces.epicardium, uptake.right_ventricle));
            LeftVentricle {
                warp: Warp::new(phantom.deformation, end_diastole.epicardium.base_w_mm()),
                reach_mm: right.map_or(0.0, |right| right.reach_mm().length()).max(borders.reach_mm()),
                borders,
                blood: uptake.blood_pool,
                nonuniformity: uptake.nonuniformity,
                defects: uptake.defects.iter().map(|defect| (Territory::of(defect, &surfaces), 1.0 - defect.severity)).collect(),
                right,
            }
        });
        let liver = uptake.liver.map(|liver| {
            // Without a ventricle the liver lies where it would under the paper's object.
            let above = end_diastole.map_or((35.0, 0.0), |ed| (ed.epicardium.widest_radius_mm(), ed.epicardium.widest_w_mm()));
            (DVec3::new(0.0, above.0 + liver.gap_mm + LIVER_RADIUS_MM, above.1), liver.uptake)
        });
        let decoy = match phantom.shape {
            Shape::Decoy(decoy) => Some((decoy, uptake.blood_pool)),
            _ => None,
        };
        let to_local = phantom.pose.rotation().transpose();
        Self {
            background: uptake.background,
            ventricle,
            decoy,
            liver,
            to_local,
            centre_mm: centre_mm(&phantom.imaging.grid, &phantom.pose),
        }
    }

    /// Activity over the background at a point in grid mm (slice 0 apical).
    pub(super) fn excess(&self, point_mm: DVec3) -> f64 {
        let local = self.to_local * (point_mm - self.centre_mm);
        if let Some(activity) = self.ventricle.as_ref().and_then(|ventricle| ventricle.activity(local)) {
            return activity - self.background;
        }
        if let Some((decoy, blood)) = self.decoy
            && let Some(part) = decoy.part(local)
        {
            return if part == Part::Body { 1.0 } else { blood } - self.background;
        }
        match self.liver {
            Some((centre, uptake)) if local.distance_squared(centre) < LIVER_RADIUS_MM * LIVER_RADIUS_MM => uptake - self.background,
            _ => 0.0,
        }
    }

    /// What a point in grid mm (slice 0 apical) belongs to.
    pub(super) fn tissue(&self, point_mm: DVec3) -> Tissue {
        let local = self.to_local * (point_mm - self.centre_mm);
        self.ventricle.as_ref().map_or(Tissue::Outside, |ventricle| ventricle.tissue(ventricle.warp.undo(local)))
    }

    /// What the wall takes up at a point in canonical coordinates; 0 without a ventricle.
    pub(super) fn wall_uptake(&self, canonical: DVec3) -> f64 {
        self.ventricle.as_ref().map_or(0.0, |ventricle| ventricle.wall_uptake(canonical))
    }

    /// A box `(low, high)` in grid mm outside which the excess is zero; `None` when it is zero everywhere.
    pub(super) fn bounds_mm(&self) -> Option<(DVec3, DVec3)> {
        let heart = self.ventricle.as_ref().map(LeftVentricle::bounds);
        let liver = self.liver.map(|(centre, _)| (centre - LIVER_RADIUS_MM, centre + LIVER_RADIUS_MM));
        let decoy = self.decoy.map(|(decoy, _)| (-decoy.reach_mm(), decoy.reach_mm()));
        [heart, decoy, liver]
            .into_iter()
            .flatten()
            .map(|(low, high)| {
                let (middle, half) = ((low + high) / 2.0, (high - low) / 2.0);
                let rotation = self.to_local.transpose();
                let reach = rotation.x_axis.abs() * half.x + rotation.y_axis.abs() * half.y + rotation.z_axis.abs() * half.z;
                let centre = self.centre_mm + rotation * middle;
                (centre - reach, centre + reach)
            })
            .reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)))
    }

    /// Epicardial tip and centre of the valve plane in grid mm (slice 0 apical).
    pub(super) fn landmarks_mm(&self) -> Option<(DVec3, DVec3)> {
        let ventricle = self.ventricle.as_ref()?;
        let place = |w: f64| self.centre_mm + self.to_local.transpose() * ventricle.warp.apply(DVec3::new(0.0, 0.0, w));
        let epicardium = &ventricle.borders.surfaces.epicardium;
        Some((place(epicardium.tip_w_mm()), place(epicardium.base_w_mm())))
    }

    /// Whether the outer surface lies within the voxels of the grid (true without a ventricle); 48 × 48 points are tried.
    pub(super) fn ventricle_is_within(&self, grid: &Grid) -> bool {
        let Some(ventricle) = &self.ventricle else { return true };
        let epicardium = &ventricle.borders.surfaces.epicardium;
        let (tip, base) = (epicardium.tip_w_mm(), epicardium.base_w_mm());
        (0..48 * 48).all(|point| {
            // Just below the valve plane, where the profile still has its radius.
            let w = tip + (base - tip) * f64::from(point / 48) / 47.0 * (1.0 - 1e-9);
            let angle = TAU * f64::from(point % 48) / 48.0;
            let radius = ventricle.borders.outer_squared_mm2(|| angle, w).max(0.0).sqrt();
            let (sine, cosine) = angle.sin_cos();
            let local = ventricle.warp.apply(DVec3::new(radius * cosine, radius * sine, w));
            grid.voxel_at(self.centre_mm + self.to_local.transpose() * local).is_some()
        })
    }
}

/// The middle of the ventricle in grid mm (slice 0 apical).
pub(super) fn centre_mm(grid: &Grid, pose: &Pose) -> DVec3 {
    let last = DVec3::new((grid.shape[2] - 1) as f64, (grid.shape[1] - 1) as f64, (grid.shape[0] - 1) as f64);
    last * grid.step_mm() / 2.0 + DVec3::from_array(pose.offset_mm)
}

impl LeftVentricle {
    fn tissue(&self, canonical: DVec3) -> Tissue {
        let radius_squared = canonical.x * canonical.x + canonical.y * canonical.y;
        let angle = || canonical.y.atan2(canonical.x);
        if radius_squared >= self.borders.outer_squared_mm2(angle, canonical.z) {
            Tissue::Outside
        } else if radius_squared >= self.borders.inner_squared_mm2(angle, canonical.z) {
            Tissue::Wall
        } else {
            Tissue::Cavity
        }
    }

    /// Activity at a local point, `None` outside both ventricles.
    fn activity(&self, local: DVec3) -> Option<f64> {
        let canonical = self.warp.undo_near(local, self.reach_mm)?;
        match self.tissue(canonical) {
            Tissue::Wall => Some(self.wall_uptake(canonical)),
            Tissue::Cavity => Some(self.blood),
            Tissue::Outside if canonical.z >= self.borders.surfaces.epicardium.base_w_mm() => None,
            Tissue::Outside => self.right.and_then(|right| right.activity(canonical, self.blood)),
        }
    }

    fn wall_uptake(&self, canonical: DVec3) -> f64 {
        if self.nonuniformity == 0.0 && self.defects.is_empty() {
            return 1.0;
        }
        // Angle from the lateral towards the inferior wall.
        let angle = canonical.y.atan2(canonical.x);
        let septal = f64::midpoint(1.0, -angle.cos());
        let inferior = f64::midpoint(1.0, angle.sin());
        let apical = (-(canonical.z - self.borders.surfaces.epicardium.tip_w_mm()) / 15.0).exp();
        let normal = 1.0 - self.nonuniformity * (0.5 * septal + 0.3 * inferior + 0.2 * apical);
        let in_defect = |territory: &Territory| match *territory {
            Territory::BelowHeight { w_mm } => canonical.z < w_mm,
            Territory::Sector { centre, half_angle } => ((angle - centre + PI).rem_euclid(TAU) - PI).abs() < half_angle,
        };
        self.defects.iter().filter(|(territory, _)| in_defect(territory)).fold(normal, |uptake, (_, kept)| uptake * kept)
    }

    /// A box `(low, high)` in local coordinates that holds both ventricles.
    fn bounds(&self) -> (DVec3, DVec3) {
        let epicardium: &Solid = &self.borders.surfaces.epicardium;
        let radius = self.borders.reach_mm();
        let reach = self.right.map_or(DVec2::ZERO, |right| right.reach_mm()).max(DVec2::splat(radius));
        let height = epicardium.tip_w_mm().abs().max(epicardium.base_w_mm().abs());
        let bound = self.warp.bound(reach.extend(height));
        (-bound, bound)
    }
}

impl Territory {
    fn of(defect: &Defect, surfaces: &Surfaces) -> Self {
        let sector = |centre: f64| Self::Sector { centre, half_angle: PI * defect.extent };
        match defect.site {
            Site::Lateral => sector(0.0),
            Site::Inferior => sector(PI / 2.0),
            Site::Septal => sector(PI),
            Site::Anterior => sector(-PI / 2.0),
            Site::Apical => Self::BelowHeight { w_mm: height_below_which(defect.extent, surfaces) },
        }
    }
}

/// The height below which the wall holds a share of its volume, by bisection of the closed form.
fn height_below_which(share: f64, surfaces: &Surfaces) -> f64 {
    let wall_below = |w: f64| surfaces.epicardium.volume_below_mm3(w) - surfaces.endocardium.volume_below_mm3(w);
    let (mut low, mut high) = (surfaces.epicardium.tip_w_mm(), surfaces.epicardium.base_w_mm());
    let wanted = share * wall_below(high);
    for _ in 0..80 {
        let middle = f64::midpoint(low, high);
        if wall_below(middle) < wanted {
            low = middle;
        } else {
            high = middle;
        }
    }
    f64::midpoint(low, high)
}

impl RightVentricle {
    /// The right ventricle beside a left one: a crescent around the septum that ends at the same valve plane.
    fn beside(epicardium: &Solid, uptake: f64) -> Self {
        let radius = epicardium.widest_radius_mm();
        let length = epicardium.base_w_mm() - epicardium.tip_w_mm();
        let centre = DVec3::new(-0.75 * radius, 0.15 * radius, epicardium.base_w_mm() - 0.1 * length);
        Self { centre, semi_axes: DVec3::new(radius, 1.1 * radius, 0.75 * length), uptake }
    }

    /// Farthest reach from the long axis along x and along y, in mm.
    fn reach_mm(&self) -> DVec2 {
        DVec2::new(self.semi_axes.x + self.centre.x.abs(), self.semi_axes.y + self.centre.y.abs())
    }

    fn activity(&self, canonical: DVec3, blood: f64) -> Option<f64> {
        let from_centre = canonical - self.centre;
        if (from_centre / self.semi_axes).length_squared() >= 1.0 {
            return None;
        }
        let in_cavity = (from_centre / (self.semi_axes - RIGHT_WALL_MM)).length_squared() < 1.0;
        Some(if in_cavity { blood } else { self.uptake })
    }
}

impl Shape {
    /// Whether there is a ventricle.
    pub fn is_ventricle(&self) -> bool {
        !matches!(self, Self::Decoy(_) | Self::Empty)
    }
}
