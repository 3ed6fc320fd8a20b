//! What is accepted, queued, worked on and kept.
//!
//! A job is accepted when its row and its input are committed to disk, not before; it is finished when its results and its final
//! state are committed together. Between the two it may be claimed by any worker, which holds it by a lease it must keep renewing. The
//! number of the attempt is counted at the claim and named in every later statement of the worker (a fencing token): a worker that lost
//! its lease can no longer change anything.
//!
//! | file | what it is |
//! |---|---|
//! | `job.rs` | what a caller sees of a job |
//! | [`store`] | the rows: read, list, delete |
//! | `submit.rs` | how a job is accepted |
//! | `inbox.rs` | DICOM instances that wait for the rest of their study |
//! | `lease.rs` | the worker's side of the rows: claim, heartbeat, finish, give back, reap |
//! | `queue.rs` | limits, reservations and the measured rate |
//! | `worker.rs`, `compute.rs`, `threads.rs`, `reaper.rs` | who works, on which threads and how many, and who takes back what lost workers held |
//! | [`priority`] | how threads that compute stand back behind those that answer |
//! | `clock.rs` | what is done when the database's clock is set |
//! | `ending.rs`, `expiry.rs` | what follows when a job ends; what is deleted when its time is over |
//! | `deliveries.rs` | who claims and settles what is to be told of a job's end |
//! | `backoff.rs` | pauses between attempts at what failed for the moment |
//! | `progress.rs` | how a running reconstruction is watched and stopped |
//! | `traced.rs` | what traces are told of an attempt |
//! | `work.rs` | what a job computes: reconstruction, report, surfaces |
//! | `input.rs` | the stored form of a study |
//! | `database.rs`, `schema.rs`, `embedded.rs` | one SQL text on two engines, and what SQLite alone needs |
//! | `watch.rs`, `listen.rs` | who waits for a change of which job, and who hears of those that other nodes make |
//! | `feed.rs` | what everyone is told who listens to all jobs |

mod backoff;
mod clock;
mod compute;
mod database;
mod deliveries;
mod embedded;
mod ending;
mod error;
mod expiry;
mod feed;
mod inbox;
pub mod input;
mod job;
mod lease;
mod listen;
mod numbers;
pub mod priority;
mod probe;
mod progress;
mod queue;
mod reaper;
mod schema;
mod settings;
pub mod store;
mod submit;
mod threads;
mod traced;
mod watch;
pub mod work;
mod worker;

pub use clock::ClockSet;
pub use deliveries::{Delivery, DeliveryClaim, DeliveryKind, Settled};
pub use error::{OwnerFull, QueueFull, StoreError, SubmitError};
pub use feed::News;
pub use inbox::{Filed, Members, NewInstance, Series, StoredInstance};
pub use job::{ANONYMOUS, Blob, Counts, Deletion, Job, JobError, KeptInput, ListQuery, NewJob, Page, State, Submitted};
pub use lease::{Claim, Finish, Heartbeat, Outcome, Reaped};
pub use probe::Probe;
pub use progress::{Progress, Snapshot};
pub use queue::Reservation;
pub use settings::{Backend, StoreSettings, WorkerSettings};
pub use store::Store;
pub use threads::Threads;
pub use work::{Output, Work, WorkError};
pub use worker::{Drained, Workers, start_workers};
