//! Ventricle reconstructs the left ventricle from gated cardiac SPECT.
//!
//! Data goes one way through the house: `http → intake → jobs → pipeline → report/export → jobs → http`.
//!
//! | module | what it is |
//! |---|---|
//! | [`volume`] | voxels, millimetres and the map between them |
//! | [`study`] | a gated study: counts on a grid, where it lies in the patient |
//! | [`subject`] | whom a study is of, where that is kept |
//! | [`mesh`] | closed triangle meshes and what is measured on them |
//! | [`phantom`] | analytic beating ventricles with exact volumes |
//! | [`codecs`] | compressed frames → samples, in a child process |
//! | [`intake`] | bytes → study: DICOM, NIfTI, JSON, with their limits |
//! | [`pipeline`] | study → reconstruction, pure functions, one file a stage |
//! | [`report`] | reconstruction → what people read |
//! | [`export`] | reconstruction → what people look at |
//! | [`archive`] | stored results → what PACS and health records take |
//! | [`paper`] | the tables and figures of the paper, redone |
//! | [`drawing`] | tables and pictures for people |
//! | [`accuracy`] | how far both presets are from the truth |
//! | [`parameters`] | parameters as a client writes them |
//! | [`jobs`] | what is stored, queued and worked on |
//! | [`callbacks`] | who is told when a job ends, and where its result is sent |
//! | [`dimse`] | DICOM's own network protocol: images received, results sent |
//! | [`access`] | who may come in, as whom, and how much |
//! | [`http`] | the service |
//! | [`networks`], [`tls`] | ranges of addresses; certificates, and connections encrypted with them |
//! | [`config`], [`telemetry`] | settings; logs and metrics |
//! | [`traces`] | what requests and jobs took, step by step, told to a collector |

pub mod access;
pub mod accuracy;
pub mod analysis;
pub mod archive;
pub mod assembly;
pub mod callbacks;
pub mod codecs;
pub mod config;
pub mod dimse;
pub mod drawing;
mod elements;
pub mod export;
pub mod http;
pub mod intake;
pub mod jobs;
pub mod mesh;
pub mod networks;
pub mod paper;
pub mod parameters;
pub mod phantom;
pub mod pipeline;
pub mod report;
pub mod study;
pub mod subject;
pub mod telemetry;
pub mod tls;
pub mod traces;
pub mod volume;
