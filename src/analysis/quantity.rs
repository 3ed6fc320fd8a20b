//! The quantities of the wall that have a value at every vertex, and how they are told and drawn.

use super::{Analysis, segments::Average};
use serde::{Deserialize, Serialize};

/// What a polar map shows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Quantity {
    /// Largest counts through the wall, the mean over the gates, in percent of the wall's maximum.
    Perfusion,
    /// Thickness at end diastole; at the one gate of an ungated study.
    EndDiastolicThickness,
    /// Thickness at end systole.
    EndSystolicThickness,
    /// Thickening from end diastole to end systole.
    Thickening,
    /// Inward motion of the endocardial surface from end diastole to end systole.
    Motion,
    /// Phase of the first harmonic of the counts: when the wall is thickest.
    Phase,
}

impl Quantity {
    /// All, in the order in which they are told.
    pub const ALL: [Self; 6] =
        [Self::Perfusion, Self::EndDiastolicThickness, Self::EndSystolicThickness, Self::Thickening, Self::Motion, Self::Phase];

    /// As JSON, addresses and variants of the surfaces name it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Perfusion => "perfusion",
            Self::EndDiastolicThickness => "end_diastolic_thickness",
            Self::EndSystolicThickness => "end_systolic_thickness",
            Self::Thickening => "thickening",
            Self::Motion => "motion",
            Self::Phase => "phase",
        }
    }

    /// The quantity of this name.
    pub fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|quantity| quantity.name() == name)
    }

    /// As people read it.
    pub fn title(self) -> &'static str {
        match self {
            Self::Perfusion => "Perfusion",
            Self::EndDiastolicThickness => "Thickness, end diastole",
            Self::EndSystolicThickness => "Thickness, end systole",
            Self::Thickening => "Thickening",
            Self::Motion => "Wall motion",
            Self::Phase => "Phase",
        }
    }

    /// Its unit: `%`, `mm` or `degrees`.
    pub fn unit(self) -> &'static str {
        match self {
            Self::Perfusion | Self::Thickening => "%",
            Self::EndDiastolicThickness | Self::EndSystolicThickness | Self::Motion => "mm",
            Self::Phase => "degrees",
        }
    }

    /// The values at both ends of the colour scale: the same for every study, so that pictures of two compare. Below zero a wall gets thinner
    /// or moves outwards, and must not look like one that does nothing.
    pub fn range(self) -> [f64; 2] {
        match self {
            Self::Perfusion => [0.0, 100.0],
            Self::EndDiastolicThickness | Self::EndSystolicThickness => [0.0, 20.0],
            Self::Thickening => [-25.0, 100.0],
            Self::Motion => [-3.0, 12.0],
            Self::Phase => [0.0, 360.0],
        }
    }

    /// Name of the colour scale it is drawn in (`Scale` of the module `drawing`).
    pub fn colour_scale(self) -> &'static str {
        match self {
            Self::Perfusion => "inferno",
            Self::Phase => "cycle",
            _ => "viridis",
        }
    }

    /// Whether values are directions, which have no ends.
    pub fn is_cyclic(self) -> bool {
        self == Self::Phase
    }

    /// How its values are averaged.
    pub fn average(self) -> Average {
        if self.is_cyclic() { Average::Circular } else { Average::Plain }
    }

    /// Its value at every vertex; `None` where the study has no cycle to tell it from.
    pub fn of(self, analysis: &Analysis) -> Option<&[Option<f64>]> {
        let gated = analysis.walls.thickness_mm.len() > 1;
        let walls = &analysis.walls;
        match self {
            Self::Perfusion => Some(&analysis.perfusion.percent),
            Self::EndDiastolicThickness => walls.thickness_mm.get(analysis.end_diastole).map(Vec::as_slice),
            Self::EndSystolicThickness => walls.thickness_mm.get(analysis.end_systole).filter(|_| gated).map(Vec::as_slice),
            Self::Thickening => gated.then_some(walls.thickening_percent.as_slice()),
            Self::Motion => gated.then_some(walls.motion_mm.as_slice()),
            Self::Phase => analysis.phase.as_ref().map(|phase| phase.degrees.as_slice()),
        }
    }
}
