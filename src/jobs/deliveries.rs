//! The rows of what is to be told, or sent, when a job ended: claim, settle. They are written in `ending.rs` and go with their job.
//!
//! As with jobs, the attempt is counted at the claim and named when it is settled: an attempt whose lease is over changes nothing.

use super::{
    database::{Row, values},
    error::StoreError,
    lease::milliseconds,
    store::{Store, parse_id},
};
use std::time::Duration;
use uuid::Uuid;

/// What is delivered.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum DeliveryKind {
    /// The news that a job ended.
    Callback,
    /// The result of a job that succeeded.
    Result,
}

impl DeliveryKind {
    /// All of them.
    pub const ALL: [Self; 2] = [Self::Callback, Self::Result];

    /// As the rows have it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Callback => "callback",
            Self::Result => "result",
        }
    }

    fn parse(name: &str) -> Result<Self, StoreError> {
        let kind = Self::ALL.into_iter().find(|kind| kind.name() == name);
        kind.ok_or_else(|| StoreError::Damaged { what: format!("a delivery of the kind {name}") })
    }
}

/// A delivery held by this node.
#[derive(Clone, PartialEq, Eq)]
pub struct DeliveryClaim {
    /// The delivery; the same in all attempts.
    pub id: Uuid,
    /// The job it tells of.
    pub job: Uuid,
    /// What it is.
    pub kind: DeliveryKind,
    /// Where it goes.
    pub url: String,
    /// The fencing token, from 1.
    pub attempt: i64,
}

impl std::fmt::Debug for DeliveryClaim {
    /// Without the URL, which may hold what only the receiver should know.
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter
            .debug_struct("DeliveryClaim")
            .field("id", &self.id)
            .field("kind", &self.kind)
            .field("attempt", &self.attempt)
            .finish_non_exhaustive()
    }
}

/// How an attempt ended.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Settled {
    /// The receiver has it.
    Delivered,
    /// It is to be tried again.
    Again {
        /// After this time.
        after: Duration,
        /// Why, for people who read the table.
        why: String,
    },
    /// It is not tried again.
    GivenUp {
        /// Why, likewise.
        why: String,
    },
    /// It was not brought to its end: any node may take it at once. The attempt stays counted, since the receiver may have it.
    GivenBack,
}

/// A delivery as it was when it was read.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Delivery {
    /// The delivery.
    pub id: Uuid,
    /// What it is.
    pub kind: DeliveryKind,
    /// `pending`, `delivered` or `given_up`.
    pub state: String,
    /// How often it was claimed.
    pub attempts: i64,
    /// Why the last attempt failed.
    pub last_error: Option<String>,
}

impl Store {
    /// Takes the delivery of these kinds that is due for longest, if any, and counts the attempt. Nobody else gets it for the time of the lease.
    pub async fn claim_delivery(&self, kinds: &[DeliveryKind], lease: Duration) -> Result<Option<DeliveryClaim>, StoreError> {
        let sql = "UPDATE deliveries SET attempts = attempts + 1, lease_until = {now} + $1
            WHERE state = 'pending' AND id = (
                SELECT id FROM deliveries
                WHERE state = 'pending' AND run_after <= {now} AND (lease_until IS NULL OR lease_until < {now}) AND kind IN ($2, $3)
                ORDER BY run_after, id LIMIT 1 {skip_locked}
            )
            RETURNING id, job_id, url, attempts, kind";
        let wanted = |kind: DeliveryKind| if kinds.contains(&kind) { kind.name() } else { "" };
        let values = values![milliseconds(lease), wanted(DeliveryKind::Callback), wanted(DeliveryKind::Result)];
        let Some(row) = self.inner.database.fetch_one(sql, values).await? else { return Ok(None) };
        Ok(Some(DeliveryClaim {
            id: parse_id(&row.get::<String>(0)?)?,
            job: parse_id(&row.get::<String>(1)?)?,
            url: row.get(2)?,
            attempt: row.get(3)?,
            kind: DeliveryKind::parse(&row.get::<String>(4)?)?,
        }))
    }

    /// Stores how an attempt ended; returns whether the delivery still was its own.
    pub async fn settle_delivery(&self, claim: &DeliveryClaim, settled: &Settled) -> Result<bool, StoreError> {
        let (state, after, why) = match settled {
            Settled::Delivered => ("delivered", Duration::ZERO, None),
            Settled::Again { after, why } => ("pending", *after, Some(why.clone())),
            Settled::GivenUp { why } => ("given_up", Duration::ZERO, Some(why.clone())),
            Settled::GivenBack => ("pending", Duration::ZERO, Some("given back by a node that stopped".to_owned())),
        };
        let sql = "UPDATE deliveries SET state = $3, run_after = {now} + $4, lease_until = NULL, last_error = $5,
                finished_at = CASE WHEN $3 = 'pending' THEN NULL ELSE {now} END
            WHERE id = $1 AND attempts = $2 AND state = 'pending'
            RETURNING id";
        let values = values![claim.id, claim.attempt, state, milliseconds(after), why];
        Ok(self.inner.database.fetch_one(sql, values).await?.is_some())
    }

    /// What became of telling of a job's end.
    pub async fn deliveries(&self, job: Uuid) -> Result<Vec<Delivery>, StoreError> {
        let sql = "SELECT id, state, attempts, last_error, kind FROM deliveries WHERE job_id = $1 ORDER BY id";
        let read = |row: &Row| {
            Ok(Delivery {
                id: parse_id(&row.get::<String>(0)?)?,
                state: row.get(1)?,
                attempts: row.get(2)?,
                last_error: row.get(3)?,
                kind: DeliveryKind::parse(&row.get::<String>(4)?)?,
            })
        };
        self.inner.database.fetch(sql, values![job]).await?.iter().map(read).collect()
    }
}
