//! One surface of one gate as a binary STL, made from the binary glTF in which it is stored: the same vertices, in mm.
//!
//! Coordinates are those of `wall.vtu`: the patient's axes (LPS) when the study has an orientation, else the grid's. The glTF is single
//! precision about the heart's own centre, so a vertex moves by some nanometres, and by some ten more as the STL's single precision counts
//! from the frame's origin.

use super::ExportError;
use glam::{DVec3, Vec3};
use gltf_json::{
    Accessor, Root,
    accessor::{ComponentType, GenericComponentType},
    mesh::Semantic,
    validation::Checked,
};
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

/// The JSON and the binary chunk (glTF 2.0, 4.4).
fn chunks(glb: &[u8]) -> Option<(&[u8], &[u8])> {
    let word = |at: usize| glb.get(at..at + 4).and_then(|bytes| bytes.try_into().ok()).map(u32::from_le_bytes);
    if glb.get(..4)? != b"glTF" || glb.get(16..20)? != b"JSON" {
        return None;
    }
    let json_end = 20 + word(12)? as usize;
    let binary_start = json_end + 8;
    if glb.get(json_end + 4..binary_start)? != b"BIN\0" {
        return None;
    }
    Some((glb.get(20..json_end)?, glb.get(binary_start..binary_start + word(json_end)? as usize)?))
}

/// The bytes of an array from its first element on, its stride and its number of elements.
fn array<'a>(root: &Root, accessor: &Accessor, binary: &'a [u8], tight: usize) -> Option<(&'a [u8], usize, usize)> {
    let view = root.buffer_views.get(accessor.buffer_view?.value())?;
    let offset = |part: Option<gltf_json::validation::USize64>| part.map_or(0, |part| part.0 as usize);
    let bytes = binary.get(offset(view.byte_offset)..)?.get(offset(accessor.byte_offset)..)?;
    Some((bytes, view.byte_stride.map_or(tight, |stride| stride.0), accessor.count.0 as usize))
}

fn positions(root: &Root, accessor: &Accessor, binary: &[u8]) -> Option<Vec<[f32; 3]>> {
    let (bytes, stride, count) = array(root, accessor, binary, 12)?;
    let one = |vertex: usize| {
        let (components, _) = bytes.get(vertex * stride..vertex * stride + 12)?.as_chunks::<4>();
        Some(std::array::from_fn(|axis| f32::from_le_bytes(components[axis])))
    };
    (0..count).map(one).collect()
}

fn indices(root: &Root, accessor: &Accessor, binary: &[u8]) -> Option<Vec<u32>> {
    let Checked::Valid(GenericComponentType(kind)) = accessor.component_type else { return None };
    match kind {
        ComponentType::U16 => {
            let (bytes, _, count) = array(root, accessor, binary, 2)?;
            Some(bytes.get(..2 * count)?.as_chunks::<2>().0.iter().map(|&index| u16::from_le_bytes(index).into()).collect())
        }
        ComponentType::U32 => {
            let (bytes, _, count) = array(root, accessor, binary, 4)?;
            Some(bytes.get(..4 * count)?.as_chunks::<4>().0.iter().map(|&index| u32::from_le_bytes(index)).collect())
        }
        _ => None,
    }
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
