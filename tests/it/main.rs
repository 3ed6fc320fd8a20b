//! The one integration-test binary; modules by subject.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stderr, missing_docs)]

mod accuracy;
mod backup;
mod chaos;
mod cluster;
mod codecs;
mod demo;
mod dicomweb;
mod dimse;
mod encapsulated;
mod fuzz;
mod hostile;
mod http;
mod imports;
mod intake;
mod jobs;
mod missing;
mod models;
mod nodes;
mod openapi;
mod operations;
mod paper;
mod parted;
mod phantom;
mod pipeline;
mod place;
mod pose;
mod quality;
mod report;
mod restart;
mod retention;
mod served;
mod shared;
mod surfaces;
mod upgrade;
mod wall;
