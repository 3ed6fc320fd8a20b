//! The published family: simulated studies whose truth is known, the same on every machine.
//!
//! A study is a family, a number within it and what the seed of the two draws. Every study draws its own size, ejection fraction, wall, elongation, shortening,
//! blur, noise and place, so that no two hearts are the same shape; a family adds the one thing it is about.

use super::draw::Draw;
use crate::{
    phantom::{Defect, Deformation, Imaging, Liver, Phantom, Pose, Psf, Shape, Site, Tail, Uptake, Ventricle},
    study::{Orientation, Study},
    volume::Grid,
};
use glam::DVec3;
use std::f64::consts::FRAC_1_SQRT_2;

/// How studies are scored together.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Group {
    /// A ventricle whose wall takes up evenly or nearly so.
    NoDefect,
    /// A ventricle with perfusion defects.
    Defect,
    /// A small, hyperdynamic ventricle.
    Small,
    /// No left ventricle: to be refused.
    Negative,
}

impl Group {
    /// All groups, as the tables list them.
    pub const ALL: [Self; 4] = [Self::NoDefect, Self::Defect, Self::Small, Self::Negative];

    /// The name in tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::NoDefect => "no defect",
            Self::Defect => "defect",
            Self::Small => "small",
            Self::Negative => "negative",
        }
    }
}

/// One study of the published family.
#[derive(Debug, Clone)]
pub struct Member {
    /// Family and number, as `liver 4 mm #3`.
    pub name: String,
    /// What it is about.
    pub family: &'static str,
    /// How it is scored.
    pub group: Group,
    /// What is simulated.
    pub phantom: Phantom,
    /// Where the grid lies in the patient, where that is not a usual short-axis stack.
    pub orientation: Option<Orientation>,
}

impl Member {
    /// The study as it is given to the pipeline: simulated, with the orientation of this member.
    pub fn dressed(&self, study: Study) -> Study {
        Study { orientation: self.orientation.or(study.orientation), ..study }
    }
}

/// A family: its label, group, number of studies, and what it is about.
pub struct Family {
    /// The label.
    pub name: &'static str,
    /// How its studies are scored.
    pub group: Group,
    /// How many studies it has.
    pub studies: usize,
    /// What it is about, for the document.
    pub about: &'static str,
    make: fn(&mut Draw, usize) -> Phantom,
}

/// Grids of isotropic voxels: 4 mm, as reconstructions of small pixels have, and 6.4 mm, the usual clinical pixel.
const ISOTROPIC_4: Grid = Grid { shape: [36, 48, 48], spacing_mm: [4.0; 3] };
const ISOTROPIC_6_4: Grid = Grid { shape: [24, 32, 32], spacing_mm: [6.4; 3] };
/// A transaxial or oblique volume: cubic, so that a ventricle in any direction fits.
const CUBE_4: Grid = Grid { shape: [44, 44, 44], spacing_mm: [4.0; 3] };

/// Transaxial slices from feet to head. Rows and columns lie at 45° to the patient's sides, because a phantom turns about two axes only.
const TRANSAXIAL: Orientation = Orientation {
    columns: DVec3::new(FRAC_1_SQRT_2, FRAC_1_SQRT_2, 0.0),
    rows: DVec3::new(-FRAC_1_SQRT_2, FRAC_1_SQRT_2, 0.0),
    slices: DVec3::Z,
    origin_mm: DVec3::new(45.0, -160.0, -65.0),
};

