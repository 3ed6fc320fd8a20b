//! One connection, and one request over it: resolve, check, connect to what was checked, TLS, POST, status.
//!
//! A client library would follow redirects, read proxies from the environment, resolve names by itself and keep connections; each of these
//! would have to be switched off, and a rule that is not in the path of every connection can be gone around. Here there is one path.

use super::{
    allow::Allowed,
    target::{Target, TargetError},
};
use http_body_util::{BodyExt as _, Full, Limited};
use hyper::{
    Request,
    body::{Bytes, Incoming},
    client::conn::http1,
    header,
};
use hyper_util::rt::TokioIo;
use std::{
    io,
    net::{IpAddr, SocketAddr},
    path::{Path, PathBuf},
    sync::Arc,
    time::Duration,
};
use tokio::{
    io::{AsyncRead, AsyncWrite},
    net::{TcpStream, lookup_host},
    task::JoinSet,
    time::timeout,
};
use tokio_rustls::{
    TlsConnector,
    rustls::{
        ClientConfig, RootCertStore,
        crypto::ring,
        pki_types::{CertificateDer, DnsName, ServerName, pem::PemObject as _},
    },
};
use url::Host;

/// Who asks.
const AGENT: &str = concat!("ventricle/", env!("CARGO_PKG_VERSION"));
/// Time for resolving the name and connecting.
const CONNECT_TIME: Duration = Duration::from_secs(5);
/// Time for everything, to the head of the answer.
pub(super) const WHOLE_TIME: Duration = Duration::from_secs(15);
/// Time for the body of an answer that nobody needs: it is read so that the receiver can send it without an error.
const BODY_TIME: Duration = Duration::from_secs(1);
/// Most bytes read of it.
const MOST_BODY_BYTES: usize = 4 << 10;
/// Most bytes of the head of an answer.
const MOST_HEAD_BYTES: usize = 16 << 10;

/// Why the certificates that receivers' are checked against cannot be used.
#[derive(Debug, thiserror::Error)]
#[error(
    "The certificate authorities that callbacks' receivers are checked against cannot be read from {}: {why}. Name a PEM file with \
     --callback-ca-file; on Debian the package ca-certificates has the public ones.",
    path.display()
)]
pub struct RootsError {
    /// The file.
    pub path: PathBuf,
    /// What is wrong with it.
    pub why: String,
}

/// What connects and sends.
#[derive(Clone)]
pub struct Sender {
    allowed: Arc<Allowed>,
    /// Absent where nothing is sent over TLS.
    tls: Option<TlsConnector>,
}

/// What is posted.
pub(super) struct Message<'a> {
    pub(super) media_type: &'a str,
    pub(super) headers: &'a [(&'a str, String)],
    pub(super) body: Vec<u8>,
    /// Most bytes of the answer's body that are wanted.
    pub(super) answer_bytes: usize,
}

/// What a receiver answered.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Answer {
    pub(super) status: u16,
    pub(super) retry_after: Option<Duration>,
    /// As much of it as was wanted.
    pub(super) body: Bytes,
}

