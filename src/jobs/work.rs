//! What a job computes.

use super::progress::Progress;
use crate::{pipeline::parameters::Parameters, study::Study};
use std::sync::Arc;
use uuid::Uuid;

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
    #[error("cancelled")]
    Cancelled,
    /// The same input would fail again; the sentence is for the user.
    #[error("{message}")]
    Failed {
        /// Stable snake_case code.
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
