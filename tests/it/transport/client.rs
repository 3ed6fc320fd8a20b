//! Clients that say which version of TLS and which HTTP they speak.

use axum::{
    body::{Body, Bytes},
    http::{HeaderMap, Request, Response},
};
use http_body_util::BodyExt;
use hyper::{
    body::Incoming,
    client::conn::{http1, http2},
};
use hyper_util::rt::{TokioExecutor, TokioIo};
use std::{net::SocketAddr, sync::Arc, time::Duration};
use tokio::{
    io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt},
    net::TcpStream,
    time::timeout,
};
use tokio_rustls::{
    TlsConnector,
    client::TlsStream,
    rustls::{
        ClientConfig, RootCertStore, SupportedProtocolVersion,
        crypto::ring,
        pki_types::{CertificateDer, ServerName},
        version,
    },
};

pub(super) const BOTH: [&SupportedProtocolVersion; 2] = [&version::TLS13, &version::TLS12];

/// Time for anything that is waited for.
pub(super) const PATIENCE: Duration = Duration::from_secs(30);

/// An encrypted connection to a service with this certificate, under one of these versions, with one of these protocols.
pub(super) async fn encrypted(
    address: SocketAddr,
    trusted: &CertificateDer<'static>,
    versions: &[&'static SupportedProtocolVersion],
    protocols: &[&str],
) -> std::io::Result<TlsStream<TcpStream>> {
    let mut roots = RootCertStore::empty();
    roots.add(trusted.clone()).unwrap();
    let builder = ClientConfig::builder_with_provider(Arc::new(ring::default_provider())).with_protocol_versions(versions).unwrap();
    let mut config = builder.with_root_certificates(roots).with_no_client_auth();
    config.alpn_protocols = protocols.iter().map(|protocol| protocol.as_bytes().to_vec()).collect();
    let stream = TcpStream::connect(address).await.unwrap();
    let connector = TlsConnector::from(Arc::new(config));
    timeout(PATIENCE, connector.connect(ServerName::try_from("localhost").unwrap(), stream)).await.expect("the handshake ends")
}

/// Whether the service at an address shows this certificate now.
pub(super) async fn shows(address: SocketAddr, certificate: &CertificateDer<'static>) -> bool {
    match encrypted(address, certificate, &BOTH, &[]).await {
        Ok(stream) => stream.get_ref().1.peer_certificates().is_some_and(|chain| chain[0] == *certificate),
        Err(_) => false,
    }
}

/// A connection of HTTP/2 that requests can be sent over.
#[derive(Clone)]
pub(super) struct Http2(http2::SendRequest<Body>);

impl Http2 {
    pub(super) async fn over(stream: impl AsyncRead + AsyncWrite + Unpin + Send + 'static) -> Self {
        let (sender, connection) = http2::handshake(TokioExecutor::new(), TokioIo::new(stream)).await.unwrap();
        tokio::spawn(connection);
        Self(sender)
    }

    pub(super) async fn send(&self, request: Request<Body>) -> Response<Incoming> {
        timeout(PATIENCE, self.0.clone().send_request(request)).await.expect("an answer comes").unwrap()
    }

    /// Sends a request and waits for the whole of its answer.
    pub(super) async fn ask(&self, request: Request<Body>) -> (u16, HeaderMap, Bytes) {
        whole(self.send(request).await).await
    }
}

/// Sends one request over a connection of HTTP/1.1.
pub(super) async fn ask(stream: impl AsyncRead + AsyncWrite + Unpin + Send + 'static, request: Request<Body>) -> (u16, HeaderMap, Bytes) {
    let (mut sender, connection) = http1::handshake(TokioIo::new(stream)).await.unwrap();
    tokio::spawn(connection);
    whole(timeout(PATIENCE, sender.send_request(request)).await.expect("an answer comes").unwrap()).await
}

async fn whole(response: Response<Incoming>) -> (u16, HeaderMap, Bytes) {
    let (head, body) = response.into_parts();
    let body = timeout(PATIENCE, body.collect()).await.expect("the answer ends").unwrap().to_bytes();
    (head.status.as_u16(), head.headers, body)
}

/// A request as both HTTPs take it.
pub(super) fn get(address: SocketAddr, scheme: &str, path: &str) -> Request<Body> {
    Request::get(format!("{scheme}://{address}{path}")).header("host", address.to_string()).body(Body::empty()).unwrap()
}

/// Writes bytes and reads until the connection ends.
pub(super) async fn raw(address: SocketAddr, bytes: &[u8]) -> Vec<u8> {
    let mut stream = TcpStream::connect(address).await.unwrap();
    // The other side may have heard enough.
    let _ = stream.write_all(bytes).await;
    let mut read = Vec::new();
    let _ = timeout(PATIENCE, stream.read_to_end(&mut read)).await.expect("the connection ends");
    read
}
