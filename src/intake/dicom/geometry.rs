//! How far apart voxels are and where they lie in the patient.

use super::attributes::{Attributes, invalid};
use super::object::Object;
use crate::intake::IntakeError;
use crate::study::{LONG_AXIS_SLICES, Orientation, Warning};
use dicom_dictionary_std::tags;
use glam::DVec3;

/// How far the direction cosines may be from orthonormal; they are often written with three digits.
const COSINE_TOLERANCE: f64 = 0.01;
/// How far slices in separate files may be from an even spacing.
const STACK_TOLERANCE_MM: f64 = 0.1;

/// Spacing `[z, y, x]` and orientation of a study.
#[derive(Debug)]
pub(super) struct Geometry {
    pub(super) spacing_mm: [f64; 3],
    pub(super) orientation: Option<Orientation>,
}

/// What a data set says of its plane: direction cosines and the position of the first voxel.
#[derive(Debug, Clone, Copy)]
pub(super) struct Plane {
    pub(super) columns: DVec3,
    pub(super) rows: DVec3,
    pub(super) position_mm: Option<DVec3>,
}

impl Plane {
    /// Looks in each item of Detector Information (0054,0022), where NM has it, then in the outermost data set.
    pub(super) fn of(attributes: &Attributes) -> Result<Option<Self>, IntakeError> {
        let detectors = attributes.items(tags::DETECTOR_INFORMATION_SEQUENCE);
        for place in detectors.iter().chain([attributes]) {
            let cosines = place.numbers(tags::IMAGE_ORIENTATION_PATIENT, "Image Orientation (Patient)")?;
            let [cx, cy, cz, rx, ry, rz] = cosines[..] else { continue };
            let position = place.numbers(tags::IMAGE_POSITION_PATIENT, "Image Position (Patient)")?;
            let position_mm = if let [x, y, z] = position[..] { Some(DVec3::new(x, y, z)) } else { None };
            return Ok(Some(Self { columns: DVec3::new(cx, cy, cz), rows: DVec3::new(rx, ry, rz), position_mm }));
        }
        Ok(None)
    }

    /// Whether the cosines are unit vectors at a right angle.
    pub(super) fn is_orthonormal(&self) -> bool {
        let unit = |v: DVec3| (v.length() - 1.0).abs() < COSINE_TOLERANCE;
        unit(self.columns) && unit(self.rows) && self.columns.dot(self.rows).abs() < COSINE_TOLERANCE
    }

    /// The direction in which positive Spacing Between Slices stacks (PS3.3 C.8.4.15: behind the first slice as one looks at it).
    pub(super) fn normal(&self) -> DVec3 {
        self.columns.cross(self.rows).normalize_or_zero()
    }

    fn orientation(&self, stacking: f64) -> Orientation {
        let columns = self.columns.normalize_or_zero();
        let slices = self.normal() * stacking;
        // Right angles exactly, whatever the rounding in the file.
        let rows = self.normal().cross(columns);
        Orientation { columns, rows, slices, origin_mm: self.position_mm.unwrap_or(DVec3::ZERO) }
    }
}

/// Geometry of one multi-frame object, or of files that hold a whole stack each.
pub(super) fn of_object(object: &Object<'_>, slices: usize, warnings: &mut Vec<Warning>) -> Result<Geometry, IntakeError> {
    let attributes = &object.attributes;
    let [row_spacing, column_spacing] = in_plane(attributes)?;
    let between = attributes.number(tags::SPACING_BETWEEN_SLICES, "Spacing Between Slices")?.filter(|spacing| *spacing != 0.0);
    let signed = match (between, attributes.number(tags::SLICE_THICKNESS, "Slice Thickness")?) {
        (Some(between), _) => between,
        (None, Some(thickness)) if thickness > 0.0 => {
            warnings.push(Warning::new(
                "slice_spacing_from_thickness",
                format!("Spacing Between Slices (0018,0088) is missing; Slice Thickness ({thickness} mm) was taken instead."),
            ));
            thickness
        }
        _ if slices == 1 => row_spacing,
        _ => {
            return Err(IntakeError::MissingAttribute {
                name: "Spacing Between Slices",
                tag: tags::SPACING_BETWEEN_SLICES.to_string(),
                advice: "nor a Slice Thickness (0018,0050), and without the distance between slices there are no volumes",
            });
        }
    };
    let plane = usable_plane(attributes, warnings)?;
    let orientation = plane.map(|plane| plane.orientation(signed.signum()));
    Ok(Geometry { spacing_mm: [signed.abs(), row_spacing, column_spacing], orientation })
}

