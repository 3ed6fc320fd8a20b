//! The accept loop: HTTP/1.1 and HTTP/2 over connections that are encrypted or not, each with an end to every wait. `axum::serve` has no time
//! limit on request headers, so a client that never ends them would hold its connection for ever.

use super::{
    activity::Activity,
    client::Proxies,
    connections::{Connections, Place},
};
use crate::tls::{self, Acceptor};
use axum::Router;
use hyper::{
    Request,
    body::Incoming,
    service::{Service as _, service_fn},
};
use hyper_util::{
    rt::{TokioExecutor, TokioIo, TokioTimer},
    server::conn::auto::Builder,
    service::TowerToHyperService,
};
use std::{
    convert::Infallible,
    io,
    net::{IpAddr, SocketAddr},
    pin::pin,
    sync::Arc,
    time::Duration,
};
use tokio::{
    io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt},
    net::{TcpListener, TcpStream},
    task::JoinSet,
    time::{sleep, timeout},
};
use tokio_util::sync::CancellationToken;

/// Time for the headers of a request to arrive, counted from the connection or the answer before: longer than proxies keep idle connections
/// (60 s), so that it is they who close them. Likewise how long a connection of HTTP/2 is kept without a request.
pub(super) const HEADER_TIME: Duration = Duration::from_secs(75);
/// How long a client may read nothing of the answers it is sent.
const UNREAD_TIME: Duration = Duration::from_mins(2);
/// Time for a connection that was told to end.
const GOODBYE_TIME: Duration = Duration::from_secs(5);
/// Time for the handshake of TLS.
const HANDSHAKE_TIME: Duration = Duration::from_secs(10);
/// Pause when the system has no more connections to give.
const SYSTEM_PAUSE: Duration = Duration::from_secs(1);

/// Most bytes of a request's head that are taken in, twice what is accepted: what is more is answered by `hyper`, without a document.
const MOST_HEAD_BYTES: usize = 2 * super::layers::MOST_HEADER_BYTES;
/// Requests at once over one connection of HTTP/2.
const STREAMS: u32 = 100;
/// Requests of HTTP/2 that were taken back before they were looked at (CVE-2023-44487), and errors of the client's making (CVE-2025-8671),
/// after which the connection is closed.
const RESETS: usize = 20;
const ERRORS: usize = 1024;
/// What a client may send over a stream, and over a connection of HTTP/2, before any of it is read. Beside the memory of uploads, this is
/// all that a body can take.
const STREAM_WINDOW_BYTES: u32 = 256 << 10;
const CONNECTION_WINDOW_BYTES: u32 = 512 << 10;
/// What is kept of the answer of a stream of HTTP/2 until it is written.
const SEND_BUFFER_BYTES: usize = 128 << 10;
/// How often a connection of HTTP/2 is asked whether the other side is there, and how long it may take to say so.
const PING: Duration = Duration::from_secs(20);

/// How connections are accepted.
#[derive(Debug, Clone)]
pub(super) struct Settings {
    /// Time for the headers of a request, and without a request.
    pub(super) header_time: Duration,
    /// Certificate and key, if it is encrypted.
    pub(super) tls: Option<Arc<Acceptor>>,
    /// Who is believed when it says whom it speaks for.
    pub(super) proxies: Proxies,
    /// How many there may be.
    pub(super) connections: Connections,
}

/// Answers connections until told to close; then ends idle ones at once and waits for the answers under way.
pub(super) async fn serve(listener: TcpListener, router: Router, settings: Settings, closing: CancellationToken) {
    let served = Served { builder: builder(settings.header_time), router, settings, closing };
    let mut open = JoinSet::new();
    loop {
        let (stream, address) = tokio::select! {
            accepted = accept(&listener) => accepted,
            Some(ended) = open.join_next() => {
                if let Err(error) = ended {
                    tracing::error!(%error, "a connection ended in a panic");
                }
                continue;
            }
            () = served.closing.cancelled() => break,
        };
        let peer = address.ip().to_canonical();
        let exempt = peer.is_loopback() || served.settings.proxies.trust(peer);
        // Closed without a word where there is no place: who opens so many does not read.
        if let Ok(place) = served.settings.connections.place((!exempt).then_some(peer)) {
            let served = served.clone();
            open.spawn(async move { served.connection(stream, peer, place).await });
        }
    }
    drop(listener);
    while open.join_next().await.is_some() {}
}

fn builder(header_time: Duration) -> Builder<TokioExecutor> {
    let mut builder = Builder::new(TokioExecutor::new());
    builder.http1().timer(TokioTimer::new()).header_read_timeout(header_time).max_buf_size(MOST_HEAD_BYTES);
    builder
        .http2()
        .timer(TokioTimer::new())
        .max_concurrent_streams(STREAMS)
        .max_pending_accept_reset_streams(RESETS)
        .max_local_error_reset_streams(ERRORS)
        .max_header_list_size(MOST_HEAD_BYTES as u32)
        .initial_stream_window_size(STREAM_WINDOW_BYTES)
        .initial_connection_window_size(CONNECTION_WINDOW_BYTES)
        .max_send_buf_size(SEND_BUFFER_BYTES)
        .keep_alive_interval(PING)
        .keep_alive_timeout(PING);
    builder
}

