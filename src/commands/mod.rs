//! One file a subcommand, and the table two of them print.

pub(crate) mod accuracy;
pub(crate) mod decode_frames;
pub(crate) mod demo;
pub(crate) mod healthcheck;
pub(crate) mod keys;
pub(crate) mod openapi;
pub(crate) mod phantom;
pub(crate) mod reconstruct;
pub(crate) mod serve;
mod table;
pub(crate) mod tables;
