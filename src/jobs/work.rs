//! What a job computes: reconstruction, report, surfaces and walls.

use super::{numbers::stages_took, progress::Progress};
use crate::{
    analysis::analyse,
    export::{ExportError, glb, vtu},
    pipeline::{self, PipelineError, Surface, monitor::Monitor, parameters::Parameters},
    report::{self, PolarMaps, Slices, Summary, Timing},
    study::Study,
};
use rayon::prelude::*;
use std::{sync::Arc, time::Instant};
use uuid::Uuid;

/// Name of the report among a job's blobs.
pub const REPORT: &str = "report";
/// Name of the animated surfaces among a job's blobs.
pub const SURFACES: &str = "surfaces.glb";
/// Name of the polar maps among a job's blobs.
pub const POLAR_MAPS: &str = "polar-maps";
/// Name of the slices and contours among a job's blobs.
pub const SLICES: &str = "slices";
/// Name of the output that a list of jobs shows: no blob, but a part of the job.
pub const SUMMARY: &str = "summary";
/// Media type of binary glTF (glTF 2.0 §3.2).
const GLB: &str = "model/gltf-binary";
/// Media type of a VTK XML file, which has none of its own; `model/vnd.vtu` is registered for another vendor's format.
const VTU: &str = "application/xml";

/// Name of one surface of one gate (from 1) among a job's blobs.
pub fn surface_name(gate: usize, surface: Surface) -> String {
    format!("gates/{gate}/{}.glb", surface.name())
}

/// Name of the wall of one gate (from 1) among a job's blobs.
pub fn wall_name(gate: usize) -> String {
    format!("gates/{gate}/wall.vtu")
}

/// One result of a job.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Output {
    /// Name among the job's blobs.
    pub name: String,
    /// Media type of the data.
    pub media_type: &'static str,
    /// The data.
    pub data: Vec<u8>,
}

/// Why there is no result.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum WorkError {
    /// The progress said stop.
    #[error("The work was cancelled.")]
    Cancelled,
    /// The same input would fail again; the sentence is for the user.
    #[error("{message}")]
    Failed {
        /// Stable `snake_case` code.
        code: &'static str,
        /// One or two sentences for the user.
        message: String,
    },
    /// A fault of the program; the text is for the log only.
    #[error("{0}")]
    Internal(String),
}

/// What a worker does with a job. Runs inside the worker's own rayon pool; may panic.
pub type Work = Arc<dyn Fn(&Study, &Parameters, Uuid, &Progress) -> Result<Vec<Output>, WorkError> + Send + Sync>;

/// Reconstructs the study; the results are [`REPORT`], [`POLAR_MAPS`] and [`SLICES`] (JSON), [`SURFACES`] and both surfaces of every gate (binary glTF),
/// and the wall of every gate (VTK).
pub fn reconstruct_and_export(study: &Study, parameters: &Parameters, id: Uuid, progress: &Progress) -> Result<Vec<Output>, WorkError> {
    let reconstruction = pipeline::reconstruct(study, parameters, progress)?;
    // A fit that came to rest early stops short of its steps.
    progress.advance(1, 1);
    let reconstructed = Instant::now();
    let analysis = analyse(study, &reconstruction);
    let timing = Timing { total_ms: progress.elapsed_ms(), stages_ms: progress.stages_ms() };
    let report = report::build(&id.to_string(), study, &reconstruction, &analysis, &timing);
    let summary = serde_json::to_vec(&Summary::of(&report)).map_err(|error| WorkError::Internal(format!("summary: {error}")))?;
    let report = serde_json::to_vec(&report).map_err(|error| WorkError::Internal(format!("report: {error}")))?;
    let maps = PolarMaps::of(&id.to_string(), &analysis);
    let maps = serde_json::to_vec(&maps).map_err(|error| WorkError::Internal(format!("polar maps: {error}")))?;
    let slices = Slices::of(&id.to_string(), study, &reconstruction, &analysis);
    let slices = serde_json::to_vec(&slices).map_err(|error| WorkError::Internal(format!("slices: {error}")))?;
    // This takes as long as the preset `paper` itself: two surfaces and a wall of every gate.
    let of_gate = |gate: usize| {
        if progress.is_cancelled() {
            return Err(WorkError::Cancelled);
        }
        let mut outputs = Vec::with_capacity(3);
        for surface in Surface::BOTH {
            let data = glb::surface(study, &reconstruction, gate, surface)?;
            outputs.push(Output { name: surface_name(gate + 1, surface), media_type: GLB, data });
        }
        outputs.push(Output { name: wall_name(gate + 1), media_type: VTU, data: vtu::wall(study, &reconstruction, gate)? });
        Ok(outputs)
    };
    let (cycle, gates) = rayon::join(
        || glb::cycle(study, &reconstruction, &analysis),
        || (0..reconstruction.gates.len()).into_par_iter().map(of_gate).collect::<Vec<_>>(),
    );
    let mut outputs = vec![
        Output { name: SUMMARY.to_owned(), media_type: "application/json", data: summary },
        Output { name: SLICES.to_owned(), media_type: "application/json", data: slices },
        Output { name: REPORT.to_owned(), media_type: "application/json", data: report },
        Output { name: SURFACES.to_owned(), media_type: GLB, data: cycle? },
        Output { name: POLAR_MAPS.to_owned(), media_type: "application/json", data: maps },
    ];
    for of_gate in gates {
        outputs.extend(of_gate?);
    }
    stages_took(progress, parameters.preset, progress.results_made_since(reconstructed));
    Ok(outputs)
}

impl From<PipelineError> for WorkError {
    fn from(error: PipelineError) -> Self {
        match error {
            PipelineError::Cancelled => Self::Cancelled,
            error => Self::Failed { code: error.code(), message: error.to_string() },
        }
    }
}

impl From<ExportError> for WorkError {
    fn from(error: ExportError) -> Self {
        match error {
            ExportError::Json(error) => Self::Internal(format!("glTF: {error}")),
            ExportError::Texture(error) => Self::Internal(format!("glTF: {error}")),
            ExportError::Compression(error) => Self::Internal(format!("VTK: {error}")),
            error => Self::Failed { code: "export_failed", message: error.to_string() },
        }
    }
}