/// What all connections share.
#[derive(Clone)]
struct Served {
    builder: Builder<TokioExecutor>,
    router: Router,
    settings: Settings,
    closing: CancellationToken,
}

impl Served {
    async fn connection(self, stream: TcpStream, peer: IpAddr, _place: Place) {
        // Answers are written whole or as events, which are not to wait for more.
        let _ = stream.set_nodelay(true);
        let Some(tls) = self.settings.tls.clone() else { return self.answer(stream, peer).await };
        let stream = tokio::select! {
            stream = timeout(HANDSHAKE_TIME, encrypted(stream, &tls)) => stream,
            () = self.closing.cancelled() => return,
        };
        match stream {
            Ok(Ok(stream)) => self.answer(stream, peer).await,
            Ok(Err(error)) => tracing::debug!(%error, "a connection was not encrypted"),
            Err(_) => tracing::debug!("a connection took too long to be encrypted"),
        }
    }

    /// Answers the requests of a connection until it ends, is told to end, or has ended for us.
    async fn answer(self, stream: impl AsyncRead + AsyncWrite + Unpin + Send + 'static, peer: IpAddr) {
        let Self { builder, router, settings, closing } = self;
        let (activity, router) = (Activity::default(), TowerToHyperService::new(router));
        let begun = activity.clone();
        let proxies = settings.proxies;
        let service = service_fn(move |mut request: Request<Incoming>| {
            let client = proxies.client(peer, request.headers());
            request.extensions_mut().insert(client);
            let (under_way, answer) = (begun.begin(), router.call(request));
            async move {
                let response = answer.await?;
                Ok::<_, Infallible>(under_way.answer(response))
            }
        });
        let mut connection = pin!(builder.serve_connection(TokioIo::new(stream), service));
        tokio::select! {
            ended = connection.as_mut() => return tell(ended),
            () = closing.cancelled() => {}
            () = activity.ended(settings.header_time, UNREAD_TIME) => {}
        }
        connection.as_mut().graceful_shutdown();
        // A request that came meanwhile is answered.
        tokio::select! {
            ended = connection => tell(ended),
            () = activity.ended(GOODBYE_TIME, GOODBYE_TIME) => tracing::debug!("a connection was ended"),
        }
    }
}

fn tell(ended: Result<(), Box<dyn std::error::Error + Send + Sync>>) {
    if let Err(error) = ended {
        tracing::debug!(error, "a connection broke");
    }
}

/// Shakes hands. Who speaks HTTP without TLS is told so.
async fn encrypted(mut stream: TcpStream, tls: &Acceptor) -> io::Result<impl AsyncRead + AsyncWrite + Unpin + Send + use<>> {
    let mut first = [0];
    let read = stream.peek(&mut first).await?;
    if read == 1 && first[0] != tls::HANDSHAKE_RECORD {
        if first[0].is_ascii_uppercase() {
            refuse_plain(&mut stream).await?;
        }
        return Err(io::Error::new(io::ErrorKind::InvalidData, "it begins with no handshake"));
    }
    tls.accept(stream).await
}

/// Answers a request that came without TLS, whatever it is.
async fn refuse_plain(stream: &mut TcpStream) -> io::Result<()> {
    let text = "This port speaks HTTPS only: use https:// in the address.\n";
    let head = "HTTP/1.1 400 Bad Request\r\nContent-Type: text/plain; charset=utf-8\r\nConnection: close\r\nContent-Length: ";
    stream.write_all(format!("{head}{}\r\n\r\n{text}", text.len()).as_bytes()).await?;
    stream.shutdown().await?;
    // A connection that is closed over bytes nobody read is reset, and the answer lost with it.
    let _ = timeout(Duration::from_secs(1), stream.take(MOST_HEAD_BYTES as u64).read_to_end(&mut Vec::new())).await;
    Ok(())
}

/// The next connection. Errors of single connections are theirs alone; others (no more file descriptors) are waited out.
async fn accept(listener: &TcpListener) -> (TcpStream, SocketAddr) {
    loop {
        match listener.accept().await {
            Ok(accepted) => return accepted,
            Err(error) if is_of_connection(&error) => {}
            Err(error) => {
                tracing::error!(%error, "no connection could be accepted");
                sleep(SYSTEM_PAUSE).await;
            }
        }
    }
}

fn is_of_connection(error: &io::Error) -> bool {
    matches!(error.kind(), io::ErrorKind::ConnectionRefused | io::ErrorKind::ConnectionAborted | io::ErrorKind::ConnectionReset)
}

#[cfg(test)]
mod tests {
    use super::{super::client::ClientAddress, *};
    use crate::config::ProxyHeader;
    use axum::{Extension, routing::get};
    use tokio::task::JoinHandle;

