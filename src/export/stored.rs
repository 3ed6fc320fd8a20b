//! Reads back the binary glTF that this program stored.

use super::ExportError;
use crate::pipeline::Surface;
use glam::{DVec3, Vec3};
use gltf_json::{
    Accessor, Index, Root,
    accessor::{ComponentType, GenericComponentType},
    mesh::{MorphTarget, Primitive, Semantic},
    validation::Checked,
};
use serde::Deserialize;

/// Both surfaces over the cycle, as [`super::glb::cycle`] wrote them.
#[derive(Debug)]
pub struct StoredCycle<'a> {
    root: Root,
    binary: &'a [u8],
    facts: Facts,
}

/// What the file says of itself.
#[derive(Debug, Deserialize)]
struct Facts {
    frame: String,
    /// Absent in files of versions before 0.2.
    #[serde(default)]
    walls: Option<Walls>,
}

/// Unit vectors in the scene from the long axis to two walls, and from apex to base.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
pub struct Walls {
    /// To the anterior wall.
    pub anterior: [f64; 3],
    /// To the septum.
    pub septal: [f64; 3],
    /// From apex to base.
    pub base: [f64; 3],
}

/// One surface of one gate in the scene: metres about the heart's centre.
#[derive(Debug, Clone, PartialEq)]
pub struct StoredSurface {
    /// Corners.
    pub points: Vec<DVec3>,
    /// Unit normals of the corners, outward.
    pub normals: Vec<DVec3>,
    /// Triangles, counter-clockwise seen from outside.
    pub triangles: Vec<[u32; 3]>,
}

impl<'a> StoredCycle<'a> {
    /// Opens the file.
    ///
    /// # Errors
    /// [`ExportError::NotOurs`] for any other file.
    pub fn open(glb: &'a [u8]) -> Result<Self, ExportError> {
        let (json, binary) = chunks(glb).ok_or(ExportError::NotOurs { what: "container" })?;
        let root = Root::from_slice(json)?;
        let extras = root.scenes.first().and_then(|scene| scene.extras.as_ref()).ok_or(ExportError::NotOurs { what: "scene" })?;
        let facts = serde_json::from_str(extras.get())?;
        Ok(Self { root, binary, facts })
    }

    /// Whether the scene's axes are the patient's: +X left, +Y head, +Z front.
    pub fn in_patient_frame(&self) -> bool {
        self.facts.frame == "patient"
    }

    /// Where the walls are, if the file says so.
    pub fn walls(&self) -> Option<Walls> {
        self.facts.walls
    }

    /// A surface at a gate, counted from 1.
    ///
    /// # Errors
    /// [`ExportError::NotOurs`] where the file has no such surface.
    pub fn surface(&self, surface: Surface, gate: usize) -> Result<StoredSurface, ExportError> {
        let not_ours = |what| move || ExportError::NotOurs { what };
        let mesh = self.root.meshes.iter().find(|mesh| mesh.name.as_deref() == Some(surface.name())).ok_or_else(not_ours("mesh"))?;
        let first = mesh.primitives.first().ok_or_else(not_ours("mesh"))?;
        // The base mesh is gate 1, and alone where there is one gate.
        let target = first.targets.as_ref().map(|targets| targets.get(gate.wrapping_sub(1)).ok_or_else(not_ours("gate"))).transpose()?;
        let moved = |semantic, displacement: fn(&MorphTarget) -> Option<Index<Accessor>>| -> Option<Vec<DVec3>> {
            let base = self.triples(*first.attributes.get(&Checked::Valid(semantic))?)?;
            let base = base.into_iter().map(|triple| Vec3::from_array(triple).as_dvec3());
            let Some(target) = target else { return Some(base.collect()) };
            let by = self.triples(displacement(target)?)?;
            Some(base.zip(by).map(|(from, by)| from + Vec3::from_array(by).as_dvec3()).collect())
        };
        let points = moved(Semantic::Positions, |target| target.positions).ok_or_else(not_ours("positions"))?;
        let normals = moved(Semantic::Normals, |target| target.normals).ok_or_else(not_ours("normals"))?;
        let triangles: Option<Vec<Vec<[u32; 3]>>> =
            mesh.primitives.iter().map(|primitive| self.triangles(primitive, points.len())).collect();
        let triangles = triangles.ok_or_else(not_ours("triangles"))?.concat();
        Ok(StoredSurface { points, normals, triangles })
    }

    fn triples(&self, accessor: Index<Accessor>) -> Option<Vec<[f32; 3]>> {
        positions(&self.root, self.root.accessors.get(accessor.value())?, self.binary)
    }

    fn triangles(&self, primitive: &Primitive, points: usize) -> Option<Vec<[u32; 3]>> {
        let corners = indices(&self.root, self.root.accessors.get(primitive.indices?.value())?, self.binary)?;
        let (triangles, _) = corners.as_chunks::<3>();
        triangles.iter().flatten().all(|&corner| (corner as usize) < points).then(|| triangles.to_vec())
    }
}

/// The JSON and the binary chunk (glTF 2.0, 4.4).
pub(super) fn chunks(glb: &[u8]) -> Option<(&[u8], &[u8])> {
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

/// Triples, as they are stored.
pub(super) fn positions(root: &Root, accessor: &Accessor, binary: &[u8]) -> Option<Vec<[f32; 3]>> {
    let (bytes, stride, count) = array(root, accessor, binary, 12)?;
    let one = |vertex: usize| {
        let (components, _) = bytes.get(vertex * stride..vertex * stride + 12)?.as_chunks::<4>();
        Some(std::array::from_fn(|axis| f32::from_le_bytes(components[axis])))
    };
    (0..count).map(one).collect()
}

/// Corners of triangles, three a triangle.
pub(super) fn indices(root: &Root, accessor: &Accessor, binary: &[u8]) -> Option<Vec<u32>> {
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
