//! Simulated gated studies whose volumes are known exactly.
//!
//! A [`Phantom`] is a shape with closed-form volumes ([`shape`], [`solid`]), parts of whose wall may contract otherwise ([`Regional`]), placed and
//! deformed without changing them ([`pose`]), given uptake and surroundings ([`anatomy`]) and seen by a camera ([`camera`], Poisson noise). [`simulate`] makes a [`Study`] and the
//! [`Truth`] from it; [`dicom`] and [`nifti`] write studies as files. The same phantom gives the same study, bit by bit, with the same UIDs.
//!
//! Every gate is the curve of [`cycle`] sampled at the gate's centre (or averaged over several phases of the gate, see
//! [`Imaging::motion_samples`]). Eight gates therefore turn a continuous ejection fraction of .60 into .565, sixteen into .595: the
//! truth to score against is the gates' own.

pub mod anatomy;
pub mod camera;
mod check;
pub mod cycle;
mod decoy;
pub mod dicom;
mod erf;
mod exact;
mod identity;
pub mod nifti;
mod noise;
pub mod pose;
mod presets;
mod regional;
pub mod shape;
pub mod solid;
mod truth;

pub use anatomy::{Defect, Liver, Site, Uptake};
pub use camera::{Psf, Tail};
pub use decoy::Decoy;
pub use exact::ExactSurfaces;
pub use pose::{Deformation, Pose};
pub use regional::Regional;
pub use shape::{Cylinder, Shape, Ventricle};
pub use truth::{GateTruth, Truth};

use crate::study::{Acquisition, Format, Gate, Orientation, Study};
use crate::volume::{Grid, Volume};
use anatomy::{Scene, Tissue};
use glam::DVec3;
use ndarray::{Array3, Axis};
use serde::{Deserialize, Serialize};

/// Everything that decides a simulated study.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Phantom {
    /// What stands in the volume.
    pub shape: Shape,
    /// Where it stands.
    pub pose: Pose,
    /// How it departs from a solid of revolution, at the same volume.
    pub deformation: Deformation,
    /// Activity of wall and surroundings.
    pub uptake: Uptake,
    /// Grid, gates, blur and noise.
    pub imaging: Imaging,
    /// Parts of a beating ventricle's wall with a function of their own. None (the default): all of it beats alike.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub regional: Vec<Regional>,
}

/// How the phantom is seen.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Imaging {
    /// The lattice. Its z axis is the nominal long axis.
    pub grid: Grid,
    /// Gates of the cycle; 1 is an ungated study at the first gate's centre unless `motion_samples` averages the cycle.
    pub gates: usize,
    /// The point-spread function.
    pub psf: Psf,
    /// Largest expected count of a voxel whose centre is in the wall, over all gates (of a wall-like voxel in an empty phantom).
    pub counts: f64,
    /// Seed of the Poisson noise; `None`: expected counts, not rounded.
    pub noise_seed: Option<u64>,
    /// Voxels farther than this from the grid's axis, in the plane of the slices, are zero, as after a vendor's reorientation.
    pub field_of_view_mm: Option<f64>,
    /// Least number of samples along each side of a voxel; finer where 1 mm asks for it (see [`camera`]).
    pub supersampling: usize,
    /// Phases averaged within a gate. 1: a still heart at the gate's centre. More: the blur of motion; the truth is then the mean volume.
    pub motion_samples: usize,
    /// Counts of the last gate against the others: beats of uneven length leave it short. 1: none lost; clinical studies .65-.95.
    pub last_gate_fraction: f64,
    /// Mean R-R interval in ms.
    pub rr_interval_ms: f64,
    /// Whether the study says where it lies in the patient (a usual oblique short-axis orientation).
    pub oriented: bool,
}

impl Imaging {
    /// The paper's grid: 64 × 64 × 24 voxels of 2.87 × 2.87 × 5.74 mm (§7.5).
    pub const PAPER_GRID: Grid = Grid { shape: [24, 64, 64], spacing_mm: [5.74, 2.87, 2.87] };
}

