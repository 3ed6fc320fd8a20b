//! One file a subcommand, the table two of them print, and the memory that the service keeps.

pub(crate) mod accuracy;
pub(crate) mod decode_frames;
pub(crate) mod demo;
pub(crate) mod healthcheck;
pub(crate) mod keys;
#[cfg(unix)]
mod memory;
pub(crate) mod openapi;
pub(crate) mod phantom;
pub(crate) mod reconstruct;
pub(crate) mod serve;
mod table;
pub(crate) mod tables;
