//! From a reconstruction to what people look at. Pure functions that return bytes.

mod buffer;
pub mod frame;
pub mod glb;
pub mod slices;
pub mod stl;
pub mod stored;
pub mod variants;
pub mod vtu;

use crate::pipeline::Surface;

/// Why surfaces could not be written.
#[derive(Debug, thiserror::Error)]
pub enum ExportError {
    /// The reconstruction holds no gate.
    #[error("The reconstruction has no gates, so there is nothing to draw.")]
    Empty,
    /// A gate outside the cycle was asked for.
    #[error("Gate {gate} does not exist: the reconstruction has {gates}.")]
    NoSuchGate {
        /// Counted from 1.
        gate: usize,
        /// Gates there are.
        gates: usize,
    },
    /// A mesh of the cycle has other triangles than the first gate's.
    #[error("Gate {gate}: the {} mesh does not have the topology of gate 1, so the cycle cannot be animated.", surface.name())]
    Topology {
        /// Counted from 1.
        gate: usize,
        /// Which surface.
        surface: Surface,
    },
    /// A vertex is infinite or not a number.
    #[error("Gate {gate}: the {} mesh has a vertex that is not finite.", surface.name())]
    NotFinite {
        /// Counted from 1.
        gate: usize,
        /// Which surface.
        surface: Surface,
    },
    /// The file would not fit the format's 32-bit lengths.
    #[error("The surfaces need {bytes} bytes, more than a binary glTF can hold.")]
    TooLarge {
        /// Bytes needed.
        bytes: usize,
    },
    /// The JSON part could not be written.
    #[error("The glTF document could not be written: {0}.")]
    Json(#[from] serde_json::Error),
    /// An array could not be compressed.
    #[error("The wall could not be written: {0}.")]
    Compression(#[from] std::io::Error),
    /// A texture or the picture of slices could not be written.
    #[error("A picture could not be written: {0}.")]
    Texture(#[from] png::EncodingError),
    /// A stored surface is not as it was written.
    #[error("The stored surface has no {what} as this program writes it.")]
    NotOurs {
        /// What is missing.
        what: &'static str,
    },
    /// Both surfaces of a gate differ in topology.
    #[error("Gate {gate}: the surfaces do not have the same topology, so there are no tetrahedra between them.")]
    NoWall {
        /// Counted from 1.
        gate: usize,
    },
}