/// All families.
pub const FAMILIES: &[Family] = &[
    Family {
        name: "normal",
        group: Group::NoDefect,
        studies: 10,
        about: "EDV 80-160 ml, EF .50-.72",
        make: |draw, _| seen(normal(draw), draw),
    },
    Family {
        name: "dilated",
        group: Group::NoDefect,
        studies: 10,
        about: "EDV 170-280 ml, EF .25-.45, rounder",
        make: |draw, _| seen(dilated(draw), draw),
    },
    Family { name: "bent", group: Group::NoDefect, studies: 6, about: "the axis bent by 5-11 mm", make: |draw, _| bent(draw) },
    Family {
        name: "twisted",
        group: Group::NoDefect,
        studies: 6,
        about: "oval by 10-25 %, turning by 30-70° from apex to base",
        make: |draw, _| twisted(draw),
    },
    Family {
        name: "base tilted",
        group: Group::NoDefect,
        studies: 8,
        about: "the septal wall ends before the lateral one: valve plane at 5-16°",
        make: |draw, _| base_tilted(draw),
    },
    Family {
        name: "uneven uptake",
        group: Group::NoDefect,
        studies: 6,
        about: "15-35 % less uptake in septum, inferior wall and apex",
        make: |draw, _| uneven(draw),
    },
    Family {
        name: "background",
        group: Group::NoDefect,
        studies: 8,
        about: "background 5-15 % of the wall, blood 5-30 %",
        make: |draw, _| background(draw),
    },
    Family {
        name: "liver 10 mm",
        group: Group::NoDefect,
        studies: 7,
        about: "a liver of .5-1.5 of the wall's uptake 10 mm under the inferior wall",
        make: |draw, _| liver(draw, 10.0),
    },
    Family { name: "liver 4 mm", group: Group::NoDefect, studies: 7, about: "the same 4 mm under it", make: |draw, _| liver(draw, 4.0) },
    Family {
        name: "right ventricle",
        group: Group::NoDefect,
        studies: 6,
        about: "a right ventricle of .2-.6 of the wall's uptake",
        make: |draw, _| right_ventricle(draw),
    },
    Family {
        name: "displaced",
        group: Group::NoDefect,
        studies: 7,
        about: "tilted by up to 20° about two axes and 10-25 mm off the centre",
        make: |draw, _| displaced(draw),
    },
    Family { name: "reversed", group: Group::NoDefect, studies: 4, about: "base at the first slice", make: |draw, _| reversed(draw) },
    Family {
        name: "masked",
        group: Group::NoDefect,
        studies: 6,
        about: "zero outside a circle 6-14 mm from the wall",
        make: |draw, _| masked(draw),
    },
    Family {
        name: "last gate short",
        group: Group::NoDefect,
        studies: 5,
        about: "the last gate holds .60-.90 of the counts",
        make: |draw, _| short_gate(draw),
    },
    Family {
        name: "4 mm voxels",
        group: Group::NoDefect,
        studies: 6,
        about: "48 × 48 × 36 of 4 mm",
        make: |draw, _| on_grid(draw, ISOTROPIC_4),
    },
    Family {
        name: "6.4 mm voxels",
        group: Group::NoDefect,
        studies: 6,
        about: "32 × 32 × 24 of 6.4 mm",
        make: |draw, _| on_grid(draw, ISOTROPIC_6_4),
    },
    Family {
        name: "16 gates",
        group: Group::NoDefect,
        studies: 5,
        about: "16 gates at half the counts each",
        make: |draw, _| sixteen_gates(draw),
    },
    Family {
        name: "few counts",
        group: Group::NoDefect,
        studies: 6,
        about: "30-60 counts in the brightest wall voxel",
        make: |draw, _| few_counts(draw),
    },
    Family { name: "motion", group: Group::NoDefect, studies: 6, about: "each gate the mean of six phases", make: |draw, _| motion(draw) },
    Family {
        name: "tailed PSF",
        group: Group::NoDefect,
        studies: 6,
        about: "15-30 % of the counts in a Gaussian of 20-30 mm under the main one",
        make: |draw, _| tailed(draw),
    },
    Family {
        name: "growing PSF",
        group: Group::NoDefect,
        studies: 6,
        about: "FWHM grows by .03-.06 mm a mm along the rows: 2-4 mm over the heart",
        make: |draw, _| growing(draw),
    },
    Family {
        name: "oblique",
        group: Group::NoDefect,
        studies: 7,
        about: "4 mm voxels, any direction, orientation unknown to the file",
        make: oblique,
    },
    Family {
        name: "transaxial",
        group: Group::NoDefect,
        studies: 6,
        about: "4 mm voxels, transaxial slices, orientation told",
        make: |draw, _| transaxial(draw),
    },
    Family {
        name: "long axis",
        group: Group::NoDefect,
        studies: 4,
        about: "the paper's voxels, slices along the long axis, orientation unknown",
        make: long_axis,
    },
    Family {
        name: "clinic",
        group: Group::NoDefect,
        studies: 10,
        about: "everything at once: tilted, bent, oval, tilted base, uneven uptake, right ventricle, liver, motion, tailed growing PSF, short gate",
        make: |draw, _| clinic(draw),
    },
    Family { name: "small", group: Group::Small, studies: 12, about: "EDV 45-60 ml, EF .70-.80", make: |draw, _| seen(small(draw), draw) },
    Family {
        name: "small, clinic",
        group: Group::Small,
        studies: 4,
        about: "the same seen as `clinic`",
        make: |draw, _| small_clinic(draw),
    },
    Family {
        name: "defect 10 %",
        group: Group::Defect,
        studies: 15,
        about: "10 % of the wall: apical, anterior, inferior, septal, lateral; 50-90 % of the uptake lost",
        make: |draw, number| defect(draw, number, 0.10),
    },
    Family { name: "defect 32 %", group: Group::Defect, studies: 15, about: "32 % of it", make: |draw, number| defect(draw, number, 0.32) },
    Family { name: "defect 53 %", group: Group::Defect, studies: 15, about: "53 % of it", make: |draw, number| defect(draw, number, 0.53) },
    Family {
        name: "defect, clinic",
        group: Group::Defect,
        studies: 6,
        about: "15-40 % of the wall, seen as `clinic`",
        make: defect_clinic,
    },
    Family { name: "empty", group: Group::Negative, studies: 4, about: "background and noise", make: |draw, _| empty(draw) },
    Family {
        name: "liver alone",
        group: Group::Negative,
        studies: 5,
        about: "a liver in an empty field",
        make: |draw, _| liver_alone(draw),
    },
];

