//! One surface of one gate as a binary STL, made from the binary glTF in which it is stored: the same vertices, in mm.
//!
//! Coordinates are those of `wall.vtu`: the patient's axes (LPS) when the study has an orientation, else the grid's. The glTF is single
//! precision about the heart's own centre, so a vertex moves by some nanometres, and by some ten more as the STL's single precision counts
//! from the frame's origin.

use super::{
    ExportError,
    stored::{chunks, indices, positions},
};
use glam::{DVec3, Vec3};
use gltf_json::{Accessor, Root, mesh::Semantic, validation::Checked};
use serde::Deserialize;

/// Bytes before the triangles' number.
const HEADER_BYTES: usize = 80;

/// A surface as a triangle soup, and where it lies.
#[derive(Debug, Clone, PartialEq)]
pub struct Stl {
    /// The file.
    pub bytes: Vec<u8>,
    /// Whether coordinates are along the patient's axes; else along the grid's.
    pub in_patient_frame: bool,
}

/// What our own glTF of one surface says of itself.
#[derive(Deserialize)]
struct SceneFacts {
    frame: String,
    surface: String,
    gate: usize,
}

/// The STL of a surface that [`super::glb::surface`] wrote.
///
/// # Errors
/// [`ExportError::NotOurs`] for any other file.
pub fn of_glb(glb: &[u8]) -> Result<Stl, ExportError> {
    let (json, binary) = chunks(glb).ok_or(ExportError::NotOurs { what: "container" })?;
    let root = Root::from_slice(json)?;
    let not_ours = |what| move || ExportError::NotOurs { what };
    let extras = root.scenes.first().and_then(|scene| scene.extras.as_ref()).ok_or_else(not_ours("scene"))?;
    let facts: SceneFacts = serde_json::from_str(extras.get())?;
    let primitive = root.meshes.first().and_then(|mesh| mesh.primitives.first()).ok_or_else(not_ours("mesh"))?;
    let centre_m = root.nodes.iter().find_map(|node| node.translation).ok_or_else(not_ours("centre"))?;
    let accessor = |index: Option<&gltf_json::Index<Accessor>>| index.and_then(|index| root.accessors.get(index.value()));
    let positions = accessor(primitive.attributes.get(&Checked::Valid(Semantic::Positions)))
        .and_then(|accessor| positions(&root, accessor, binary))
        .ok_or_else(not_ours("vertices"))?;
    let indices =
        accessor(primitive.indices.as_ref()).and_then(|accessor| indices(&root, accessor, binary)).ok_or_else(not_ours("triangles"))?;
    let centre_m = Vec3::from_array(centre_m).as_dvec3();
    // From the scene's metres, +Y up, back to mm along the frame's own axes: (x, y, z) was (x, z, −y).
    let points_mm: Vec<DVec3> = positions
        .into_iter()
        .map(|position| {
            let point = (centre_m + Vec3::from_array(position).as_dvec3()) * 1000.0;
            DVec3::new(point.x, -point.z, point.y)
        })
        .collect();
    let corners = |triangle: &[u32]| -> Option<[DVec3; 3]> {
        let [a, b, c] = *triangle else { return None };
        let point = |index: u32| points_mm.get(index as usize).copied();
        Some([point(a)?, point(b)?, point(c)?])
    };
    let triangles: Option<Vec<[DVec3; 3]>> = indices.chunks(3).map(corners).collect();
    let triangles = triangles.ok_or_else(not_ours("triangles"))?;
    let in_patient_frame = facts.frame == "patient";
    let axes = if in_patient_frame { "patient LPS" } else { "grid" };
    let title = format!("ventricle {} surface, gate {}; mm, {axes}", facts.surface, facts.gate);
    Ok(Stl { bytes: written(&title, &triangles), in_patient_frame })
}

/// 80 bytes of title, the number of triangles, and for each its normal, its corners counter-clockwise seen from outside, and two zeros.
fn written(title: &str, triangles: &[[DVec3; 3]]) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(HEADER_BYTES + 4 + 50 * triangles.len());
    bytes.extend(title.bytes().chain(std::iter::repeat(b' ')).take(HEADER_BYTES));
    bytes.extend((triangles.len() as u32).to_le_bytes());
    for &[a, b, c] in triangles {
        let normal = (b - a).cross(c - a).normalize_or_zero();
        for point in [normal, a, b, c] {
            bytes.extend(point.as_vec3().to_array().into_iter().flat_map(f32::to_le_bytes));
        }
        bytes.extend([0, 0]);
    }
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn anything_else_is_refused() {
        let empty = [b"glTF".as_slice(), &2_u32.to_le_bytes(), &20_u32.to_le_bytes(), &2_u32.to_le_bytes(), b"JSON", b"{}"].concat();
        for file in [b"".as_slice(), b"glTF", b"glTF\x02\0\0\0\xff\xff\xff\xff\xff\xff\xff\xffJSON", &empty, b"solid ventricle"] {
            assert!(matches!(of_glb(file), Err(ExportError::NotOurs { .. })), "{file:?}");
        }
    }
}
