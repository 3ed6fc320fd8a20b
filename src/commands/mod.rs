//! One file a subcommand.

pub mod demo;
pub mod healthcheck;
pub mod openapi;
pub mod phantom;
pub mod reconstruct;
pub mod serve;