/// Every study, family by family.
pub fn members() -> Vec<Member> {
    let of_family = |(index, family): (usize, &'static Family)| {
        (0..family.studies).map(move |number| {
            // Far apart, so that a family can grow without changing another's studies.
            let seed = 1000 * (index as u64 + 1) + number as u64;
            let mut draw = Draw::of(seed);
            let mut phantom = (family.make)(&mut draw, number);
            phantom.imaging.noise_seed = Some(seed);
            let orientation = (family.name == "transaxial").then_some(TRANSAXIAL);
            Member { name: format!("{} #{}", family.name, number + 1), family: family.name, group: family.group, phantom, orientation }
        })
    };
    FAMILIES.iter().enumerate().flat_map(of_family).collect()
}

/// A wall of the presets' proportion to the cavity (85 ml around 45, 130 around 120, 180 around 250), give or take a sixth.
fn wall_ml(edv_ml: f64, draw: &mut Draw) -> f64 {
    85.0 * (edv_ml / 45.0).powf(0.4376) * draw.between(0.84, 1.16)
}

fn ventricle(edv_ml: f64, ejection: f64, elongation: (f64, f64), draw: &mut Draw) -> Ventricle {
    Ventricle {
        edv_ml,
        esv_ml: edv_ml * (1.0 - ejection),
        wall_ml: wall_ml(edv_ml, draw),
        elongation: draw.between(elongation.0, elongation.1),
        // The presets shorten by .06 at an EF of .25, by .15 at .60 and by .18 at .80.
        shortening: 0.25 * ejection * draw.between(0.8, 1.2),
        truncation: draw.between(0.3, 0.5),
        apical_thickness_ratio: draw.between(0.65, 0.95),
    }
}

fn normal(draw: &mut Draw) -> Ventricle {
    let (edv_ml, ejection) = (draw.between(80.0, 160.0), draw.between(0.50, 0.72));
    ventricle(edv_ml, ejection, (1.4, 1.8), draw)
}

fn dilated(draw: &mut Draw) -> Ventricle {
    let (edv_ml, ejection) = (draw.between(170.0, 280.0), draw.between(0.25, 0.45));
    ventricle(edv_ml, ejection, (1.25, 1.5), draw)
}