    /// A listener whose connections may be idle for so long and be so many; where it is, and what ends it.
    async fn start(header_time: Duration, most: usize) -> (SocketAddr, CancellationToken, JoinHandle<()>) {
        start_behind(Proxies::default(), header_time, most).await
    }

    /// The same where these proxies are believed.
    async fn start_behind(proxies: Proxies, header_time: Duration, most: usize) -> (SocketAddr, CancellationToken, JoinHandle<()>) {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let (address, closing) = (listener.local_addr().unwrap(), CancellationToken::new());
        let client = |Extension(client): Extension<ClientAddress>| async move { client.0.to_string() };
        let router = Router::new().route("/", get(|| async { "here" })).route("/client", get(client));
        let settings = Settings { header_time, tls: None, proxies, connections: Connections::new(most, 1) };
        (address, closing.clone(), tokio::spawn(serve(listener, router, settings, closing)))
    }

    /// All that comes over a connection until it ends.
    async fn rest(stream: &mut TcpStream) -> String {
        let mut rest = Vec::new();
        // A reset is an end too.
        let _ = timeout(Duration::from_secs(20), stream.read_to_end(&mut rest)).await.expect("the connection ends");
        String::from_utf8_lossy(&rest).into_owned()
    }

    const CLOSED_AFTER: &[u8] = b"GET / HTTP/1.1\r\nHost: test\r\nConnection: close\r\n\r\n";

    #[tokio::test]
    async fn headers_that_never_end_are_given_up_and_others_answered() {
        let (address, closing, server) = start(Duration::from_millis(300), 100).await;
        let mut slow = Vec::new();
        // Nothing, half a head, half the preface of HTTP/2, and the whole of it without a request.
        for sent in ["", "GET / HTTP/1.1\r\nHost: test\r\n", "PRI * HT", "PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n\0\0\0\u{4}\0\0\0\0\0"] {
            let mut stream = TcpStream::connect(address).await.unwrap();
            stream.write_all(sent.as_bytes()).await.unwrap();
            slow.push(stream);
        }
        let mut quick = TcpStream::connect(address).await.unwrap();
        quick.write_all(CLOSED_AFTER).await.unwrap();
        let answer = rest(&mut quick).await;
        assert!(answer.starts_with("HTTP/1.1 200") && answer.ends_with("here"), "{answer}");
        for stream in &mut slow {
            let rest = rest(stream).await;
            assert!(!rest.starts_with("HTTP/1.1 200"), "{rest}");
        }

        closing.cancel();
        timeout(Duration::from_secs(10), server).await.expect("the listener ends").unwrap();
        assert!(TcpStream::connect(address).await.is_err());
    }

    #[tokio::test]
    async fn connections_beyond_the_limit_are_closed_and_those_that_end_make_room() {
        let (address, closing, server) = start(HEADER_TIME, 2).await;
        let mut open = Vec::new();
        for _ in 0..2 {
            let mut stream = TcpStream::connect(address).await.unwrap();
            stream.write_all(b"GET / HTTP/1.1\r\nHost: test\r\n\r\n").await.unwrap();
            assert_eq!(stream.read(&mut [0; 8]).await.unwrap(), 8, "loopback is not counted by client");
            open.push(stream);
        }
        let mut third = TcpStream::connect(address).await.unwrap();
        let _ = third.write_all(CLOSED_AFTER).await;
        assert_eq!(rest(&mut third).await, "");
        open.pop();
        for attempt in 0.. {
            let mut stream = TcpStream::connect(address).await.unwrap();
            let _ = stream.write_all(CLOSED_AFTER).await;
            if rest(&mut stream).await.starts_with("HTTP/1.1 200") {
                break;
            }
            assert!(attempt < 500, "no room was made");
            sleep(Duration::from_millis(10)).await;
        }
        // An idle connection does not hold up the end.
        closing.cancel();
        timeout(Duration::from_secs(10), server).await.expect("the listener ends").unwrap();
    }
    #[tokio::test]
    async fn requests_carry_whom_they_are_from() {
        let believed = Proxies::new(&["127.0.0.0/8".parse().unwrap()], ProxyHeader::XForwardedFor);
        for (proxies, client) in [(Proxies::default(), "127.0.0.1"), (believed, "192.0.2.7")] {
            let (address, _closing, server) = start_behind(proxies, HEADER_TIME, 9).await;
            let mut stream = TcpStream::connect(address).await.unwrap();
            let head = "GET /client HTTP/1.1\r\nHost: test\r\nX-Forwarded-For: 198.51.100.1, 192.0.2.7\r\nConnection: close\r\n\r\n";
            stream.write_all(head.as_bytes()).await.unwrap();
            let answer = rest(&mut stream).await;
            assert!(answer.ends_with(&format!("\r\n\r\n{client}")), "{answer}");
            server.abort();
        }
    }
}
