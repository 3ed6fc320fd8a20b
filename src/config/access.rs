//! Settings of who may come in, and of how much each may use.

use super::hosts::{Hosts, host};
use crate::access::{Attempts, Expected, IssuerSettings, Standing};
use clap::{Args, builder::BoolishValueParser};
use std::{
    net::{IpAddr, SocketAddr},
    num::NonZeroU32,
    path::{Path, PathBuf},
};
use url::{Host, Url};

/// Name of the file of keys in the data directory, where none is named.
const KEYS_FILE: &str = "keys.json";

/// Who may come in.
#[derive(Debug, Clone, Args)]
pub struct AccessSettings {
    /// File of API keys, as `ventricle keys` writes it; with one every request needs a key, on loopback too [default: `keys.json` in the data
    /// directory, if it is there].
    #[arg(long, env = "VENTRICLE_KEYS_FILE")]
    pub keys_file: Option<PathBuf>,

    /// Confirms that whoever reaches the service may read and delete everything: needed to listen on anything but a loopback address without keys
    /// and without an OpenID provider.
    #[arg(long, env = "VENTRICLE_INSECURE_NO_AUTH", value_parser = BoolishValueParser::new())]
    pub insecure_no_auth: bool,

    /// Names, without port, under which a service that asks nobody who he is is called beside those of its own machine (`localhost`, `127.0.0.1`,
    /// `[::1]`), separated by commas, as of a proxy before it; `*` for any. Not looked at where there are keys or a provider [default: none; any with
    /// `--insecure-no-auth` beyond loopback].
    #[arg(long, env = "VENTRICLE_ALLOWED_HOST", value_delimiter = ',', value_parser = host)]
    pub allowed_host: Vec<String>,

    /// OpenID provider whose tokens are accepted, as their claim `iss` has it: `https://login.example/realms/hospital`.
    #[arg(long, env = "VENTRICLE_OIDC_ISSUER", requires = "oidc_audience")]
    pub oidc_issuer: Option<String>,

    /// What the tokens' claim `aud` must have: this service's name at the provider.
    #[arg(long, env = "VENTRICLE_OIDC_AUDIENCE")]
    pub oidc_audience: Option<String>,

    /// URL of the provider's keys (JWKS) [default: what its `/.well-known/openid-configuration` says].
    #[arg(long, env = "VENTRICLE_OIDC_KEYS_URL")]
    pub oidc_keys_url: Option<String>,

    /// Claim of tokens that names the owner of jobs: who shares it, shares them.
    #[arg(long, env = "VENTRICLE_OIDC_OWNER_CLAIM", default_value = "sub")]
    pub oidc_owner_claim: String,

    /// Claim of tokens with the scopes.
    #[arg(long, env = "VENTRICLE_OIDC_SCOPE_CLAIM", default_value = "scope")]
    pub oidc_scope_claim: String,

    /// What stands there before `submit`, `read` and `admin`.
    #[arg(long, env = "VENTRICLE_OIDC_SCOPE_PREFIX", default_value = "ventricle:")]
    pub oidc_scope_prefix: String,

    /// Seconds by which the clocks of provider and service may differ.
    #[arg(long, env = "VENTRICLE_OIDC_LEEWAY_SECONDS", default_value = "60", value_parser = clap::value_parser!(u64).range(0..=600))]
    pub oidc_leeway_seconds: u64,

    /// Requests a second of each key or token whose key says nothing else, twice as many at once; more are answered 429. 0: no limit.
    #[arg(long, env = "VENTRICLE_REQUESTS_PER_SECOND", default_value = "100")]
    pub requests_per_second: u32,

    /// MiB of bodies a day (UTC) of each key or token whose key says nothing else; more is answered 429. 0: no limit.
    #[arg(long, env = "VENTRICLE_MB_PER_DAY", default_value = "0", value_parser = clap::value_parser!(u64).range(0..=1_073_741_824))]
    pub mb_per_day: u64,

    /// Jobs of one owner that may wait, where the key says nothing else; more are answered 429. 0: as many as of all.
    #[arg(long, env = "VENTRICLE_QUEUED_JOBS_PER_OWNER", default_value = "0")]
    pub queued_jobs_per_owner: u64,

    /// Refused keys and tokens a minute of one address, and as many at once; then it is answered 429. Right ones are let in all the same.
    #[arg(long, env = "VENTRICLE_REFUSALS_PER_MINUTE", default_value = "20", value_parser = clap::value_parser!(u32).range(1..))]
    pub refusals_per_minute: u32,

    /// File to which is added who did what, when, with which job, one JSON object a line. Opened anew on SIGHUP. None by default.
    #[arg(long, env = "VENTRICLE_AUDIT_LOG")]
    pub audit_log: Option<PathBuf>,
}