fn small(draw: &mut Draw) -> Ventricle {
    let (edv_ml, ejection) = (draw.between(45.0, 60.0), draw.between(0.70, 0.80));
    ventricle(edv_ml, ejection, (1.5, 1.8), draw)
}

/// Any size from 65 to 240 ml; the larger, the weaker, as in patients.
fn any(draw: &mut Draw) -> Ventricle {
    let edv_ml = draw.log_between(65.0, 240.0);
    let size = (edv_ml / 65.0).ln() / (240.0_f64 / 65.0).ln();
    let ejection = 0.72 - 0.36 * size + draw.between(-0.08, 0.08);
    let longest = 1.8 - 0.3 * size;
    ventricle(edv_ml, ejection, (longest - 0.3, longest), draw)
}

/// A ventricle as a usual camera sees it: PSF 8-14 mm, 60-200 counts, background 5-12 %, a little off centre and tilted.
fn seen(ventricle: Ventricle, draw: &mut Draw) -> Phantom {
    let pose = Pose {
        tilt_degrees: [draw.between(-5.0, 5.0), draw.between(-5.0, 5.0)],
        offset_mm: [draw.between(-5.0, 5.0), draw.between(-5.0, 5.0), draw.between(-3.0, 3.0)],
        reversed: false,
    };
    let uptake = Uptake { background: draw.between(0.05, 0.12), blood_pool: draw.between(0.08, 0.16), ..Uptake::default() };
    let imaging = Imaging {
        psf: Psf::gaussian(draw.between(8.0, 14.0)),
        counts: draw.log_between(60.0, 200.0),
        oriented: draw.sign() > 0.0,
        ..Imaging::default()
    };
    Phantom { pose, uptake, imaging, ..Phantom::of(Shape::Ventricle(ventricle)) }
}

fn usual(draw: &mut Draw) -> Phantom {
    seen(any(draw), draw)
}

fn bent(draw: &mut Draw) -> Phantom {
    let deformation = Deformation { bend_mm: draw.sign() * draw.between(5.0, 11.0), ..Deformation::default() };
    Phantom { deformation, ..usual(draw) }
}

fn twisted(draw: &mut Draw) -> Phantom {
    let (ovality, twist_degrees) = (draw.between(0.10, 0.25), draw.sign() * draw.between(30.0, 70.0));
    Phantom { deformation: Deformation { twist_degrees, ovality, ..Deformation::default() }, ..usual(draw) }
}

fn base_tilted(draw: &mut Draw) -> Phantom {
    Phantom { deformation: Deformation { base_tilt_degrees: draw.between(5.0, 16.0), ..Deformation::default() }, ..usual(draw) }
}

fn uneven(draw: &mut Draw) -> Phantom {
    let mut phantom = usual(draw);
    phantom.uptake.nonuniformity = draw.between(0.15, 0.35);
    phantom
}

fn background(draw: &mut Draw) -> Phantom {
    let mut phantom = usual(draw);
    phantom.uptake.background = draw.between(0.05, 0.15);
    phantom.uptake.blood_pool = draw.between(0.05, 0.30);
    phantom
}

fn liver(draw: &mut Draw, gap_mm: f64) -> Phantom {
    let mut phantom = usual(draw);
    phantom.uptake.liver = Some(Liver { gap_mm, uptake: draw.between(0.5, 1.5) });
    phantom
}

fn right_ventricle(draw: &mut Draw) -> Phantom {
    let mut phantom = usual(draw);
    phantom.uptake.right_ventricle = draw.between(0.2, 0.6);
    phantom
}

fn displaced(draw: &mut Draw) -> Phantom {
    let mut phantom = seen(normal(draw), draw);
    phantom.pose.tilt_degrees = [draw.between(-20.0, 20.0), draw.between(-20.0, 20.0)];
    let (off, direction) = (draw.between(10.0, 25.0), draw.between(0.0, std::f64::consts::TAU));
    phantom.pose.offset_mm = [off * direction.cos(), off * direction.sin(), draw.between(-5.0, 5.0)];
    phantom
}

