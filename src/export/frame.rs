//! Where surfaces stand in a scene: glTF's metres with +Y up, along the patient's axes when they are known.

use crate::{
    mesh::Mesh,
    pipeline::{Reconstruction, Surface},
    study::{Orientation, Study},
};
use glam::DVec3;

/// The map from grid mm to a scene in metres, +Y up.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SceneFrame {
    /// Where the grid lies in the patient, if known. Otherwise the scene shows the grid: its columns along X, its rows towards −Z, its slices along Y.
    pub orientation: Option<Orientation>,
    /// The point of the scene, in metres, that meshes are given about: coordinates near zero keep their precision as f32.
    pub centre_m: DVec3,
}

impl SceneFrame {
    /// The frame of a reconstruction, centred on the outer surface at end-diastole so that all its meshes share one origin.
    pub fn of(study: &Study, reconstruction: &Reconstruction) -> Self {
        let about_zero = Self { orientation: study.orientation, centre_m: DVec3::ZERO };
        let diastole =
            reconstruction.gates.iter().max_by(|a, b| a.volume_ml(Surface::Endocardial).total_cmp(&b.volume_ml(Surface::Endocardial)));
        let centre_m = diastole.map_or(DVec3::ZERO, |gate| about_zero.scene_m(gate.fits.epicardial.mesh.centroid()));
        // Rounded to f32 here, as glTF stores it, so that centre + vertex is the vertex's place to the last bit.
        Self { centre_m: centre_m.as_vec3().as_dvec3(), ..about_zero }
    }

    /// `patient` or `grid`.
    pub fn name(&self) -> &'static str {
        if self.orientation.is_some() { "patient" } else { "grid" }
    }

    /// What +X, +Y and +Z of the scene are.
    pub fn axes(&self) -> [&'static str; 3] {
        if self.orientation.is_some() { ["left", "head", "front"] } else { ["columns", "slices", "rows reversed"] }
    }

    /// A point in grid mm in mm along the frame's own axes: the patient's (LPS), or the grid's where they are not known.
    pub fn mm(&self, grid_mm: DVec3) -> DVec3 {
        self.orientation.map_or(grid_mm, |orientation| orientation.patient_mm(grid_mm))
    }

    /// Whether the frame turns triangles and tetrahedra inside out.
    pub fn mirrors(&self) -> bool {
        self.orientation.is_some_and(|orientation| orientation.mirrors())
    }

    /// A point in grid mm as a point of the scene in m, about the scene's origin. (x, y, z) becomes (x, z, −y): a quarter turn about X that
    /// lifts the patient's head (LPS +z) to +Y and brings the front (−y) towards the viewer at +Z.
    pub fn scene_m(&self, grid_mm: DVec3) -> DVec3 {
        let mm = self.mm(grid_mm);
        DVec3::new(mm.x, mm.z, -mm.y) / 1000.0
    }

    /// A direction of the grid as a direction of the scene, of the same length.
    pub fn direction(&self, in_grid: DVec3) -> DVec3 {
        (self.scene_m(in_grid) - self.scene_m(DVec3::ZERO)) * 1000.0
    }

    /// A mesh in grid mm as a mesh of the scene about [`Self::centre_m`], triangles outward also when the grid is left-handed in the patient.
    pub fn mesh(&self, mesh: &Mesh) -> Mesh {
        let moved = mesh.map(|point| self.scene_m(point) - self.centre_m);
        if self.mirrors() { Mesh { triangles: moved.triangles.iter().map(|&[a, b, c]| [a, c, b]).collect(), ..moved } } else { moved }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_patients_head_is_up_and_the_front_faces_the_viewer() {
        let orientation = Orientation { columns: DVec3::X, rows: DVec3::Y, slices: DVec3::Z, origin_mm: DVec3::new(10.0, 20.0, 30.0) };
        let frame = SceneFrame { orientation: Some(orientation), centre_m: DVec3::ZERO };
        assert_eq!(frame.scene_m(DVec3::new(0.0, 0.0, 100.0)) - frame.scene_m(DVec3::ZERO), DVec3::Y * 0.1);
        assert_eq!(frame.scene_m(DVec3::new(0.0, -100.0, 0.0)) - frame.scene_m(DVec3::ZERO), DVec3::Z * 0.1);
        assert_eq!(frame.scene_m(DVec3::ZERO), DVec3::new(0.01, 0.03, -0.02));
    }

    #[test]
    fn triangles_stay_outward_in_either_handedness() {
        let ball = Mesh::icosphere(1).map(|p| p * 30.0 + 100.0);
        let plain = Orientation { columns: DVec3::X, rows: DVec3::Y, slices: DVec3::Z, origin_mm: DVec3::ZERO };
        let mirrored = Orientation { slices: -DVec3::Z, ..plain };
        assert!(mirrored.mirrors() && !plain.mirrors());
        for orientation in [None, Some(plain), Some(mirrored)] {
            let scene = SceneFrame { orientation, centre_m: DVec3::ZERO }.mesh(&ball);
            assert!((scene.signed_volume_mm3() * 1e6 / ball.volume_ml() - 1.0).abs() < 1e-12, "{orientation:?}");
        }
    }
}