/// Why there is no answer. Nothing here holds the URL's path or query.
#[derive(Debug, thiserror::Error)]
pub(super) enum SendError {
    #[error("the URL {0}")]
    Target(#[from] TargetError),
    #[error("the host leads to {address} only, which is {why}")]
    Refused { address: IpAddr, why: &'static str },
    #[error("the host cannot be resolved: {0}")]
    Resolve(io::Error),
    #[error("no connection: {0}")]
    Connect(io::Error),
    #[error("no TLS: {0}")]
    Tls(io::Error),
    #[error("no answer: {0}")]
    Http(#[from] hyper::Error),
    #[error("the request cannot be written: {0}")]
    Request(#[from] hyper::http::Error),
    #[error("the answer is longer than {0} bytes, or was cut off")]
    Answer(usize),
    #[error("not within {} s", .0.as_secs())]
    Time(Duration),
}

impl SendError {
    /// Whether the rules forbade it, rather than the network.
    pub(super) fn is_refusal(&self) -> bool {
        matches!(self, Self::Target(_) | Self::Refused { .. })
    }
}

impl Sender {
    /// Trusts the certificate authorities of a PEM file.
    pub fn new(allowed: Arc<Allowed>, ca_file: &Path) -> Result<Self, RootsError> {
        let error = |why: String| RootsError { path: ca_file.to_owned(), why };
        let mut roots = RootCertStore::empty();
        for certificate in CertificateDer::pem_file_iter(ca_file).map_err(|why| error(why.to_string()))? {
            // Bundles hold certificates of all ages; one that is not understood is trusted by nobody.
            let (_, _) = roots.add_parsable_certificates([certificate.map_err(|why| error(why.to_string()))?]);
        }
        if roots.is_empty() {
            return Err(error("it holds no certificate".to_owned()));
        }
        let mut config = ClientConfig::builder_with_provider(Arc::new(ring::default_provider()))
            .with_safe_default_protocol_versions()
            .map_err(|why| error(why.to_string()))?
            .with_root_certificates(roots)
            .with_no_client_auth();
        config.alpn_protocols = vec![b"http/1.1".to_vec()];
        Ok(Self { allowed, tls: Some(TlsConnector::from(Arc::new(config))) })
    }

    /// Sends nothing over TLS, and needs no authorities.
    pub fn without_tls(allowed: Arc<Allowed>) -> Self {
        Self { allowed, tls: None }
    }

    /// What the operator allows.
    pub(super) fn allowed(&self) -> &Allowed {
        &self.allowed
    }

    /// Fetches a document of at most so many bytes, or says why not, without the URL.
    pub async fn fetch(&self, url: &str, most_bytes: usize) -> Result<Vec<u8>, String> {
        let fetching = async {
            let target = Target::parse(url, &self.allowed)?;
            let sending = self.send(&target, asking(&target)?, most_bytes);
            timeout(WHOLE_TIME, sending).await.unwrap_or(Err(SendError::Time(WHOLE_TIME)))
        };
        match fetching.await {
            Ok(Answer { status: 200, body, .. }) => Ok(body.into()),
            Ok(Answer { status, .. }) => Err(format!("the answer is {status}")),
            Err(error) => Err(error.to_string()),
        }
    }

    /// Posts to where the operator said, or says why it was not taken, without the URL and the headers.
    pub async fn deliver(&self, url: &str, media_type: &str, headers: &[(String, String)], body: Vec<u8>) -> Result<(), String> {
        let headers: Vec<(&str, String)> = headers.iter().map(|(name, value)| (name.as_str(), value.clone())).collect();
        match self.post(url, Message { media_type, headers: &headers, body, answer_bytes: 0 }).await {
            Ok(Answer { status: 200..=299, .. }) => Ok(()),
            Ok(Answer { status, .. }) => Err(format!("the answer is {status}")),
            Err(error) => Err(error.to_string()),
        }
    }

    /// Posts once.
    pub(super) async fn post(&self, url: &str, message: Message<'_>) -> Result<Answer, SendError> {
        let target = Target::parse(url, &self.allowed)?;
        timeout(WHOLE_TIME, self.exchange(&target, message)).await.unwrap_or(Err(SendError::Time(WHOLE_TIME)))
    }

    async fn exchange(&self, target: &Target, message: Message<'_>) -> Result<Answer, SendError> {
        let answer_bytes = message.answer_bytes;
        self.send(target, request(target, message)?, answer_bytes).await
    }

    async fn send(&self, target: &Target, request: Request<Full<Bytes>>, answer_bytes: usize) -> Result<Answer, SendError> {
        let stream = self.connect(target).await?;
        if !target.secure {
            return exchange(stream, request, answer_bytes).await;
        }
        let tls = self.tls.as_ref().ok_or_else(|| SendError::Tls(io::Error::other("no certificate authorities were read at the start")))?;
        let stream = tls.connect(server_name(&target.host)?, stream).await.map_err(SendError::Tls)?;
        exchange(stream, request, answer_bytes).await
    }

    /// A connection to the target: to an address that was checked.
    pub(super) async fn connect(&self, target: &Target) -> Result<TcpStream, SendError> {
        let connecting = async { connect(&self.permitted(target).await?).await };
        timeout(CONNECT_TIME, connecting).await.unwrap_or(Err(SendError::Time(CONNECT_TIME)))
    }

    /// The addresses of the target that may be connected to, at least one. What is connected to are these very addresses: the name is not
    /// asked again.
    async fn permitted(&self, target: &Target) -> Result<Vec<SocketAddr>, SendError> {
        let addresses: Vec<SocketAddr> = match &target.host {
            Host::Ipv4(address) => vec![((*address), target.port).into()],
            Host::Ipv6(address) => vec![((*address), target.port).into()],
            Host::Domain(name) => lookup_host((name.as_str(), target.port)).await.map_err(SendError::Resolve)?.collect(),
        };
        let refusal = |address: &SocketAddr| if target.named { None } else { self.allowed.refusal(address.ip(), target.port) };
        let refused = addresses.iter().find_map(|address| refusal(address).map(|why| (address.ip(), why)));
        let permitted: Vec<SocketAddr> = addresses.into_iter().filter(|address| refusal(address).is_none()).collect();
        match refused {
            Some((address, why)) if permitted.is_empty() => Err(SendError::Refused { address, why }),
            None if permitted.is_empty() => Err(SendError::Resolve(io::Error::other("it has no address"))),
            _ => Ok(permitted),
        }
    }
}

/// The first of the addresses that answers.
async fn connect(addresses: &[SocketAddr]) -> Result<TcpStream, SendError> {
    let mut last = io::Error::other("no address");
    for address in addresses {
        match TcpStream::connect(address).await {
            Ok(stream) => return Ok(stream),
            Err(error) => last = error,
        }
    }
    Err(SendError::Connect(last))
}

/// Who must answer: the name or the address of the URL.
fn server_name(host: &Host<String>) -> Result<ServerName<'static>, SendError> {
    Ok(match host {
        Host::Ipv4(address) => ServerName::IpAddress(IpAddr::from(*address).into()),
        Host::Ipv6(address) => ServerName::IpAddress(IpAddr::from(*address).into()),
        Host::Domain(name) => {
            let name = DnsName::try_from(name.strip_suffix('.').unwrap_or(name).to_owned());
            ServerName::DnsName(name.map_err(|error| SendError::Tls(io::Error::other(error)))?)
        }
    })
}

/// A request for a document.
fn asking(target: &Target) -> Result<Request<Full<Bytes>>, SendError> {
    let request = Request::get(&target.path)
        .header(header::HOST, &target.authority)
        .header(header::USER_AGENT, AGENT)
        .header(header::ACCEPT, "application/json")
        .header(header::CONNECTION, "close");
    Ok(request.body(Full::default())?)
}

fn request(target: &Target, message: Message<'_>) -> Result<Request<Full<Bytes>>, SendError> {
    let request = Request::post(&target.path)
        .header(header::HOST, &target.authority)
        .header(header::USER_AGENT, AGENT)
        .header(header::CONTENT_TYPE, message.media_type)
        .header(header::CONNECTION, "close");
    let request = message.headers.iter().fold(request, |request, (name, value)| request.header(*name, value));
    Ok(request.body(Full::new(message.body.into()))?)
}

/// Sends the request over the stream and reads the head of the answer, and its body if it is wanted.
async fn exchange<S>(stream: S, request: Request<Full<Bytes>>, answer_bytes: usize) -> Result<Answer, SendError>
where
    S: AsyncRead + AsyncWrite + Unpin + Send + 'static,
{
    let (mut sender, connection) =
        http1::Builder::new().title_case_headers(true).max_buf_size(MOST_HEAD_BYTES).handshake(TokioIo::new(stream)).await?;
    // Ends with this function, however it ends.
    let mut driving = JoinSet::new();
    driving.spawn(connection);
    let response = sender.send_request(request).await?;
    let status = response.status().as_u16();
    let retry_after = response.headers().get(header::RETRY_AFTER).and_then(|value| value.to_str().ok()).and_then(retry_after);
    let body = if answer_bytes > 0 {
        let collected = Limited::new(response.into_body(), answer_bytes).collect().await;
        collected.map_err(|_| SendError::Answer(answer_bytes))?.to_bytes()
    } else {
        // In time or not: the answer is known.
        let _ = timeout(BODY_TIME, discard(response.into_body())).await;
        Bytes::new()
    };
    Ok(Answer { status, retry_after, body })
}

/// Reads the beginning of a body and forgets it.
async fn discard(mut body: Incoming) {
    let mut left = MOST_BODY_BYTES;
    while let Some(Ok(frame)) = body.frame().await {
        left = left.saturating_sub(frame.data_ref().map_or(0, Bytes::len));
        if left == 0 {
            return;
        }
    }
}

/// `Retry-After`: seconds, or a date.
fn retry_after(value: &str) -> Option<Duration> {
    if let Ok(seconds) = value.trim().parse() {
        return Some(Duration::from_secs(seconds));
    }
    let at = jiff::fmt::rfc2822::parse(value.trim()).ok()?.timestamp();
    Duration::try_from(at.duration_since(jiff::Timestamp::now())).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_forms_of_retry_after_are_read() {
        assert_eq!(retry_after("120"), Some(Duration::from_mins(2)));
        assert_eq!(retry_after("soon"), None);
        assert_eq!(retry_after("-1"), None);
        assert_eq!(retry_after("Sun, 06 Nov 1994 08:49:37 GMT"), None, "long ago");
        let later = retry_after("Thu, 01 Jan 2099 00:00:00 GMT").unwrap();
        assert!(later > Duration::from_hours(24 * 365), "{later:?}");
    }

    #[test]
    fn a_file_without_certificates_is_refused_by_name() {
        let path = std::env::temp_dir().join(format!("ventricle-no-roots-{}.pem", uuid::Uuid::now_v7()));
        let refused = |path: &Path| Sender::new(Arc::default(), path).err().unwrap().to_string();
        assert!(refused(&path).contains(path.to_str().unwrap()));
        std::fs::write(&path, "nothing").unwrap();
        assert!(refused(&path).contains("it holds no certificate"));
        std::fs::remove_file(&path).unwrap();
    }
}
