//! Who may come in, as whom, and how much.
//!
//! A caller presents an API key or a token of an OpenID provider. What is known of both becomes one thing, a [`Caller`]: an owner, whose jobs
//! are all that it sees, and scopes. Nothing here knows of HTTP: what is given is the value of the header `Authorization` and an address.

mod attempts;
mod audit;
mod authorization;
mod issuer;
mod key;
mod keyring;
mod limits;
mod signature;
mod token;

pub use attempts::Attempts;
pub use audit::{Audit, AuditError, AuditFile, Deed};
pub use authorization::{Presented, Unreadable};
pub use issuer::{Fetch, Issuer, IssuerSettings};
pub use key::Made;
pub use keyring::{KeyRecord, Keyring, KeyringError, Wished, add, list, revoke};
pub use limits::{Allowance, Allowances, DayBytes, Left, OverLimit, Standing};
pub use token::{Expected, TokenError};

use crate::jobs::ANONYMOUS;
use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use std::{net::IpAddr, sync::Arc};

/// What a caller may do. Each for its own owner only.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Scope {
    /// Send studies, have them computed again, cancel and delete jobs.
    Submit,
    /// Look at jobs and results.
    Read,
    /// Both, and the service's metrics.
    Admin,
}

impl Scope {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Submit, Self::Read, Self::Admin];

    /// As it is written on the command line, in the file of keys and in tokens.
    pub fn name(self) -> &'static str {
        match self {
            Self::Submit => "submit",
            Self::Read => "read",
            Self::Admin => "admin",
        }
    }

    /// The scope of this name.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|scope| scope.name() == name)
    }
}

/// Longest name of an owner, in bytes.
const LONGEST_OWNER: usize = 128;

/// Whether this can be the name of an owner: 1 to 128 bytes without control characters, nor white space at its ends.
pub fn is_owner(name: &str) -> bool {
    (1..=LONGEST_OWNER).contains(&name.len()) && name.trim() == name && !name.chars().any(char::is_control)
}

/// What makes a caller the one it is.
#[derive(Debug, Clone, PartialEq, Eq)]
enum Credential {
    /// Nobody was asked.
    None,
    /// A key, by its name.
    Key(String),
    /// A token, until its time is over.
    Token { expires_at: Timestamp },
}

/// Who calls.
#[derive(Debug, Clone)]
pub struct Caller {
    /// Whose jobs are seen and made.
    pub owner: String,
    /// How the caller is known in the audit log: the id of a key, or the subject of a token.
    pub known_as: String,
    /// What it may do.
    pub scopes: Vec<Scope>,
    /// What it may use, and has used; `None`: nothing is counted.
    pub allowance: Option<Arc<Allowance>>,
    /// Whether it sees the jobs of all owners: where nobody is asked who he is.
    pub sees_all: bool,
    /// Whether it came by Basic, which browsers keep and send by themselves.
    pub by_basic: bool,
    credential: Credential,
}

impl Caller {
    /// Everybody, where the service asks nobody.
    pub fn anybody() -> Self {
        Self {
            owner: ANONYMOUS.to_owned(),
            known_as: ANONYMOUS.to_owned(),
            scopes: vec![Scope::Admin],
            allowance: None,
            sees_all: true,
            by_basic: false,
            credential: Credential::None,
        }
    }

    /// The only owner whose jobs it sees.
    pub fn sees_only(&self) -> Option<&str> {
        (!self.sees_all).then_some(self.owner.as_str())
    }

    /// Most jobs of its owner that may wait; `None`: as many as come.
    pub fn queued_jobs(&self) -> Option<u64> {
        self.allowance.as_ref().and_then(|allowance| allowance.queued_jobs())
    }

    /// Whether it may do what needs a scope.
    pub fn may(&self, needed: Scope) -> bool {
        self.scopes.iter().any(|&scope| scope == needed || scope == Scope::Admin)
    }
}