/// Why the service does not start with these settings.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum AccessError {
    /// The service would be reachable from outside without anything that asks who calls.
    #[error(
        "{listen} is not a loopback address, and nobody would be asked who he is: whoever reaches it could read and delete every result. Make a \
         key with `ventricle keys add`, name an OpenID provider with --oidc-issuer, listen on 127.0.0.1, or, where something before the service \
         authenticates and nothing else reaches it, say so with --insecure-no-auth (VENTRICLE_INSECURE_NO_AUTH=true)."
    )]
    Exposed {
        /// The address asked for.
        listen: SocketAddr,
    },
    /// Not to be asked, and keys.
    #[error("--insecure-no-auth says that nobody is asked, but there are keys ({}) or a provider (--oidc-issuer). Give one or the other.", keys.display())]
    Both {
        /// The file of keys.
        keys: PathBuf,
    },
    /// A provider that anybody could play.
    #[error("`{url}` is no URL with https:// (http:// is accepted for loopback addresses only): --{flag} names whom tokens are believed.")]
    NotSecure {
        /// The flag.
        flag: &'static str,
        /// What was given.
        url: String,
    },
    /// Settings of a provider without the provider.
    #[error("--oidc-audience and --oidc-keys-url belong to --oidc-issuer, which is missing.")]
    WithoutIssuer,
}

impl AccessSettings {
    /// The file of keys that is used, if there is one.
    pub fn keys_file(&self, data_dir: &Path) -> Option<PathBuf> {
        self.keys_file.clone().or_else(|| Some(default_keys_file(data_dir)).filter(|path| path.exists()))
    }

    /// The names under which the service is called, if it asks nobody and listens there.
    pub fn hosts(&self, listen: SocketAddr) -> Hosts {
        // Beyond loopback the names are the network's, which only the operator knows.
        if self.allowed_host.iter().any(|host| host == "*") || (self.allowed_host.is_empty() && !listen.ip().is_loopback()) {
            return Hosts::Any;
        }
        Hosts::Own(self.allowed_host.clone())
    }

    /// Checks what no single setting can say.
    ///
    /// # Errors
    /// [`AccessError`].
    pub fn validate(&self, listen: SocketAddr, data_dir: &Path) -> Result<(), AccessError> {
        let keys = self.keys_file(data_dir);
        let asks = keys.is_some() || self.oidc_issuer.is_some();
        if asks && self.insecure_no_auth {
            return Err(AccessError::Both { keys: keys.unwrap_or_default() });
        }
        if !asks && !self.insecure_no_auth && !listen.ip().is_loopback() {
            return Err(AccessError::Exposed { listen });
        }
        if self.oidc_issuer.is_none() && (self.oidc_audience.is_some() || self.oidc_keys_url.is_some()) {
            return Err(AccessError::WithoutIssuer);
        }
        for (flag, url) in [("oidc-issuer", &self.oidc_issuer), ("oidc-keys-url", &self.oidc_keys_url)] {
            if let Some(url) = url.as_ref().filter(|url| !is_secure(url)) {
                return Err(AccessError::NotSecure { flag, url: url.clone() });
            }
        }
        Ok(())
    }

    /// Whether anything of the provider is fetched over TLS.
    pub fn fetches_securely(&self) -> bool {
        [&self.oidc_issuer, &self.oidc_keys_url].into_iter().flatten().any(|url| url.starts_with("https:"))
    }

    /// The provider, if tokens are accepted.
    pub fn issuer(&self) -> Option<IssuerSettings> {
        let (issuer, audience) = (self.oidc_issuer.clone()?, self.oidc_audience.clone()?);
        let expected = Expected {
            issuer,
            audience,
            owner_claim: self.oidc_owner_claim.clone(),
            scope_claim: self.oidc_scope_claim.clone(),
            scope_prefix: self.oidc_scope_prefix.clone(),
            leeway_s: self.oidc_leeway_seconds,
        };
        Some(IssuerSettings { expected, keys_url: self.oidc_keys_url.clone() })
    }

    /// How often an address may be refused.
    pub fn attempts(&self) -> Attempts {
        NonZeroU32::new(self.refusals_per_minute).map(Attempts::new).unwrap_or_default()
    }

    /// What each caller may use whose key says nothing else.
    pub fn standing(&self) -> Standing {
        let given = |limit: u64| Some(limit).filter(|&limit| limit > 0);
        Standing {
            requests_per_second: NonZeroU32::new(self.requests_per_second),
            bytes_per_day: given(self.mb_per_day << 20),
            queued_jobs: given(self.queued_jobs_per_owner),
        }
    }
}

/// The file of keys where none is named.
pub fn default_keys_file(data_dir: &Path) -> PathBuf {
    data_dir.join(KEYS_FILE)
}

/// Whether what comes from a URL can be believed: nobody between can change it.
fn is_secure(url: &str) -> bool {
    let Ok(url) = Url::parse(url) else { return false };
    let loopback = match url.host() {
        Some(Host::Ipv4(address)) => IpAddr::from(address).is_loopback(),
        Some(Host::Ipv6(address)) => IpAddr::from(address).is_loopback(),
        Some(Host::Domain(name)) => name == "localhost",
        None => return false,
    };
    url.scheme() == "https" || (url.scheme() == "http" && loopback)
}
