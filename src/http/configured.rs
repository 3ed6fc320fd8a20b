//! What each part of the service is told, by the settings.

use super::{
    AppState, archived,
    client::Proxies,
    connections::{self, Connections},
    listener,
    service::ServeError,
    uploads::Uploads,
    views,
};
use crate::{
    callbacks::{self, Allowed, DeliverySettings, Destination, Document, Results, Rules, Sender, Signer},
    codecs::Decoder,
    config::{self, ServeSettings},
    dimse, intake,
    jobs::{Backend, Store, StoreSettings, Threads, WorkerSettings, Workers},
    telemetry,
    tls::Acceptor,
};
use std::{io, num::NonZeroUsize, sync::Arc, time::Duration};

pub(super) fn store_settings(settings: &ServeSettings) -> StoreSettings {
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
pub(super) struct Outward {
    /// Which callbacks clients may ask for; `None` without a secret.
    pub(super) rules: Option<Rules>,
    /// Who delivers; `None` where there is nothing to deliver.
    pub(super) deliveries: Option<DeliverySettings>,
}

pub(super) fn outward(settings: &ServeSettings) -> Result<Outward, ServeError> {
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
pub(super) fn listener_settings(settings: &ServeSettings, tls: Option<Arc<Acceptor>>) -> listener::Settings {
    let transport = &settings.transport;
    listener::Settings {
        header_time: listener::HEADER_TIME,
        tls,
        proxies: Proxies::new(&transport.trusted_proxy, transport.trusted_proxy_header),
        connections: Connections::new(most_connections(settings), transport.max_connections_per_client as usize),
    }
}

/// How a service with these settings takes DICOM associations.
pub(super) fn dimse_settings(
    settings: &ServeSettings,
    transfer_syntaxes: Vec<intake::TransferSyntax>,
    tls: Option<Arc<Acceptor>>,
) -> dimse::Settings {
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
pub(super) fn worker_settings(settings: &ServeSettings) -> WorkerSettings {
    let processors = std::thread::available_parallelism().unwrap_or(NonZeroUsize::MIN);
    WorkerSettings {
        workers: settings.workers(processors).get(),
        threads: settings.threads_per_worker.map_or(Threads::ByLoad(processors.get()), |threads| Threads::Fixed(threads.get())),
        node: settings.node_name(),
        heartbeat: settings.heartbeat(),
        ..WorkerSettings::default()
    }
}

pub(super) fn state(settings: &ServeSettings, store: &Store, workers: &Arc<Workers>) -> AppState {
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
