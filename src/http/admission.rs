//! What the running service needs to let callers in: the keys, the provider, and who looks whether they have changed.

use super::service::ServeError;
use crate::{
    access::{Access, Allowances, Fetch, Issuer, Keyring},
    callbacks::{Allowed, Sender},
    config::ServeSettings,
};
use std::{sync::Arc, time::Duration};
use tokio::{
    task::AbortHandle,
    time::{MissedTickBehavior, interval},
};

/// Time after which a key that was added or revoked is one, or none, at the latest.
const LOOK_EVERY: Duration = Duration::from_secs(2);
/// Most bytes of a provider's configuration, or of its keys.
const MOST_BYTES: usize = 1 << 20;

/// Who may come in with these settings.
pub(super) fn access(settings: &ServeSettings) -> Result<Access, ServeError> {
    let keyring = settings.access.keys_file(&settings.data_dir).map(|path| Keyring::open(&path)).transpose()?;
    let issuer = match settings.access.issuer() {
        Some(issuer) => {
            let fetch = fetch(settings, issuer.keys_url.as_deref().into_iter().chain([issuer.expected.issuer.as_str()]))?;
            Some(Arc::new(Issuer::new(issuer, fetch)))
        }
        None => None,
    };
    let access = Access::new(keyring.map(Arc::new), issuer, Allowances::new(settings.access.standing()));
    Ok(access.with_attempts(settings.access.attempts()))
}

/// Fetches from a provider that the operator names: it may be in the hospital's own network.
fn fetch<'a>(settings: &ServeSettings, urls: impl Iterator<Item = &'a str>) -> Result<Fetch, ServeError> {
    let allowed = Allowed::parse(settings.outward.callback_allow.iter().map(String::as_str))?;
    let allowed = Arc::new(allowed.with_hosts_of(urls));
    let sender = if settings.access.fetches_securely() {
        Sender::new(allowed, &settings.outward.callback_ca_file)?
    } else {
        Sender::without_tls(allowed)
    };
    Ok(Arc::new(move |url| {
        let sender = sender.clone();
        Box::pin(async move { sender.fetch(&url, MOST_BYTES).await })
    }))
}

/// Looks after the keys until it is dropped.
pub(super) struct Watch(AbortHandle);

impl Drop for Watch {
    fn drop(&mut self) {
        self.0.abort();
    }
}

/// Reads the keys again when their file is another.
pub(super) fn watch(access: &Arc<Access>) -> Watch {
    let access = Arc::clone(access);
    let mut looks = interval(LOOK_EVERY);
    looks.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let watching = async move {
        let mut told = None;
        loop {
            looks.tick().await;
            let access = Arc::clone(&access);
            // A file may be on a disk that is slow.
            let looked = tokio::task::spawn_blocking(move || access.refresh_keys()).await;
            match looked {
                Ok(Ok(changed)) => {
                    told = None;
                    if changed {
                        tracing::info!("the file of keys has changed and was read again");
                    }
                }
                Ok(Err(error)) => {
                    let text = error.to_string();
                    // Once for each reason.
                    if told.as_ref() != Some(&text) {
                        tracing::error!(%error, "the keys stay as they were");
                        told = Some(text);
                    }
                }
                Err(_) => return,
            }
        }
    };
    Watch(tokio::spawn(watching).abort_handle())
}