/// Why somebody does not come in.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum Refusal {
    /// Nothing was presented.
    #[error(
        "The request has no header Authorization. Send `Authorization: Bearer …` with an API key or a token, or Basic with an API key as the password."
    )]
    Nothing,
    /// What was presented cannot be read.
    #[error(transparent)]
    Unreadable(#[from] Unreadable),
    /// No such key: unknown, revoked or mistyped. Which of them is not told.
    #[error("The API key is not valid: it is unknown, revoked or not whole. Ask the operator for one (ventricle keys add).")]
    NoSuchKey,
    /// Its time is over.
    #[error("The API key has expired. Ask the operator for another one.")]
    Expired,
    /// A token that is not accepted.
    #[error(transparent)]
    Token(#[from] TokenError),
    /// Too many refusals of this client.
    #[error("Too many requests of this address were refused. Wait {retry_after_s} s, and check the API key or token that they carry.")]
    TooManyAttempts {
        /// Seconds to wait.
        retry_after_s: u64,
    },
}

/// What the service asks of its callers.
pub struct Access {
    keyring: Option<Arc<Keyring>>,
    issuer: Option<Arc<Issuer>>,
    attempts: Attempts,
    allowances: Allowances,
}

impl Access {
    /// Asks for a key of the ring or a token of the issuer.
    pub fn new(keyring: Option<Arc<Keyring>>, issuer: Option<Arc<Issuer>>, allowances: Allowances) -> Self {
        Self { keyring, issuer, attempts: Attempts::default(), allowances }
    }

    /// With another limit on the refusals of an address.
    #[must_use]
    pub fn with_attempts(self, attempts: Attempts) -> Self {
        Self { attempts, ..self }
    }

    /// Asks nobody.
    pub fn open() -> Self {
        Self::new(None, None, Allowances::default())
    }

    /// Whether anybody may come in.
    pub fn is_open(&self) -> bool {
        self.keyring.is_none() && self.issuer.is_none()
    }

    /// Most jobs of an owner that may wait, for what no single caller asks for; `None`: as many as come.
    pub fn queued_jobs_of(&self, owner: &str) -> Option<u64> {
        if self.is_open() {
            return None;
        }
        let records = self.keyring.as_ref().map(|ring| ring.records_of(owner)).unwrap_or_default();
        self.allowances.queued_jobs(records.iter().map(|record| &record.limits))
    }

    /// Reads the keys again if their file is another; returns whether it was.
    ///
    /// # Errors
    /// It cannot be used; the keys stay as they were.
    pub fn refresh_keys(&self) -> Result<bool, KeyringError> {
        self.keyring.as_ref().map_or(Ok(false), |keyring| keyring.refresh())
    }

    /// Who presents this value of the header `Authorization`, from that address.
    ///
    /// A right key or token is let in however many wrong ones came from its address: who is behind a proxy with somebody who guesses is not
    /// locked out, and guessing is hopeless (256 bits).
    ///
    /// # Errors
    /// [`Refusal`]; where the same address was refused too often, [`Refusal::TooManyAttempts`].
    pub async fn admit(&self, authorization: Option<&[u8]>, address: IpAddr) -> Result<Caller, Refusal> {
        if self.is_open() {
            return Ok(Caller::anybody());
        }
        match self.recognise(authorization).await {
            // To be asked is no attempt; and a provider that does not answer is not the caller's fault.
            Err(Refusal::Nothing) => Err(Refusal::Nothing),
            Err(Refusal::Token(TokenError::Unavailable)) => Err(TokenError::Unavailable.into()),
            Err(refusal) => Err(self.attempts.refused(address).map_or(refusal, |retry_after_s| Refusal::TooManyAttempts { retry_after_s })),
            Ok(caller) => Ok(caller),
        }
    }

    /// Whether a caller that was let in would still be: its key is not revoked, and its time not over. For answers that go on for long.
    pub fn stands(&self, caller: &Caller) -> bool {
        let now = Timestamp::now();
        match &caller.credential {
            Credential::None => true,
            Credential::Key(id) => {
                let record = self.keyring.as_ref().and_then(|ring| ring.record(id));
                record.is_some_and(|record| !record.has_expired(now) && record.owner == caller.owner)
            }
            Credential::Token { expires_at } => now < *expires_at,
        }
    }

    async fn recognise(&self, authorization: Option<&[u8]>) -> Result<Caller, Refusal> {
        let presented = Presented::read(authorization.ok_or(Refusal::Nothing)?)?;
        let (secret, by_basic) = (presented.secret(), matches!(presented, Presented::Basic(_)));
        if let (false, Some(issuer)) = (key::is_key(secret), &self.issuer) {
            let bearer = issuer.bearer(secret).await?;
            let allowance = self.allowances.of(&format!("token {}", bearer.subject), &keyring::Wished::default());
            let (owner, known_as, scopes) = (bearer.owner, bearer.subject, bearer.scopes);
            let credential = Credential::Token { expires_at: bearer.expires_at };
            return Ok(Caller { owner, known_as, scopes, allowance: Some(allowance), sees_all: false, by_basic, credential });
        }
        let record = self.keyring.as_ref().and_then(|ring| ring.find(secret)).ok_or(Refusal::NoSuchKey)?;
        if record.has_expired(Timestamp::now()) {
            return Err(Refusal::Expired);
        }
        let allowance = self.allowances.of(&format!("key {}", record.id), &record.limits);
        let (owner, known_as, scopes) = (record.owner.clone(), record.id.clone(), record.scopes.clone());
        let credential = Credential::Key(record.id.clone());
        Ok(Caller { owner, known_as, scopes, allowance: Some(allowance), sees_all: false, by_basic, credential })
    }
}