fn reversed(draw: &mut Draw) -> Phantom {
    let mut phantom = usual(draw);
    phantom.pose.reversed = true;
    phantom
}

fn masked(draw: &mut Draw) -> Phantom {
    let mut phantom = usual(draw);
    let margin_mm = draw.between(6.0, 14.0);
    phantom.pose.offset_mm = [draw.between(-2.0, 2.0), draw.between(-2.0, 2.0), 0.0];
    let widest_mm = phantom.shape.surfaces(0.0).map_or(0.0, |surfaces| surfaces.epicardium.widest_radius_mm());
    phantom.imaging.field_of_view_mm = Some(widest_mm + margin_mm);
    phantom
}

fn short_gate(draw: &mut Draw) -> Phantom {
    let mut phantom = usual(draw);
    phantom.imaging.last_gate_fraction = draw.between(0.60, 0.90);
    phantom
}

fn on_grid(draw: &mut Draw, grid: Grid) -> Phantom {
    let mut phantom = usual(draw);
    phantom.imaging.grid = grid;
    phantom
}

fn sixteen_gates(draw: &mut Draw) -> Phantom {
    let mut phantom = usual(draw);
    phantom.imaging.gates = 16;
    phantom.imaging.counts /= 2.0;
    phantom
}

fn few_counts(draw: &mut Draw) -> Phantom {
    let mut phantom = usual(draw);
    phantom.imaging.counts = draw.between(30.0, 60.0);
    phantom
}

fn motion(draw: &mut Draw) -> Phantom {
    let mut phantom = usual(draw);
    phantom.imaging.motion_samples = 6;
    phantom
}

fn tail(draw: &mut Draw) -> Tail {
    Tail { fraction: draw.between(0.15, 0.30), fwhm_mm: draw.between(20.0, 30.0) }
}

fn tailed(draw: &mut Draw) -> Phantom {
    let mut phantom = usual(draw);
    phantom.imaging.psf.tail = Some(tail(draw));
    phantom
}

fn growing(draw: &mut Draw) -> Phantom {
    let mut phantom = usual(draw);
    phantom.imaging.psf.growth = draw.between(0.03, 0.06);
    phantom
}

/// The first three lie along axes of the grid, the others anywhere.
fn oblique(draw: &mut Draw, number: usize) -> Phantom {
    let mut phantom = seen(normal(draw), draw);
    phantom.imaging.grid = CUBE_4;
    phantom.imaging.oriented = false;
    phantom.pose.tilt_degrees = match number {
        0 => [90.0, 0.0],
        1 => [0.0, 90.0],
        2 => [180.0, 0.0],
        // The axis anywhere on the sphere.
        _ => [draw.between(-1.0, 1.0).asin().to_degrees(), draw.between(-180.0, 180.0)],
    };
    phantom
}

/// The axis as in a usual patient, 45° to the left and 30° down (see `phantom::short_axis_orientation`), give or take 12°.
fn transaxial(draw: &mut Draw) -> Phantom {
    let mut phantom = seen(normal(draw), draw);
    phantom.imaging.grid = CUBE_4;
    phantom.imaging.oriented = false;
    // The angles about x and y that take the grid's z to that axis in the frame of `TRANSAXIAL`.
    phantom.pose.tilt_degrees = [-60.0 + draw.between(-12.0, 12.0), draw.between(-12.0, 12.0)];
    phantom
}

fn long_axis(draw: &mut Draw, number: usize) -> Phantom {
    let mut phantom = seen(normal(draw), draw);
    phantom.imaging.oriented = false;
    let quarter = [[90.0, 0.0], [-90.0, 0.0], [0.0, 90.0], [0.0, -90.0]][number % 4];
    phantom.pose.tilt_degrees = [quarter[0] + draw.between(-8.0, 8.0), quarter[1] + draw.between(-8.0, 8.0)];
    phantom
}

