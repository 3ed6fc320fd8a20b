//! The running service: store, workers and listener, started together and stopped in order.

use super::{admission, configured, listener, router, traces};
use crate::{
    access::{Audit, AuditError, KeyringError},
    assembly,
    callbacks::{self, AllowError, Deliveries, DestinationError, RootsError, TargetError},
    config::{ConfigError, ServeSettings},
    dimse, intake,
    jobs::{self, Store, StoreError, WorkerSettings, Workers},
    tls::{Acceptor, Purpose, TlsError},
    traces::Traces,
};
use std::{io, net::SocketAddr, path::PathBuf, sync::Arc, time::Duration};
use tokio::{
    net::TcpListener,
    signal::unix::{Signal, SignalKind, signal},
    task::JoinHandle,
};
use tokio_util::sync::CancellationToken;

/// Time that answers under way get once no worker runs any more.
const LAST_ANSWERS: Duration = Duration::from_secs(5);

/// Time that callbacks under way get once no worker runs any more; then another node, or the next start, sends them.
const LAST_CALLBACKS: Duration = Duration::from_secs(3);

/// Time that the last traces get; what is not taken then is dropped.
const LAST_TRACES: Duration = Duration::from_secs(3);

/// Why the service did not start or ended.
#[derive(Debug, thiserror::Error)]
pub enum ServeError {
    /// Settings that cannot be.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// The store did not open.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The file of keys cannot be used.
    #[error(transparent)]
    Keys(#[from] KeyringError),
    /// The audit log cannot be written.
    #[error(transparent)]
    Audit(#[from] AuditError),
    /// `--callback-allow` cannot be read.
    #[error(transparent)]
    CallbackAllow(#[from] AllowError),
    /// `--callback-ca-file` cannot be used.
    #[error(transparent)]
    CallbackRoots(#[from] RootsError),
    /// `--callback-url` may not be called.
    #[error("The URL of --callback-url {0}")]
    CallbackUrl(#[from] TargetError),
    /// Results may not be sent where `--results-to` says.
    #[error("The address of --results-to {0}")]
    ResultsTo(#[from] DestinationError),
    /// Traces may not be sent where `--otlp-endpoint` says.
    #[error("The URL of --otlp-endpoint {0}")]
    OtlpEndpoint(TargetError),
    /// Certificate and key of HTTP, or of DICOM associations, cannot be used.
    #[error(transparent)]
    Tls(#[from] TlsError),
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
    dimse_address: Option<SocketAddr>,
    /// What connections are encrypted with.
    encryption: Encryption,
    draining: CancellationToken,
    closing: CancellationToken,
    listener: JoinHandle<()>,
    _admission: admission::Watch,
    audit: Option<Audit>,
    workers: Arc<Workers>,
    deliveries: Option<Deliveries>,
    dimse: Option<dimse::Listener>,
    _assembly: assembly::Watch,
    store: Store,
    traces: Traces,
    drain_time: Duration,
}

impl Running {
    /// Where it listens.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// Where it listens for DICOM associations, if it does.
    pub fn dimse_address(&self) -> Option<SocketAddr> {
        self.dimse_address
    }

    /// Where it listens, as a URL.
    pub fn url(&self) -> String {
        let scheme = if self.encryption.http.is_some() { "https" } else { "http" };
        format!("{scheme}://{}", self.address)
    }

    /// Reads certificates again, for the connections from now on, and opens the audit log anew. What cannot be used is logged, and the old is used
    /// further.
    pub async fn reload(&self) {
        if let Some(audit) = &self.audit {
            audit.reopen().await;
        }
        for acceptor in self.encryption.http.iter().chain(&self.encryption.dimse) {
            match acceptor.reload() {
                Ok(()) => tracing::info!(listener = %acceptor.purpose(), "the certificate was read again"),
                Err(error) => tracing::error!(%error, "the certificate that was read before is used further"),
            }
        }
    }

    /// Stops it in order: refuses new work and ends waiting answers, lets workers finish or give back what they have, closes the listeners and
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
        let associations = async {
            if let Some(dimse) = &self.dimse {
                dimse.stop(LAST_ANSWERS).await;
            }
        };
        let (ended, ()) = tokio::join!(tokio::time::timeout(LAST_ANSWERS, self.listener), associations);
        match ended {
            Ok(ended) => ended.map_err(io::Error::other)?,
            Err(_) => abort.abort(),
        }
        // Nothing ends a span any more but what was cut off just now.
        tokio::join!(self.store.close(), self.traces.stop(LAST_TRACES));
        Ok(())
    }
}

/// Starts the service on the current runtime.
pub async fn start(settings: &ServeSettings, workers: WorkerSettings) -> Result<Running, ServeError> {
    settings.validate()?;
    // The address first: with a wrong one nothing else should have begun.
    let listener = bind(settings.listen).await?;
    let address = listener.local_addr()?;
    let encryption = Encryption::open(settings)?;
    let dimse_listener = match settings.dimse.listen {
        Some(address) => Some(bind(address).await?),
        None => None,
    };
    let dimse_address = dimse_listener.as_ref().map(TcpListener::local_addr).transpose()?;
    let outward = configured::outward(settings)?;
    let access = admission::access(settings)?;
    let audit = settings.access.audit_log.as_deref().map(Audit::open).transpose()?;
    let store = Store::open(configured::store_settings(settings)).await?;
    let traces = traces::start(settings)?;
    let workers = Arc::new(jobs::start_workers(store.clone(), WorkerSettings { traces: traces.clone(), ..workers })?);
    let mut state = configured::state(settings, &store, &workers).with_access(access).with_traces(traces.clone());
    if let Some(audit) = &audit {
        state = state.with_audit(audit.clone());
    }
    if let Some(rules) = outward.rules {
        state = state.with_callbacks(rules);
    }
    let deliveries = outward.deliveries.map(|settings| callbacks::start(store.clone(), settings));
    let assembly = state.assembler().watch(audit.clone());
    let admission = admission::watch(&state.access);
    let (draining, closing) = (state.draining(), CancellationToken::new());
    let dimse = dimse_listener.map(|listener| {
        let settings = configured::dimse_settings(settings, intake::transfer_syntaxes(&state.limits), encryption.dimse.clone());
        dimse::start(listener, settings, state.assembler(), audit.clone(), draining.clone())
    });
    let accepted = configured::listener_settings(settings, encryption.http.clone());
    let listener = tokio::spawn(listener::serve(listener, router(state), accepted, closing.clone()));
    Ok(Running {
        address,
        dimse_address,
        encryption,
        draining,
        closing,
        listener,
        workers,
        deliveries,
        dimse,
        _assembly: assembly,
        _admission: admission,
        audit,
        store,
        traces,
        drain_time: settings.drain_time(),
    })
}

async fn bind(address: SocketAddr) -> Result<TcpListener, ServeError> {
    TcpListener::bind(address).await.map_err(|source| ServeError::Listen { address, source })
}

/// Runs the service until SIGTERM or SIGINT, then stops it in order. Where it encrypts or has an audit log, SIGHUP has it read its certificates
/// again and open the log anew.
pub async fn serve(settings: ServeSettings) -> Result<(), ServeError> {
    // Before the first job: a signal during the start must not end the process half way.
    let (mut terminate, mut interrupt) = (signal(SignalKind::terminate())?, signal(SignalKind::interrupt())?);
    // With neither, the end of a terminal ends the service, as it does any program.
    let reloads = settings.transport.tls().is_some() || settings.dimse.tls().is_some() || settings.access.audit_log.is_some();
    let mut hangup = reloads.then(|| signal(SignalKind::hangup())).transpose()?;
    let running = start(&settings, configured::worker_settings(&settings)).await?;
    let dimse = running.dimse_address().map(|address| format!("\nlistens on dicom://{}@{address}", settings.dimse.ae_title));
    println!("ventricle {} listens on {}{}", env!("CARGO_PKG_VERSION"), running.url(), dimse.unwrap_or_default());
    loop {
        tokio::select! {
            _ = terminate.recv() => break,
            _ = interrupt.recv() => break,
            () = received(&mut hangup) => running.reload().await,
        }
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

/// Waits for a signal that may never come.
async fn received(signal: &mut Option<Signal>) {
    match signal {
        Some(signal) => drop(signal.recv().await),
        None => std::future::pending().await,
    }
}

/// What connections are encrypted with, where they are.
struct Encryption {
    http: Option<Arc<Acceptor>>,
    dimse: Option<Arc<Acceptor>>,
}

impl Encryption {
    fn open(settings: &ServeSettings) -> Result<Self, TlsError> {
        let open = |purpose, files: Option<(&PathBuf, &PathBuf)>| {
            files.map(|(certificates, key)| Acceptor::open(purpose, certificates, key).map(Arc::new)).transpose()
        };
        Ok(Self { http: open(Purpose::Http, settings.transport.tls())?, dimse: open(Purpose::Dimse, settings.dimse.tls())? })
    }
}
