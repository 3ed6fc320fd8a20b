//! The running service: store, workers and listener, started together and stopped in order.

use super::{
    AppState, admission, archived,
    client::Proxies,
    connections::{self, Connections},
    listener, router, traces,
    uploads::Uploads,
    views,
};
use crate::{
    access::{Audit, AuditError, KeyringError},
    assembly,
    callbacks::{
        self, AllowError, Allowed, Deliveries, DeliverySettings, Destination, DestinationError, Document, Results, RootsError, Rules,
        Sender, Signer, TargetError,
    },
    codecs::Decoder,
    config::{self, ConfigError, ServeSettings},
    dimse, intake,
    jobs::{self, Backend, Store, StoreError, StoreSettings, Threads, WorkerSettings, Workers},
    telemetry,
    tls::{Acceptor, Purpose, TlsError},
    traces::Traces,
};
use std::{io, net::SocketAddr, num::NonZeroUsize, path::PathBuf, sync::Arc, time::Duration};
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
    let outward = outward(settings)?;
    let access = admission::access(settings)?;
    let audit = settings.access.audit_log.as_deref().map(Audit::open).transpose()?;
    let store = Store::open(store_settings(settings)).await?;
    let traces = traces::start(settings)?;
    let workers = Arc::new(jobs::start_workers(store.clone(), WorkerSettings { traces: traces.clone(), ..workers })?);
    let mut state = state(settings, &store, &workers).with_access(access).with_traces(traces.clone());
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
        let settings = dimse_settings(settings, intake::transfer_syntaxes(&state.limits), encryption.dimse.clone());
        dimse::start(listener, settings, state.assembler(), audit.clone(), draining.clone())
    });
    let accepted = listener_settings(settings, encryption.http.clone());
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
    let running = start(&settings, worker_settings(&settings)).await?;
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
        results_to: settings.outward.results_to.clone(),
        ..StoreSettings::default()
    }
}

/// What a service with these settings sends outward.
struct Outward {
    /// Which callbacks clients may ask for; `None` without a secret.
    rules: Option<Rules>,
    /// Who delivers; `None` where there is nothing to deliver.
    deliveries: Option<DeliverySettings>,
}

fn outward(settings: &ServeSettings) -> Result<Outward, ServeError> {
    let secret = settings.outward.callback_secret()?;
    let allowed = Arc::new(Allowed::parse(settings.outward.callback_allow.iter().map(String::as_str))?);
    let destination = settings.outward.results_to.as_deref().map(|text| Destination::parse(text, &allowed)).transpose()?;
    if secret.is_none() && destination.is_none() {
        return Ok(Outward { rules: None, deliveries: None });
    }
    let sender = match (&secret, &destination) {
        (None, Some(Destination::Store { .. })) => Sender::without_tls(Arc::clone(&allowed)),
        _ => Sender::new(Arc::clone(&allowed), &settings.outward.callback_ca_file)?,
    };
    let mut rules = None;
    let mut callbacks: Option<(Signer, callbacks::Body)> = None;
    if let Some(secret) = secret {
        let mut own = Rules { allowed, default_url: None };
        own.default_url = own.url(settings.outward.callback_url.as_ref().map(|url| url.expose().to_owned()))?;
        rules = Some(own);
        callbacks = Some((Signer::new(secret.expose()).map_err(io::Error::other)?, Arc::new(views::callback_body)));
    }
    let document: Document = Arc::new(|store, id| Box::pin(async move { archived::document(&store, id).await }));
    let calling = dimse::Title::parse(&settings.dimse.ae_title).ok_or_else(|| io::Error::other("the AE title is none"))?;
    let authorization = settings.outward.results_authorization()?.map(|secret| secret.expose().to_owned());
    let authorization = settings.outward.results_to.clone().zip(authorization);
    let results = destination.map(|_| Results { document, calling, authorization });
    Ok(Outward { rules, deliveries: Some(DeliverySettings::new(sender, callbacks, results)) })
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

/// File descriptors for what is neither a connection of a client nor counted by a setting: files, sockets that listen, callbacks, associations.
const OTHER_DESCRIPTORS: u64 = 64;
/// Of a decoder of compressed images: its pipes, and the process.
const DECODER_DESCRIPTORS: u64 = 4;

/// HTTP connections at once: as the settings say, as far as the system gives file descriptors.
fn most_connections(settings: &ServeSettings) -> usize {
    let wanted = settings.transport.max_connections as usize;
    let Ok(Some((_, descriptors))) = telemetry::process::descriptors() else { return wanted };
    let decoders = u64::from(settings.transport.max_uploads) * DECODER_DESCRIPTORS;
    let most = connections::within(wanted, descriptors, OTHER_DESCRIPTORS + decoders + u64::from(settings.database_connections));
    if most < wanted {
        tracing::warn!(most, descriptors, "fewer connections than --max-connections, as the system gives no more file descriptors");
    }
    most
}

/// How a service with these settings accepts HTTP connections.
fn listener_settings(settings: &ServeSettings, tls: Option<Arc<Acceptor>>) -> listener::Settings {
    let transport = &settings.transport;
    listener::Settings {
        header_time: listener::HEADER_TIME,
        tls,
        proxies: Proxies::new(&transport.trusted_proxy, transport.trusted_proxy_header),
        connections: Connections::new(most_connections(settings), transport.max_connections_per_client as usize),
    }
}

/// How a service with these settings takes DICOM associations.
fn dimse_settings(settings: &ServeSettings, transfer_syntaxes: Vec<intake::TransferSyntax>, tls: Option<Arc<Acceptor>>) -> dimse::Settings {
    dimse::Settings {
        callers: settings.dimse.calling_ae.clone(),
        owner: settings.dimse.owner.clone(),
        transfer_syntaxes,
        associations: settings.dimse.max_associations.into(),
        object_bytes: settings.max_body_bytes() as usize,
        object_time: Duration::from_secs(settings.upload_seconds),
        tls,
    }
}

/// The workers a service with these settings has.
fn worker_settings(settings: &ServeSettings) -> WorkerSettings {
    let processors = std::thread::available_parallelism().unwrap_or(NonZeroUsize::MIN);
    WorkerSettings {
        workers: settings.workers(processors).get(),
        threads: settings.threads_per_worker.map_or(Threads::ByLoad(processors.get()), |threads| Threads::Fixed(threads.get())),
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
        .with_cors(settings.cors())
        .with_hosts(settings.access.hosts(settings.listen));
    let transport = &settings.transport;
    state.uploads = Uploads::new(transport.max_uploads as usize, transport.max_upload_memory_mb << 20);
    state.hsts_seconds = transport.tls().map(|_| transport.hsts_seconds).filter(|seconds| *seconds > 0);
    match config::own_program() {
        Ok(program) => state = state.with_decoder(Decoder { program }),
        Err(error) => tracing::warn!(%error, "this program does not find itself: compressed images are refused"),
    }
    if settings.database_url.is_some() {
        return state;
    }
    state.with_disk(settings.data_dir.clone(), settings.min_free_disk_mb << 20)
}
