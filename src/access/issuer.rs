//! The keys of an OpenID provider: where they are, when they are fetched again, and what is done while they are not to be had.

use super::token::{self, Bearer, Expected, TokenError};
use jsonwebtoken::{
    Header,
    jwk::{Jwk, PublicKeyUse},
};
use serde::Deserialize;
use serde_json::Value;
use std::{
    future::Future,
    pin::Pin,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::{Duration, Instant},
};
use tokio::time::timeout;

/// Keys are fetched again after this time, when one is needed.
const FRESH: Duration = Duration::from_mins(10);
/// A token with a key that is not known makes them be fetched again, but not more often than this: such tokens can be made by anybody.
const PAUSE: Duration = Duration::from_secs(10);
/// Longest that a request waits for the provider.
const PATIENCE: Duration = Duration::from_secs(5);
/// Keys that cannot be fetched again serve for so long.
const STALE: Duration = Duration::from_hours(24);
/// Most keys of a provider that are looked at.
const MOST_KEYS: usize = 64;

/// What fetches a JSON document from a URL, or says why not.
pub type Fetch = Arc<dyn Fn(String) -> Pin<Box<dyn Future<Output = Result<Vec<u8>, String>> + Send>> + Send + Sync>;

/// What is known of a provider.
#[derive(Debug, Clone)]
pub struct IssuerSettings {
    /// What its tokens must hold.
    pub expected: Expected,
    /// Where its keys are; `None`: where its configuration says (OpenID Connect Discovery).
    pub keys_url: Option<String>,
}

/// An OpenID provider.
pub struct Issuer {
    settings: IssuerSettings,
    fetch: Fetch,
    published: Mutex<Published>,
    /// Held by who waits for the provider.
    asking: tokio::sync::Mutex<()>,
}

/// What it published when it was asked.
#[derive(Default)]
struct Published {
    keys: Vec<Jwk>,
    /// When the keys came.
    fetched: Option<Instant>,
    /// When they were last asked for.
    asked: Option<Instant>,
}

/// The part of a provider's configuration that is needed.
#[derive(Deserialize)]
struct Configuration {
    issuer: String,
    jwks_uri: String,
}

/// A set of keys, of which some may be of kinds that are not known here.
#[derive(Deserialize)]
struct Keys {
    keys: Vec<Value>,
}

impl Issuer {
    /// A provider, which is asked when the first token comes.
    pub fn new(settings: IssuerSettings, fetch: Fetch) -> Self {
        Self { settings, fetch, published: Mutex::default(), asking: tokio::sync::Mutex::default() }
    }

    /// Whom a token names.
    pub(super) async fn bearer(self: &Arc<Self>, token: &str) -> Result<Bearer, TokenError> {
        let header = token::header(token)?;
        let key = self.key(&header).await?;
        token::read(token, &header, &key, &self.settings.expected)
    }

    /// The key that a token says it is signed with; without a name, the only one there is.
    async fn key(self: &Arc<Self>, header: &Header) -> Result<Jwk, TokenError> {
        if let Some((key, fresh)) = self.known(header) {
            // A provider that does not answer keeps nobody waiting whose key is known.
            if !fresh && self.may_ask() {
                let issuer = Arc::clone(self);
                tokio::spawn(async move { issuer.refresh().await });
            }
            return Ok(key);
        }
        // Whoever comes meanwhile waits for the same answer instead of asking too. What comes later than anybody waits is there for the next.
        let (issuer, wanted) = (Arc::clone(self), header.clone());
        let asked = tokio::spawn(async move {
            let _asking = issuer.asking.lock().await;
            if issuer.known(&wanted).is_none() && issuer.may_ask() {
                issuer.refresh().await;
            }
        });
        let _ = timeout(PATIENCE, asked).await;
        match self.known(header) {
            Some((key, _)) => Ok(key),
            None if self.published().fetched.is_some_and(|at| at.elapsed() < STALE) => Err(TokenError::UnknownKey),
            None => Err(TokenError::Unavailable),
        }
    }

    /// The key, if it is known, and whether it need not be asked for again.
    fn known(&self, header: &Header) -> Option<(Jwk, bool)> {
        let published = self.published();
        let age = published.fetched.map(|at| at.elapsed()).filter(|age| *age < STALE)?;
        find(&published.keys, header).map(|key| (key.clone(), age < FRESH))
    }

    /// Whether the provider was not asked just now; who asks whether it may, asks.
    fn may_ask(&self) -> bool {
        let mut published = self.published();
        let may = published.asked.is_none_or(|at| at.elapsed() >= PAUSE);
        if may {
            published.asked = Some(Instant::now());
        }
        may
    }

    fn published(&self) -> MutexGuard<'_, Published> {
        self.published.lock().unwrap_or_else(PoisonError::into_inner)
    }

    async fn refresh(&self) {
        match self.fetched().await {
            Ok(keys) => {
                let mut published = self.published();
                published.keys = keys;
                published.fetched = Some(Instant::now());
            }
            Err(why) => tracing::warn!(%why, "the keys of the tokens' issuer could not be fetched"),
        }
        // The pause begins when the answer is there or given up: those who waited for it do not ask one after the other.
        self.published().asked = Some(Instant::now());
    }

    /// What the provider publishes now.
    async fn fetched(&self) -> Result<Vec<Jwk>, String> {
        let url = match &self.settings.keys_url {
            Some(url) => url.clone(),
            None => self.discovered().await?,
        };
        let keys: Keys =
            serde_json::from_slice(&(self.fetch)(url).await?).map_err(|error| format!("its keys are not as RFC 7517 has them: {error}"))?;
        let keys: Vec<Jwk> = keys.keys.into_iter().take(MOST_KEYS).filter_map(|key| serde_json::from_value(key).ok()).collect();
        if keys.is_empty() { Err("it publishes no key that is understood here".to_owned()) } else { Ok(keys) }
    }

    async fn discovered(&self) -> Result<String, String> {
        let issuer = &self.settings.expected.issuer;
        let url = format!("{}/.well-known/openid-configuration", issuer.trim_end_matches('/'));
        let configuration: Configuration =
            serde_json::from_slice(&(self.fetch)(url).await?).map_err(|error| format!("its configuration is not understood: {error}"))?;
        if configuration.issuer == *issuer {
            Ok(configuration.jwks_uri)
        } else {
            Err(format!("it calls itself {}, not {issuer}", configuration.issuer))
        }
    }
}

fn find<'a>(keys: &'a [Jwk], header: &Header) -> Option<&'a Jwk> {
    let mut signing = keys.iter().filter(|key| !matches!(key.common.public_key_use, Some(PublicKeyUse::Encryption)));
    match &header.kid {
        Some(name) => signing.find(|key| key.common.key_id.as_ref() == Some(name)),
        None => signing.next().filter(|_| signing.next().is_none()),
    }
}