/// Geometry of slices in separate files, from their positions along the normal in mm, in ascending order.
pub(super) fn of_positions(first: &Object<'_>, positions_mm: &[f64], warnings: &mut Vec<Warning>) -> Result<Geometry, IntakeError> {
    let [row_spacing, column_spacing] = in_plane(&first.attributes)?;
    let steps: Vec<f64> = positions_mm.windows(2).map(|pair| pair[1] - pair[0]).collect();
    let mean = steps.iter().sum::<f64>() / steps.len().max(1) as f64;
    if let Some((index, step)) = steps.iter().enumerate().find(|(_, step)| (**step - mean).abs() > STACK_TOLERANCE_MM) {
        return Err(IntakeError::InconsistentFrames {
            reason: format!(
                "slices {} and {} are {step:.2} mm apart where the others are {mean:.2} mm apart: a slice is missing",
                index + 1,
                index + 2
            ),
        });
    }
    let plane = usable_plane(&first.attributes, warnings)?;
    let orientation = plane.map(|plane| {
        let mut orientation = plane.orientation(1.0);
        // The file that was first in the request need not be the first slice.
        let along = positions_mm.first().copied().unwrap_or(0.0) - orientation.origin_mm.dot(orientation.slices);
        orientation.origin_mm += orientation.slices * along;
        orientation
    });
    Ok(Geometry { spacing_mm: [mean, row_spacing, column_spacing], orientation })
}

/// Pixel Spacing: between rows (y), then between columns (x).
fn in_plane(attributes: &Attributes) -> Result<[f64; 2], IntakeError> {
    let spacing = attributes.numbers(tags::PIXEL_SPACING, "Pixel Spacing")?;
    match spacing[..] {
        [] => Err(IntakeError::MissingAttribute {
            name: "Pixel Spacing",
            tag: tags::PIXEL_SPACING.to_string(),
            advice: "without the size of a pixel there are no volumes",
        }),
        [rows, columns] if rows > 0.0 && columns > 0.0 => Ok([rows, columns]),
        _ => Err(invalid(tags::PIXEL_SPACING, "Pixel Spacing", &format!("{spacing:?}"), "it must be two positive numbers")),
    }
}

/// The plane if it can be used; why not, as a warning.
fn usable_plane(attributes: &Attributes, warnings: &mut Vec<Warning>) -> Result<Option<Plane>, IntakeError> {
    let Some(plane) = Plane::of(attributes)? else {
        warnings.push(missing_orientation(attributes));
        return Ok(None);
    };
    if !plane.is_orthonormal() {
        warnings.push(Warning::new(
            "invalid_orientation",
            "Image Orientation (Patient) (0020,0037) is not two unit vectors at a right angle and was ignored: surfaces are in grid axes.",
        ));
        return Ok(None);
    }
    if plane.position_mm.is_none() {
        warnings.push(Warning::new(
            "missing_position",
            "Image Position (Patient) (0020,0032) is missing: directions are the patient's, positions are not.",
        ));
    }
    Ok(Some(plane))
}

/// Says that the file names no orientation, and which axis its Image ID names, if it is one of the usual names. (Image ID is free text and
/// is not repeated.)
fn missing_orientation(attributes: &Attributes) -> Warning {
    let id = attributes.text(tags::IMAGE_ID).unwrap_or_default().to_ascii_uppercase();
    let words: Vec<&str> = id.split(|c: char| !c.is_ascii_alphanumeric()).collect();
    let any = |names: &[&str]| names.iter().any(|name| words.contains(name));
    let axis = match () {
        () if any(&["HLA", "HLAX"]) || (any(&["H", "HOR", "HORIZ", "HORIZONTAL"]) && any(&["LONG", "LG"])) => "horizontal long-axis",
        () if any(&["VLA", "VLAX"]) || (any(&["V", "VERT", "VERTICAL"]) && any(&["LONG", "LG"])) => "vertical long-axis",
        () if any(&["SA", "SAX"]) || (any(&["SHORT", "SH"]) && any(&["AX", "AXIS"])) => {
            return Warning::new(
                "missing_orientation",
                "The file has no Image Orientation (Patient) (0020,0037): surfaces are in grid axes, not the patient's. Its Image ID names short-axis slices.",
            );
        }
        () => {
            return Warning::new(
                "missing_orientation",
                "The file has no Image Orientation (Patient) (0020,0037): surfaces are in grid axes, not the patient's, and nothing says that the slices are short-axis slices.",
            );
        }
    };
    Warning::new(
        LONG_AXIS_SLICES,
        format!(
            "The file has no Image Orientation (Patient) (0020,0037): surfaces are in grid axes, not the patient's. Its Image ID names {axis} slices: \
             the preset `clinical` measures the ventricle along its own axes, `paper` expects short-axis slices."
        ),
    )
}
