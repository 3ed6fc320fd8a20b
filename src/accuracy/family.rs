//! The published family: simulated studies whose truth is known, the same on every machine.
//!
//! A study is a family, a number within it and what the seed of the two draws. Every study draws its own size, ejection fraction, wall, elongation, shortening,
//! blur, noise and place, so that no two hearts are the same shape; a family adds the one thing it is about.

use super::{draw::Draw, hearts};
use crate::{
    phantom::{Decoy, Phantom},
    study::{Orientation, Study},
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
        make: |draw, _| hearts::seen(hearts::normal(draw), draw),
    },
    Family {
        name: "dilated",
        group: Group::NoDefect,
        studies: 10,
        about: "EDV 170-280 ml, EF .25-.45, rounder",
        make: |draw, _| hearts::seen(hearts::dilated(draw), draw),
    },
    Family { name: "bent", group: Group::NoDefect, studies: 6, about: "the axis bent by 5-11 mm", make: |draw, _| hearts::bent(draw) },
    Family {
        name: "twisted",
        group: Group::NoDefect,
        studies: 6,
        about: "oval by 10-25 %, turning by 30-70° from apex to base",
        make: |draw, _| hearts::twisted(draw),
    },
    Family {
        name: "base tilted",
        group: Group::NoDefect,
        studies: 8,
        about: "the septal wall ends before the lateral one: valve plane at 5-16°",
        make: |draw, _| hearts::base_tilted(draw),
    },
    Family {
        name: "uneven uptake",
        group: Group::NoDefect,
        studies: 6,
        about: "15-35 % less uptake in septum, inferior wall and apex",
        make: |draw, _| hearts::uneven(draw),
    },
    Family {
        name: "background",
        group: Group::NoDefect,
        studies: 8,
        about: "background 5-15 % of the wall, blood 5-30 %",
        make: |draw, _| hearts::background(draw),
    },
    Family {
        name: "liver 10 mm",
        group: Group::NoDefect,
        studies: 7,
        about: "a liver of .5-1.5 of the wall's uptake 10 mm under the inferior wall",
        make: |draw, _| hearts::liver(draw, 10.0),
    },
    Family {
        name: "liver 4 mm",
        group: Group::NoDefect,
        studies: 7,
        about: "the same 4 mm under it",
        make: |draw, _| hearts::liver(draw, 4.0),
    },
    Family {
        name: "right ventricle",
        group: Group::NoDefect,
        studies: 6,
        about: "a right ventricle of .2-.6 of the wall's uptake",
        make: |draw, _| hearts::right_ventricle(draw),
    },
    Family {
        name: "displaced",
        group: Group::NoDefect,
        studies: 7,
        about: "tilted by up to 20° about two axes and 10-25 mm off the centre",
        make: |draw, _| hearts::displaced(draw),
    },
    Family {
        name: "reversed",
        group: Group::NoDefect,
        studies: 4,
        about: "base at the first slice",
        make: |draw, _| hearts::reversed(draw),
    },
    Family {
        name: "masked",
        group: Group::NoDefect,
        studies: 6,
        about: "zero outside a circle 6-14 mm from the wall",
        make: |draw, _| hearts::masked(draw),
    },
    Family {
        name: "last gate short",
        group: Group::NoDefect,
        studies: 5,
        about: "the last gate holds .60-.90 of the counts",
        make: |draw, _| hearts::short_gate(draw),
    },
    Family {
        name: "4 mm voxels",
        group: Group::NoDefect,
        studies: 6,
        about: "48 × 48 × 36 of 4 mm",
        make: |draw, _| hearts::on_grid(draw, hearts::ISOTROPIC_4),
    },
    Family {
        name: "6.4 mm voxels",
        group: Group::NoDefect,
        studies: 6,
        about: "32 × 32 × 24 of 6.4 mm",
        make: |draw, _| hearts::on_grid(draw, hearts::ISOTROPIC_6_4),
    },
    Family {
        name: "16 gates",
        group: Group::NoDefect,
        studies: 5,
        about: "16 gates at half the counts each",
        make: |draw, _| hearts::sixteen_gates(draw),
    },
    Family {
        name: "few counts",
        group: Group::NoDefect,
        studies: 6,
        about: "30-60 counts in the brightest wall voxel",
        make: |draw, _| hearts::few_counts(draw),
    },
    Family {
        name: "motion",
        group: Group::NoDefect,
        studies: 6,
        about: "each gate the mean of six phases",
        make: |draw, _| hearts::motion(draw),
    },
    Family {
        name: "tailed PSF",
        group: Group::NoDefect,
        studies: 6,
        about: "15-30 % of the counts in a Gaussian of 20-30 mm under the main one",
        make: |draw, _| hearts::tailed(draw),
    },
    Family {
        name: "growing PSF",
        group: Group::NoDefect,
        studies: 6,
        about: "FWHM grows by .03-.06 mm a mm along the rows: 2-4 mm over the heart",
        make: |draw, _| hearts::growing(draw),
    },
    Family {
        name: "oblique",
        group: Group::NoDefect,
        studies: 7,
        about: "4 mm voxels, any direction, orientation unknown to the file",
        make: hearts::oblique,
    },
    Family {
        name: "transaxial",
        group: Group::NoDefect,
        studies: 6,
        about: "4 mm voxels, transaxial slices, orientation told",
        make: |draw, _| hearts::transaxial(draw),
    },
    Family {
        name: "long axis",
        group: Group::NoDefect,
        studies: 4,
        about: "the paper's voxels, slices along the long axis, orientation unknown",
        make: hearts::long_axis,
    },
    Family {
        name: "clinic",
        group: Group::NoDefect,
        studies: 10,
        about: "everything at once: tilted, bent, oval, tilted base, uneven uptake, right ventricle, liver, motion, tailed growing PSF, short gate",
        make: |draw, _| hearts::clinic(draw),
    },
    Family {
        name: "small",
        group: Group::Small,
        studies: 12,
        about: "EDV 45-60 ml, EF .70-.80",
        make: |draw, _| hearts::seen(hearts::small(draw), draw),
    },
    Family {
        name: "small, clinic",
        group: Group::Small,
        studies: 4,
        about: "the same seen as `clinic`",
        make: |draw, _| hearts::small_clinic(draw),
    },
    Family {
        name: "defect 10 %",
        group: Group::Defect,
        studies: 15,
        about: "10 % of the wall: apical, anterior, inferior, septal, lateral; 50-90 % of the uptake lost",
        make: |draw, number| hearts::defect(draw, number, 0.10),
    },
    Family {
        name: "defect 32 %",
        group: Group::Defect,
        studies: 15,
        about: "32 % of it",
        make: |draw, number| hearts::defect(draw, number, 0.32),
    },
    Family {
        name: "defect 53 %",
        group: Group::Defect,
        studies: 15,
        about: "53 % of it",
        make: |draw, number| hearts::defect(draw, number, 0.53),
    },
    Family {
        name: "defect, clinic",
        group: Group::Defect,
        studies: 6,
        about: "15-40 % of the wall, seen as `clinic`",
        make: hearts::defect_clinic,
    },
    Family { name: "empty", group: Group::Negative, studies: 4, about: "background and noise", make: |draw, _| hearts::empty(draw) },
    Family {
        name: "liver alone",
        group: Group::Negative,
        studies: 5,
        about: "a liver in an empty field",
        make: |draw, _| hearts::liver_alone(draw),
    },
    Family {
        name: "ball",
        group: Group::Negative,
        studies: 3,
        about: "a solid ball of 18-34 mm",
        make: |draw, _| hearts::decoy(Decoy::Ball { radius_mm: draw.between(18.0, 34.0) }, draw),
    },
    Family {
        name: "hollow ball",
        group: Group::Negative,
        studies: 3,
        about: "a wall closed on all sides, outer radius 28-38 mm",
        make: |draw, _| hearts::hollow_ball(draw),
    },
    Family {
        name: "tube",
        group: Group::Negative,
        studies: 3,
        about: "a wall open at both ends, 70-110 mm long",
        make: |draw, _| hearts::tube(draw),
    },
    Family { name: "ring", group: Group::Negative, studies: 3, about: "a torus of radius 22-34 mm", make: |draw, _| hearts::ring(draw) },
    Family {
        name: "two balls",
        group: Group::Negative,
        studies: 3,
        about: "two balls of 14-22 mm side by side",
        make: |draw, _| hearts::two_balls(draw),
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::phantom::{self, Shape};
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
