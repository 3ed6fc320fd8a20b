//! Which phantoms can be made: every parameter in a range in which the formulas and the machine cope.

use super::regional::Borders;
use super::shape::{Cylinder, Surfaces, Ventricle};
use super::{Deformation, Imaging, Phantom, PhantomError, Pose, Shape, Uptake};
use std::fmt::Display;
use std::ops::RangeInclusive;

/// The largest grid in voxels; a whole study is held in memory in double precision.
const MOST_VOXELS: usize = 8_000_000;

/// Refuses the first parameter that is out of range.
pub(super) fn check(phantom: &Phantom) -> Result<(), PhantomError> {
    check_shape(&phantom.shape)?;
    check_regional(phantom)?;
    check_pose(&phantom.pose, &phantom.deformation)?;
    check_uptake(&phantom.uptake)?;
    check_imaging(&phantom.imaging)
}

fn refuse(what: &'static str, got: impl Display, wanted: impl Into<String>) -> PhantomError {
    PhantomError::Invalid { what, got: got.to_string(), wanted: wanted.into() }
}

/// NaN is in no range.
fn within<T: PartialOrd + Display>(what: &'static str, value: T, range: RangeInclusive<T>) -> Result<(), PhantomError> {
    if range.contains(&value) { Ok(()) } else { Err(refuse(what, value, format!("from {} to {}", range.start(), range.end()))) }
}

fn check_shape(shape: &Shape) -> Result<(), PhantomError> {
    match shape {
        Shape::Cylinder(cylinder) => check_cylinder(cylinder),
        Shape::Ventricle(ventricle) => check_ventricle(ventricle),
        Shape::Decoy(decoy) => decoy.sizes_mm().into_iter().try_for_each(|mm| within("decoy's size (mm)", mm, 1.0..=200.0)),
        Shape::Empty => Ok(()),
    }
}

fn check_cylinder(cylinder: &Cylinder) -> Result<(), PhantomError> {
    let &Cylinder { inner_radius_mm, inner_height_mm, outer_radius_mm, outer_height_mm } = cylinder;
    within("outer radius (mm)", outer_radius_mm, 2.0..=200.0)?;
    within("outer height (mm)", outer_height_mm, 1.0..=400.0)?;
    within("inner height (mm)", inner_height_mm, 0.0..=400.0)?;
    within("inner radius (mm)", inner_radius_mm, 1.0..=200.0)?;
    if inner_radius_mm >= outer_radius_mm {
        return Err(refuse("inner radius (mm)", inner_radius_mm, format!("less than the outer radius, {outer_radius_mm}")));
    }
    if inner_height_mm + inner_radius_mm >= outer_height_mm + outer_radius_mm {
        let longest = outer_height_mm + outer_radius_mm - inner_radius_mm;
        return Err(refuse("inner height (mm)", inner_height_mm, format!("less than {longest}, so that the apex has a wall")));
    }
    Ok(())
}

fn check_ventricle(ventricle: &Ventricle) -> Result<(), PhantomError> {
    within("end-diastolic volume (ml)", ventricle.edv_ml, 2.0..=1000.0)?;
    within("end-systolic volume (ml)", ventricle.esv_ml, 1.0..=ventricle.edv_ml)?;
    within("wall volume (ml)", ventricle.wall_ml, 5.0..=1000.0)?;
    within("elongation", ventricle.elongation, 0.8..=4.0)?;
    within("shortening", ventricle.shortening, 0.0..=0.5)?;
    within("truncation", ventricle.truncation, 0.0..=0.95)?;
    within("apical thickness ratio", ventricle.apical_thickness_ratio, 0.1..=3.0)?;
    for cavity_ml in [ventricle.edv_ml, ventricle.esv_ml] {
        let Surfaces { endocardium, epicardium } = ventricle.surfaces(cavity_ml);
        let (tip, base) = (endocardium.tip_w_mm(), endocardium.base_w_mm());
        let heights = (0..200).map(|step| tip + (base - tip) * f64::from(step) / 200.0);
        let thinnest = heights.map(|w| epicardium.radius_squared_mm2(w) - endocardium.radius_squared_mm2(w)).fold(f64::INFINITY, f64::min);
        if thinnest <= 0.0 {
            return Err(refuse("wall volume (ml)", ventricle.wall_ml, "large enough for a wall everywhere around this cavity"));
        }
    }
    Ok(())
}

fn check_regional(phantom: &Phantom) -> Result<(), PhantomError> {
    if phantom.regional.is_empty() {
        return Ok(());
    }
    if !matches!(phantom.shape, Shape::Ventricle(_)) {
        return Err(refuse("regional function", phantom.regional.len(), "absent, for this shape does not beat"));
    }
    for part in &phantom.regional {
        within("regional part's middle (degrees)", part.centre_degrees, -360.0..=360.0)?;
        within("regional part's width (degrees)", part.width_degrees, 1.0..=360.0)?;
        // An edge that met itself on the other side would be no edge.
        let widest_edge = if part.width_degrees < 360.0 { part.width_degrees.min(360.0 - part.width_degrees) } else { 360.0 };
        within("regional part's edge (degrees)", part.edge_degrees, 0.0..=widest_edge)?;
        let [from, to] = part.heights;
        within("regional part's lower end", from, 0.0..=1.0)?;
        within("regional part's upper end", to, from..=1.0)?;
        within("regional part's edge along the height", part.edge_height, 0.0..=1.0)?;
        within("regional part's delay (R-R)", part.delay, -1.0..=1.0)?;
        within("regional part's amplitude", part.amplitude, -1.0..=1.0)?;
        within("regional part's thickness", part.thickness, 0.1..=3.0)?;
    }
    let phases = (0..16).map(|step| f64::from(step) / 16.0);
    if phases.filter_map(|phase| Borders::at_phase(phantom, phase)).any(|borders| !borders.wall_is_whole()) {
        let got = phantom.regional.iter().map(|part| part.thickness).fold(f64::INFINITY, f64::min);
        return Err(refuse("regional part's thickness", got, "large enough for a wall everywhere around this cavity"));
    }
    Ok(())
}

