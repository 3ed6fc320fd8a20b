//! Who is told when a job ends: a signed POST to the URL that a client or the operator gave. And where results go, by the same rules and the
//! same schedule.
//!
//! A row of `deliveries` is written in the transaction that ends the job ([`crate::jobs`]); here it is claimed, sent and settled. A URL is
//! a wish of someone else that this service connects somewhere, so that where it may connect is decided here, on the very address that is
//! connected to.
//!
//! | file | what it is |
//! |---|---|
//! | `address.rs` | which addresses are nobody's business |
//! | `allow.rs` | what the operator allows nevertheless |
//! | `target.rs` | a URL, checked |
//! | `signature.rs` | how a receiver knows who sent it |
//! | `send.rs` | one connection, and one request over it |
//! | `destination.rs`, `results.rs` | where results go; how one is sent by STOW-RS or C-STORE |
//! | `schedule.rs` | when it is tried again |
//! | `deliver.rs` | who claims, sends and settles |

mod address;
mod allow;
mod deliver;
mod destination;
mod results;
mod schedule;
mod send;
mod signature;
mod target;

pub use allow::{AllowError, Allowed};
pub use deliver::{Body, Deliveries, DeliverySettings, start};
pub use destination::{Destination, DestinationError};
pub use results::{Document, Results};
pub use schedule::Schedule;
pub use send::{RootsError, Sender};
pub use signature::Signer;
pub use target::{Target, TargetError};

use std::sync::Arc;

/// What is asked of a callback at submission.
#[derive(Debug, Clone)]
pub struct Rules {
    /// What the operator allows beyond public addresses and https.
    pub allowed: Arc<Allowed>,
    /// The URL of jobs that give none.
    pub default_url: Option<String>,
}

impl Rules {
    /// The URL to tell of a job's end, if any: the one asked for, checked, or the default.
    pub fn url(&self, requested: Option<String>) -> Result<Option<String>, TargetError> {
        let Some(url) = requested else { return Ok(self.default_url.clone()) };
        Target::parse(&url, &self.allowed)?;
        Ok(Some(url))
    }
}