impl Default for Imaging {
    /// Eight gates on the paper's grid, 10 mm PSF, noise at 150 counts in the brightest wall voxel, 72 beats a minute.
    fn default() -> Self {
        Self {
            grid: Self::PAPER_GRID,
            gates: 8,
            psf: Psf::gaussian(10.0),
            counts: 150.0,
            noise_seed: Some(1),
            field_of_view_mm: None,
            supersampling: 3,
            motion_samples: 1,
            last_gate_fraction: 1.0,
            rr_interval_ms: 833.0,
            oriented: true,
        }
    }
}

/// Beats of a simulated acquisition, of which none is rejected.
const BEATS: u64 = 1000;
/// Its acceptance window, as parts of the R-R interval.
const WINDOW: [f64; 2] = [0.8, 1.2];

/// A simulated study and what is true of it.
#[derive(Debug, Clone, PartialEq)]
pub struct Simulation {
    /// What a camera would have delivered.
    pub study: Study,
    /// What it was made from.
    pub truth: Truth,
}

/// Why a phantom cannot be made or written.
#[derive(Debug, thiserror::Error)]
pub enum PhantomError {
    /// A parameter is out of range.
    #[error("the phantom's {what} is {got}; it must be {wanted}")]
    Invalid {
        /// The parameter.
        what: &'static str,
        /// Its value.
        got: String,
        /// The range.
        wanted: String,
    },
    /// DICOM requires the duration of gates, and the study has none.
    #[error("the study is gated but says no gate duration, which DICOM requires; give its gates a duration")]
    NoGateDuration,
    /// The DICOM library refused.
    #[error("the study could not be written as DICOM: {0}")]
    Dicom(#[source] Box<dyn std::error::Error + Send + Sync>),
}

/// Makes the study and its truth.
///
/// Errors: [`PhantomError::Invalid`] names the first parameter that is out of range.
pub fn simulate(phantom: &Phantom) -> Result<Simulation, PhantomError> {
    check::check(phantom)?;
    let imaging = &phantom.imaging;
    let scenes: Vec<Vec<Scene>> = (0..imaging.gates)
        .map(|gate| cycle::gate_phases(gate, imaging.gates, imaging.motion_samples).map(|phase| Scene::at_phase(phantom, phase)).collect())
        .collect();
    let mut images: Vec<Array3<f64>> = scenes.iter().map(|phases| expected_activity(phantom, phases)).collect();
    let brightest = images.iter().zip(&scenes).map(|(image, phases)| brightest_in_wall(image, &imaging.grid, phases)).fold(0.0, f64::max);
    let scale = if brightest > 0.0 { imaging.counts / brightest } else { imaging.counts };
    if let Some(last) = images.last_mut() {
        *last *= imaging.last_gate_fraction;
    }
    let duration_ms = imaging.rr_interval_ms / imaging.gates as f64;
    let gates = images
        .into_iter()
        .enumerate()
        .map(|(gate, image)| Gate { volume: counts(image * scale, gate, phantom), duration_ms: Some(duration_ms) })
        .collect();
    let (study_uid, series_uid, instance_uid) = identity::uids_of(phantom);
    let gated = imaging.gates > 1;
    let study = Study {
        grid: imaging.grid,
        gates,
        orientation: imaging.oriented.then(|| short_axis_orientation(&imaging.grid, phantom.pose.reversed)),
        acquisition: Acquisition {
            study_instance_uid: Some(study_uid),
            series_instance_uid: Some(series_uid),
            sop_instance_uids: vec![instance_uid],
            rr_interval_ms: Some(imaging.rr_interval_ms),
            heart_rate_bpm: Some((60_000.0 / imaging.rr_interval_ms).round()),
            beats_accepted: gated.then_some(BEATS),
            beats_rejected: gated.then_some(0),
            rr_window_ms: gated.then(|| WINDOW.map(|part| (part * imaging.rr_interval_ms).round())),
            beat_rejection: gated.then_some(true),
            ..Acquisition::unknown(Format::Phantom)
        },
        warnings: Vec::new(),
    };
    Ok(Simulation { study, truth: truth::of(phantom) })
}

/// What is true of a study, without making it.
///
/// Errors: as [`simulate`].
pub fn truth(phantom: &Phantom) -> Result<Truth, PhantomError> {
    check::check(phantom)?;
    Ok(truth::of(phantom))
}

/// The blurred activity of one gate, relative to a normal wall, slice 0 apical.
fn expected_activity(phantom: &Phantom, phases: &[Scene]) -> Array3<f64> {
    let imaging = &phantom.imaging;
    let mut image = Array3::from_elem(imaging.grid.shape, phantom.uptake.background);
    for scene in phases {
        if let Some(bounds_mm) = scene.bounds_mm() {
            let weight = 1.0 / phases.len() as f64;
            let camera = (&imaging.psf, imaging.supersampling);
            camera::expose(&mut image, &imaging.grid, camera, bounds_mm, weight, |point| scene.excess(point));
        }
    }
    image
}

/// The largest value of a voxel whose centre lies in the wall; 0 without a wall.
fn brightest_in_wall(image: &Array3<f64>, grid: &Grid, phases: &[Scene]) -> f64 {
    let in_wall = |voxel| phases.iter().any(|scene| scene.tissue(grid.position_mm(voxel)) == Tissue::Wall);
    image.indexed_iter().filter(|&((z, y, x), _)| in_wall([z, y, x])).map(|(_, &value)| value).fold(0.0, f64::max)
}

/// Expected counts → counts: noise, the field of view, the order of slices.
fn counts(expected: Array3<f64>, gate: usize, phantom: &Phantom) -> Volume {
    let imaging = &phantom.imaging;
    let mut counts = match imaging.noise_seed {
        None => expected,
        Some(seed) => {
            let mut random = noise::stream(seed, gate);
            expected.mapv_into(|mean| noise::poisson(&mut random, mean))
        }
    };
    if let Some(radius_mm) = imaging.field_of_view_mm {
        let [_, ny, nx] = imaging.grid.shape;
        let [_, step_y, step_x] = imaging.grid.spacing_mm;
        for ((_, y, x), count) in counts.indexed_iter_mut() {
            let from_axis = |index: usize, voxels: usize, step: f64| (index as f64 - (voxels - 1) as f64 / 2.0) * step;
            if from_axis(x, nx, step_x).hypot(from_axis(y, ny, step_y)) > radius_mm {
                *count = 0.0;
            }
        }
    }
    if phantom.pose.reversed {
        counts.invert_axis(Axis(0));
    }
    Volume { grid: imaging.grid, counts: counts.mapv(|count| count as f32).as_standard_layout().into_owned() }
}

/// A usual short-axis orientation: the apex to the left, front and feet; columns run to the lateral, rows to the inferior wall.
///
/// The grid's middle lies at a usual place of the heart, to the left of and before the middle of the body.
fn short_axis_orientation(grid: &Grid, reversed: bool) -> Orientation {
    // Towards the base: right, back, head. 45° to the left of the sagittal plane, 30° below the horizontal one.
    let to_base = DVec3::new(-0.6124, 0.6124, 0.5).normalize();
    let feet = DVec3::NEG_Z;
    let rows = (feet - to_base * feet.dot(to_base)).normalize();
    let columns = rows.cross(to_base);
    let slices = if reversed { -to_base } else { to_base };
    let last = DVec3::new((grid.shape[2] - 1) as f64, (grid.shape[1] - 1) as f64, (grid.shape[0] - 1) as f64) * grid.step_mm();
    let middle_mm = DVec3::new(45.0, -40.0, 20.0);
    let origin_mm = middle_mm - (columns * last.x + rows * last.y + slices * last.z) / 2.0;
    Orientation { columns, rows, slices, origin_mm }
}
