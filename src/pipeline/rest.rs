//! When an evolution has ended: the definitive stopping mechanism, the first of the paper's open questions (§9).

use serde::{Deserialize, Serialize};

/// What ended an evolution.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Stop {
    /// Every particle froze on the border.
    AllFrozen,
    /// The particles that are not frozen no longer get anywhere.
    AtRest,
    /// The most steps that were allowed have been taken.
    StepLimit,
}
