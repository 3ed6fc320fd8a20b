//! The service as its clients meet it: in process, over a real store, with work that the test decides; and once over a socket.

mod again;
pub(crate) mod archived;
mod bounding;
mod callbacks;
mod comparison;
mod following;
mod guarded;
mod harness;
mod limits;
mod news;
mod operating;
mod pictures;
mod presets;
mod pressure;
mod refusing;
mod retention;
mod slices;
mod socket;
mod submitting;
mod tokens;
mod viewer;