fn check_pose(pose: &Pose, deformation: &Deformation) -> Result<(), PhantomError> {
    for degrees in pose.tilt_degrees {
        within("tilt (degrees)", degrees, -180.0..=180.0)?;
    }
    for offset in pose.offset_mm {
        within("offset (mm)", offset, -500.0..=500.0)?;
    }
    within("bend (mm)", deformation.bend_mm, -60.0..=60.0)?;
    within("twist (degrees)", deformation.twist_degrees, -360.0..=360.0)?;
    within("ovality", deformation.ovality, -0.6..=1.5)?;
    within("tilt of the base (degrees)", deformation.base_tilt_degrees, -45.0..=45.0)
}

fn check_uptake(uptake: &Uptake) -> Result<(), PhantomError> {
    within("background", uptake.background, 0.0..=1.0)?;
    within("blood pool", uptake.blood_pool, 0.0..=1.0)?;
    within("non-uniformity", uptake.nonuniformity, 0.0..=1.0)?;
    within("right ventricle's uptake", uptake.right_ventricle, 0.0..=5.0)?;
    for defect in &uptake.defects {
        within("extent of a defect", defect.extent, 0.0..=1.0)?;
        within("severity of a defect", defect.severity, 0.0..=1.0)?;
    }
    if let Some(liver) = uptake.liver {
        within("liver's distance (mm)", liver.gap_mm, -50.0..=200.0)?;
        within("liver's uptake", liver.uptake, 0.0..=20.0)?;
    }
    Ok(())
}

fn check_imaging(imaging: &Imaging) -> Result<(), PhantomError> {
    for size in imaging.grid.shape {
        within("grid's size (voxels)", size, 4..=512)?;
    }
    for spacing in imaging.grid.spacing_mm {
        within("grid's spacing (mm)", spacing, 0.5..=20.0)?;
    }
    within("gates", imaging.gates, 1..=64)?;
    within("study's voxels", imaging.grid.voxels() * imaging.gates, 1..=MOST_VOXELS)?;
    within("counts", imaging.counts, 0.001..=1e6)?;
    within("supersampling", imaging.supersampling, 1..=10)?;
    within("phases a gate", imaging.motion_samples, 1..=64)?;
    within("last gate's share of counts", imaging.last_gate_fraction, 0.01..=1.0)?;
    within("R-R interval (ms)", imaging.rr_interval_ms, 200.0..=3000.0)?;
    if let Some(radius_mm) = imaging.field_of_view_mm {
        within("field of view's radius (mm)", radius_mm, 1.0..=1000.0)?;
    }
    let psf = &imaging.psf;
    within("PSF's FWHM (mm)", psf.fwhm_mm, 0.0..=60.0)?;
    if let Some(tail) = psf.tail {
        within("PSF tail's share", tail.fraction, 0.0..=1.0)?;
        within("PSF tail's FWHM (mm)", tail.fwhm_mm, 0.0..=100.0)?;
    }
    // Half the grid away from the middle row, the width must still be one.
    let half_mm = imaging.grid.shape[1] as f64 * imaging.grid.spacing_mm[1] / 2.0;
    let steepest = (psf.fwhm_mm / half_mm).min(0.5);
    within("PSF's growth (mm per mm)", psf.growth, -steepest..=steepest)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::phantom::Regional;

    #[test]
    fn the_presets_are_in_range_and_what_is_not_is_named() {
        for phantom in [Phantom::demo(), Phantom::paper(), Phantom::of(Shape::Empty)] {
            check(&phantom).unwrap();
        }
        let message = |change: fn(&mut Phantom)| {
            let mut phantom = Phantom::demo();
            change(&mut phantom);
            check(&phantom).unwrap_err().to_string()
        };
        assert_eq!(message(|phantom| phantom.imaging.gates = 0), "the phantom's gates is 0; it must be from 1 to 64");
        assert!(message(|phantom| phantom.imaging.psf.fwhm_mm = f64::NAN).contains("FWHM"));
        assert!(message(|phantom| phantom.regional = vec![Regional::sector(0.0, 0.0)]).contains("width"));
        let never = Regional { thickness: f64::NAN, ..Regional::sector(0.0, 60.0) };
        assert!(check(&Phantom { regional: vec![never], ..Phantom::demo() }).unwrap_err().to_string().contains("thickness is NaN"));
        assert!(
            check(&Phantom { regional: vec![Regional::sector(0.0, 60.0)], ..Phantom::paper() }).unwrap_err().to_string().contains("beat")
        );
        assert!(message(|phantom| phantom.imaging.psf.growth = 0.4).contains("growth"));
        assert!(message(|phantom| phantom.imaging.grid.shape = [512; 3]).contains("voxels"));
        assert!(
            message(|phantom| phantom.shape = Shape::Cylinder(Cylinder { inner_height_mm: 80.0, ..Cylinder::default() })).contains("71")
        );
        assert!(
            message(|phantom| phantom.shape = Shape::Ventricle(Ventricle { esv_ml: 130.0, ..Ventricle::NORMAL })).contains("from 1 to 120")
        );
    }
}
