//! What the families are made of: hearts drawn at random, each family with the one thing it is about.

use super::draw::Draw;
use crate::{
    phantom::{Decoy, Defect, Deformation, Imaging, Liver, Phantom, Pose, Psf, Shape, Site, Tail, Uptake, Ventricle},
    volume::Grid,
};

/// Grids of isotropic voxels: 4 mm, as reconstructions of small pixels have, and 6.4 mm, the usual clinical pixel.
pub(super) const ISOTROPIC_4: Grid = Grid { shape: [36, 48, 48], spacing_mm: [4.0; 3] };
pub(super) const ISOTROPIC_6_4: Grid = Grid { shape: [24, 32, 32], spacing_mm: [6.4; 3] };
/// A transaxial or oblique volume: cubic, so that a ventricle in any direction fits.
pub(super) const CUBE_4: Grid = Grid { shape: [44, 44, 44], spacing_mm: [4.0; 3] };

/// A wall of the presets' proportion to the cavity (85 ml around 45, 130 around 120, 180 around 250), give or take a sixth.
pub(super) fn wall_ml(edv_ml: f64, draw: &mut Draw) -> f64 {
    85.0 * (edv_ml / 45.0).powf(0.4376) * draw.between(0.84, 1.16)
}

pub(super) fn ventricle(edv_ml: f64, ejection: f64, elongation: (f64, f64), draw: &mut Draw) -> Ventricle {
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

pub(super) fn normal(draw: &mut Draw) -> Ventricle {
    let (edv_ml, ejection) = (draw.between(80.0, 160.0), draw.between(0.50, 0.72));
    ventricle(edv_ml, ejection, (1.4, 1.8), draw)
}

pub(super) fn dilated(draw: &mut Draw) -> Ventricle {
    let (edv_ml, ejection) = (draw.between(170.0, 280.0), draw.between(0.25, 0.45));
    ventricle(edv_ml, ejection, (1.25, 1.5), draw)
}

pub(super) fn small(draw: &mut Draw) -> Ventricle {
    let (edv_ml, ejection) = (draw.between(45.0, 60.0), draw.between(0.70, 0.80));
    ventricle(edv_ml, ejection, (1.5, 1.8), draw)
}

/// Any size from 65 to 240 ml; the larger, the weaker, as in patients.
pub(super) fn any(draw: &mut Draw) -> Ventricle {
    let edv_ml = draw.log_between(65.0, 240.0);
    let size = (edv_ml / 65.0).ln() / (240.0_f64 / 65.0).ln();
    let ejection = 0.72 - 0.36 * size + draw.between(-0.08, 0.08);
    let longest = 1.8 - 0.3 * size;
    ventricle(edv_ml, ejection, (longest - 0.3, longest), draw)
}

/// A ventricle as a usual camera sees it: PSF 8-14 mm, 60-200 counts, background 5-12 %, a little off centre and tilted.
pub(super) fn seen(ventricle: Ventricle, draw: &mut Draw) -> Phantom {
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

pub(super) fn usual(draw: &mut Draw) -> Phantom {
    seen(any(draw), draw)
}

pub(super) fn bent(draw: &mut Draw) -> Phantom {
    let deformation = Deformation { bend_mm: draw.sign() * draw.between(5.0, 11.0), ..Deformation::default() };
    Phantom { deformation, ..usual(draw) }
}

pub(super) fn twisted(draw: &mut Draw) -> Phantom {
    let (ovality, twist_degrees) = (draw.between(0.10, 0.25), draw.sign() * draw.between(30.0, 70.0));
    Phantom { deformation: Deformation { twist_degrees, ovality, ..Deformation::default() }, ..usual(draw) }
}

pub(super) fn base_tilted(draw: &mut Draw) -> Phantom {
    Phantom { deformation: Deformation { base_tilt_degrees: draw.between(5.0, 16.0), ..Deformation::default() }, ..usual(draw) }
}

pub(super) fn uneven(draw: &mut Draw) -> Phantom {
    let mut phantom = usual(draw);
    phantom.uptake.nonuniformity = draw.between(0.15, 0.35);
    phantom
}

pub(super) fn background(draw: &mut Draw) -> Phantom {
    let mut phantom = usual(draw);
    phantom.uptake.background = draw.between(0.05, 0.15);
    phantom.uptake.blood_pool = draw.between(0.05, 0.30);
    phantom
}

pub(super) fn liver(draw: &mut Draw, gap_mm: f64) -> Phantom {
    let mut phantom = usual(draw);
    phantom.uptake.liver = Some(Liver { gap_mm, uptake: draw.between(0.5, 1.5) });
    phantom
}

pub(super) fn right_ventricle(draw: &mut Draw) -> Phantom {
    let mut phantom = usual(draw);
    phantom.uptake.right_ventricle = draw.between(0.2, 0.6);
    phantom
}

pub(super) fn displaced(draw: &mut Draw) -> Phantom {
    let mut phantom = seen(normal(draw), draw);
    phantom.pose.tilt_degrees = [draw.between(-20.0, 20.0), draw.between(-20.0, 20.0)];
    let (off, direction) = (draw.between(10.0, 25.0), draw.between(0.0, std::f64::consts::TAU));
    phantom.pose.offset_mm = [off * direction.cos(), off * direction.sin(), draw.between(-5.0, 5.0)];
    phantom
}

pub(super) fn reversed(draw: &mut Draw) -> Phantom {
    let mut phantom = usual(draw);
    phantom.pose.reversed = true;
    phantom
}

pub(super) fn masked(draw: &mut Draw) -> Phantom {
    let mut phantom = usual(draw);
    let margin_mm = draw.between(6.0, 14.0);
    phantom.pose.offset_mm = [draw.between(-2.0, 2.0), draw.between(-2.0, 2.0), 0.0];
    let widest_mm = phantom.shape.surfaces(0.0).map_or(0.0, |surfaces| surfaces.epicardium.widest_radius_mm());
    phantom.imaging.field_of_view_mm = Some(widest_mm + margin_mm);
    phantom
}

pub(super) fn short_gate(draw: &mut Draw) -> Phantom {
    let mut phantom = usual(draw);
    phantom.imaging.last_gate_fraction = draw.between(0.60, 0.90);
    phantom
}

pub(super) fn on_grid(draw: &mut Draw, grid: Grid) -> Phantom {
    let mut phantom = usual(draw);
    phantom.imaging.grid = grid;
    phantom
}

pub(super) fn sixteen_gates(draw: &mut Draw) -> Phantom {
    let mut phantom = usual(draw);
    phantom.imaging.gates = 16;
    phantom.imaging.counts /= 2.0;
    phantom
}

pub(super) fn few_counts(draw: &mut Draw) -> Phantom {
    let mut phantom = usual(draw);
    phantom.imaging.counts = draw.between(30.0, 60.0);
    phantom
}

pub(super) fn motion(draw: &mut Draw) -> Phantom {
    let mut phantom = usual(draw);
    phantom.imaging.motion_samples = 6;
    phantom
}

pub(super) fn tail(draw: &mut Draw) -> Tail {
    Tail { fraction: draw.between(0.15, 0.30), fwhm_mm: draw.between(20.0, 30.0) }
}

pub(super) fn tailed(draw: &mut Draw) -> Phantom {
    let mut phantom = usual(draw);
    phantom.imaging.psf.tail = Some(tail(draw));
    phantom
}

pub(super) fn growing(draw: &mut Draw) -> Phantom {
    let mut phantom = usual(draw);
    phantom.imaging.psf.growth = draw.between(0.03, 0.06);
    phantom
}

/// The first three lie along axes of the grid, the others anywhere.
pub(super) fn oblique(draw: &mut Draw, number: usize) -> Phantom {
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
pub(super) fn transaxial(draw: &mut Draw) -> Phantom {
    let mut phantom = seen(normal(draw), draw);
    phantom.imaging.grid = CUBE_4;
    phantom.imaging.oriented = false;
    // The angles about x and y that take the grid's z to that axis in the frame of `TRANSAXIAL`.
    phantom.pose.tilt_degrees = [-60.0 + draw.between(-12.0, 12.0), draw.between(-12.0, 12.0)];
    phantom
}

pub(super) fn long_axis(draw: &mut Draw, number: usize) -> Phantom {
    let mut phantom = seen(normal(draw), draw);
    phantom.imaging.oriented = false;
    let quarter = [[90.0, 0.0], [-90.0, 0.0], [0.0, 90.0], [0.0, -90.0]][number % 4];
    phantom.pose.tilt_degrees = [quarter[0] + draw.between(-8.0, 8.0), quarter[1] + draw.between(-8.0, 8.0)];
    phantom
}

/// Everything at once.
pub(super) fn as_in_a_clinic(ventricle: Ventricle, draw: &mut Draw) -> Phantom {
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

pub(super) fn clinic(draw: &mut Draw) -> Phantom {
    as_in_a_clinic(any(draw), draw)
}

pub(super) fn small_clinic(draw: &mut Draw) -> Phantom {
    as_in_a_clinic(small(draw), draw)
}

pub(super) fn with_defect(mut phantom: Phantom, number: usize, extent: f64, draw: &mut Draw) -> Phantom {
    let site = [Site::Apical, Site::Anterior, Site::Inferior, Site::Septal, Site::Lateral][number % 5];
    phantom.uptake.defects = vec![Defect { site, extent, severity: draw.between(0.5, 0.9) }];
    phantom
}

pub(super) fn defect(draw: &mut Draw, number: usize, extent: f64) -> Phantom {
    with_defect(usual(draw), number, extent, draw)
}

pub(super) fn defect_clinic(draw: &mut Draw, number: usize) -> Phantom {
    let extent = draw.between(0.15, 0.40);
    with_defect(as_in_a_clinic(any(draw), draw), number, extent, draw)
}

pub(super) fn empty(draw: &mut Draw) -> Phantom {
    Phantom { shape: Shape::Empty, ..usual(draw) }
}

pub(super) fn liver_alone(draw: &mut Draw) -> Phantom {
    let mut phantom = liver(draw, 0.0);
    if let Some(organ) = &mut phantom.uptake.liver {
        organ.gap_mm = draw.between(-40.0, 20.0);
    }
    Phantom { shape: Shape::Empty, ..phantom }
}

pub(super) fn decoy(decoy: Decoy, draw: &mut Draw) -> Phantom {
    Phantom { shape: Shape::Decoy(decoy), ..usual(draw) }
}

pub(super) fn hollow_ball(draw: &mut Draw) -> Phantom {
    let outer_mm = draw.between(28.0, 38.0);
    decoy(Decoy::HollowBall { inner_mm: outer_mm - draw.between(8.0, 14.0), outer_mm }, draw)
}

pub(super) fn tube(draw: &mut Draw) -> Phantom {
    let outer_mm = draw.between(26.0, 36.0);
    decoy(Decoy::Tube { inner_mm: outer_mm - draw.between(8.0, 12.0), outer_mm, length_mm: draw.between(70.0, 110.0) }, draw)
}

pub(super) fn ring(draw: &mut Draw) -> Phantom {
    decoy(Decoy::Ring { radius_mm: draw.between(22.0, 34.0), thickness_mm: draw.between(6.0, 10.0) }, draw)
}

pub(super) fn two_balls(draw: &mut Draw) -> Phantom {
    let radius_mm = draw.between(14.0, 22.0);
    decoy(Decoy::TwoBalls { radius_mm, apart_mm: draw.between(2.2, 3.0) * radius_mm }, draw)
}
