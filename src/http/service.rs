//! The running service: store, workers and listener, started together and stopped in order.

use super::{AppState, listener, router, views};
use crate::{
    assembly,
    callbacks::{self, AllowError, Allowed, Deliveries, DeliverySettings, RootsError, Rules, Sender, Signer, TargetError},
    codecs::Decoder,
    config::{self, ConfigError, ServeSettings},
    jobs::{self, Backend, Store, StoreError, StoreSettings, WorkerSettings, Workers},
};
use std::{io, net::SocketAddr, sync::Arc, time::Duration};
use tokio::{
    net::TcpListener,
    signal::unix::{SignalKind, signal},
    task::JoinHandle,
};
use tokio_util::sync::CancellationToken;

/// Time that answers under way get once no worker runs any more.
const LAST_ANSWERS: Duration = Duration::from_secs(5);

/// Time that callbacks under way get once no worker runs any more; then another node, or the next start, sends them.
const LAST_CALLBACKS: Duration = Duration::from_secs(3);

/// Why the service did not start or ended.
#[derive(Debug, thiserror::Error)]
pub enum ServeError {
    /// Settings that cannot be.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// The store did not open.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// `--callback-allow` cannot be read.
    #[error(transparent)]
    CallbackAllow(#[from] AllowError),
    /// `--callback-ca-file` cannot be used.
    #[error(transparent)]
    CallbackRoots(#[from] RootsError),
    /// `--callback-url` may not be called.
    #[error("The URL of --callback-url {0}")]
    CallbackUrl(#[from] TargetError),
    /// The address is taken or not ours.
    #[error("Cannot listen on {address}: {source}.")]
    Listen {
        /// The address.
        address: SocketAddr,
        /// Why.
        source: io::Error,
    },
    /// Threads or signals could not be had from the system.
    #[error("The system refused what the service needs: {0}.")]
    System(#[from] io::Error),
}

/// A running service.
pub struct Running {
    address: SocketAddr,
    draining: CancellationToken,
    closing: CancellationToken,
    listener: JoinHandle<()>,
    workers: Arc<Workers>,
    deliveries: Option<Deliveries>,
    _assembly: assembly::Watch,
    store: Store,
    drain_time: Duration,
}

impl Running {
    /// Where it listens.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// Stops it in order: refuses new work and ends waiting answers, lets workers finish or give back what they have, closes the listener and
    /// the store.
    pub async fn stop(self) -> Result<(), ServeError> {
        self.draining.cancel();
        let drained = self.workers.drain(self.drain_time).await;
        if drained.given_back > 0 {
            tracing::info!(jobs = drained.given_back, "given back unfinished; they continue at the next start");
        }
        if let Some(deliveries) = &self.deliveries {
            deliveries.stop(LAST_CALLBACKS).await;
        }
        self.closing.cancel();
        let abort = self.listener.abort_handle();
        match tokio::time::timeout(LAST_ANSWERS, self.listener).await {
            Ok(ended) => ended.map_err(io::Error::other)?,
            Err(_) => abort.abort(),
        }
        self.store.close().await;
        Ok(())
    }
}

/// Starts the service on the current runtime.
pub async fn start(settings: &ServeSettings, workers: WorkerSettings) -> Result<Running, ServeError> {
    settings.validate()?;
    // The address first: with a wrong one nothing else should have begun.
    let listener = TcpListener::bind(settings.listen).await.map_err(|source| ServeError::Listen { address: settings.listen, source })?;
    let address = listener.local_addr()?;
    let callbacks = callbacks(settings)?;
    let store = Store::open(store_settings(settings)).await?;
    let workers = Arc::new(jobs::start_workers(store.clone(), workers)?);
    let mut state = state(settings, &store, &workers);
    let mut deliveries = None;
    if let Some((rules, settings)) = callbacks {
        state = state.with_callbacks(rules);
        deliveries = Some(callbacks::start(store.clone(), settings));
    }
    let assembly = state.assembler().watch();
    let (draining, closing) = (state.draining(), CancellationToken::new());
    let listener = tokio::spawn(listener::serve(listener, router(state), listener::HEADER_TIME, closing.clone()));
    Ok(Running { address, draining, closing, listener, workers, deliveries, _assembly: assembly, store, drain_time: settings.drain_time() })
}

/// Runs the service until SIGTERM or SIGINT, then stops it in order.
pub async fn serve(settings: ServeSettings) -> Result<(), ServeError> {
    // Before the first job: a signal during the start must not end the process half way.
    let (mut terminate, mut interrupt) = (signal(SignalKind::terminate())?, signal(SignalKind::interrupt())?);
    let running = start(&settings, worker_settings(&settings)).await?;
    println!("ventricle {} listens on http://{}", env!("CARGO_PKG_VERSION"), running.address());
    tokio::select! {
        _ = terminate.recv() => {}
        _ = interrupt.recv() => {}
    }
    tracing::info!(seconds = settings.drain_seconds, "stopping; running jobs may finish within the drain time");
    let stopping = running.stop();
    tokio::select! {
        stopped = stopping => stopped,
        // Asked again: the store is safe at any moment, so there is nothing to wait for.
        _ = terminate.recv() => Ok(()),
        _ = interrupt.recv() => Ok(()),
    }
}

fn store_settings(settings: &ServeSettings) -> StoreSettings {
    let backend = match &settings.database_url {
        Some(url) => Backend::Postgres { url: url.clone() },
        None => Backend::Sqlite { directory: settings.data_dir.clone() },
    };
    StoreSettings {
        backend,
        max_queued_jobs: settings.max_queued_jobs,
        max_queued_bytes: settings.max_queued_mb << 20,
        keep_input: settings.keep_input,
        lease: settings.lease(),
        connections: settings.database_connections,
        retention: settings.retention(),
        ..StoreSettings::default()
    }
}

/// How a service with these settings tells of jobs' ends; `None` without a secret.
fn callbacks(settings: &ServeSettings) -> Result<Option<(Rules, DeliverySettings)>, ServeError> {
    let Some(secret) = settings.callback_secret()? else { return Ok(None) };
    let allowed = Arc::new(Allowed::parse(settings.callback_allow.iter().map(String::as_str))?);
    let signer = Signer::new(secret.expose()).map_err(io::Error::other)?;
    let sender = Sender::new(Arc::clone(&allowed), &settings.callback_ca_file)?;
    let mut rules = Rules { allowed, default_url: None };
    rules.default_url = rules.url(settings.callback_url.as_ref().map(|url| url.expose().to_owned()))?;
    Ok(Some((rules, DeliverySettings::new(sender, signer, Arc::new(views::callback_body)))))
}

/// The workers a service with these settings has.
fn worker_settings(settings: &ServeSettings) -> WorkerSettings {
    WorkerSettings {
        workers: settings.workers.get(),
        threads_per_worker: settings.threads().get(),
        node: settings.node_name(),
        heartbeat: settings.heartbeat(),
        ..WorkerSettings::default()
    }
}

fn state(settings: &ServeSettings, store: &Store, workers: &Arc<Workers>) -> AppState {
    let workers = Arc::clone(workers);
    let mut state = AppState::new(store.clone())
        .with_body_limit(settings.max_body_bytes() as usize)
        .with_studies(settings.max_study_mb << 20, Duration::from_secs(settings.quiet_seconds))
        .with_upload_time(Duration::from_secs(settings.upload_seconds))
        .with_longest_retention(settings.longest_retention())
        .with_patients_kept(settings.keep_patient)
        .with_workers(move || workers.alive())
        .with_cors(settings.cors());
    match config::own_program() {
        Ok(program) => state = state.with_decoder(Decoder { program }),
        Err(error) => tracing::warn!(%error, "this program does not find itself: compressed images are refused"),
    }
    if settings.database_url.is_some() {
        return state;
    }
    state.with_disk(settings.data_dir.clone(), settings.min_free_disk_mb << 20)
}