/// Everything at once.
fn as_in_a_clinic(ventricle: Ventricle, draw: &mut Draw) -> Phantom {
    let mut phantom = seen(ventricle, draw);
    phantom.deformation = Deformation {
        bend_mm: draw.between(-5.0, 5.0),
        twist_degrees: draw.between(-30.0, 30.0),
        ovality: draw.between(-0.12, 0.12),
        base_tilt_degrees: draw.between(2.0, 10.0),
    };
    phantom.pose.tilt_degrees = [draw.between(-12.0, 12.0), draw.between(-12.0, 12.0)];
    phantom.uptake.nonuniformity = draw.between(0.10, 0.25);
    phantom.uptake.right_ventricle = draw.between(0.15, 0.35);
    phantom.uptake.liver = Some(Liver { gap_mm: draw.between(6.0, 20.0), uptake: draw.between(0.4, 1.0) });
    phantom.imaging.motion_samples = 4;
    phantom.imaging.last_gate_fraction = draw.between(0.75, 1.0);
    phantom.imaging.psf = Psf {
        fwhm_mm: draw.between(9.0, 13.0),
        tail: Some(Tail { fraction: draw.between(0.05, 0.15), fwhm_mm: draw.between(20.0, 28.0) }),
        growth: draw.between(0.0, 0.04),
    };
    phantom
}

fn clinic(draw: &mut Draw) -> Phantom {
    as_in_a_clinic(any(draw), draw)
}

fn small_clinic(draw: &mut Draw) -> Phantom {
    as_in_a_clinic(small(draw), draw)
}

fn with_defect(mut phantom: Phantom, number: usize, extent: f64, draw: &mut Draw) -> Phantom {
    let site = [Site::Apical, Site::Anterior, Site::Inferior, Site::Septal, Site::Lateral][number % 5];
    phantom.uptake.defects = vec![Defect { site, extent, severity: draw.between(0.5, 0.9) }];
    phantom
}

fn defect(draw: &mut Draw, number: usize, extent: f64) -> Phantom {
    with_defect(usual(draw), number, extent, draw)
}

fn defect_clinic(draw: &mut Draw, number: usize) -> Phantom {
    let extent = draw.between(0.15, 0.40);
    with_defect(as_in_a_clinic(any(draw), draw), number, extent, draw)
}

fn empty(draw: &mut Draw) -> Phantom {
    Phantom { shape: Shape::Empty, ..usual(draw) }
}

fn liver_alone(draw: &mut Draw) -> Phantom {
    let mut phantom = liver(draw, 0.0);
    if let Some(organ) = &mut phantom.uptake.liver {
        organ.gap_mm = draw.between(-40.0, 20.0);
    }
    Phantom { shape: Shape::Empty, ..phantom }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::phantom;
    use std::collections::BTreeSet;

    #[test]
    fn the_family_is_large_its_names_differ_and_so_do_its_hearts() {
        let members = members();
        assert!(members.len() >= 200, "{}", members.len());
        let names: BTreeSet<&str> = members.iter().map(|member| member.name.as_str()).collect();
        assert_eq!(names.len(), members.len());
        let shapes: BTreeSet<String> =
            members.iter().filter(|member| member.group != Group::Negative).map(|member| format!("{:?}", member.phantom.shape)).collect();
        let ventricles = members.iter().filter(|member| member.group != Group::Negative).count();
        assert_eq!(shapes.len(), ventricles, "no shape twice");
    }

    #[test]
    fn every_ventricle_lies_within_its_grid_and_its_group() {
        for member in members().into_iter().filter(|member| member.group != Group::Negative) {
            let truth = phantom::truth(&member.phantom).unwrap();
            let Shape::Ventricle(ventricle) = member.phantom.shape else { panic!("{}", member.name) };
            assert!(truth.within_grid, "{}", member.name);
            let ejection = 1.0 - ventricle.esv_ml / ventricle.edv_ml;
            assert!((45.0..=280.0).contains(&ventricle.edv_ml) && (0.25..=0.80).contains(&ejection), "{}", member.name);
            assert_eq!(member.group == Group::Small, ventricle.edv_ml <= 60.0, "{}", member.name);
            assert_eq!(member.group == Group::Defect, truth.defect_fraction > 0.0, "{}", member.name);
        }
    }
}
