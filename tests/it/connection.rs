//! A client that keeps its connection.

use axum::body::Bytes;
use http_body_util::{BodyExt, Full};
use hyper::{
    Request,
    body::Incoming,
    client::conn::http1::{self, SendRequest},
};
use hyper_util::rt::TokioIo;
use serde_json::Value;
use std::net::SocketAddr;
use tokio::net::TcpStream;

/// One connection.
pub(crate) struct Connection {
    sender: SendRequest<Full<Bytes>>,
    key: Option<String>,
}

/// An answer.
pub(crate) struct Answer {
    pub(crate) status: u16,
    pub(crate) retry_after_s: Option<u64>,
    pub(crate) body: Bytes,
}

impl Answer {
    pub(crate) fn json(&self) -> Value {
        serde_json::from_slice(&self.body).unwrap_or_default()
    }

    /// The code of a problem, or nothing.
    pub(crate) fn code(&self) -> String {
        self.json()["code"].as_str().unwrap_or_default().to_owned()
    }
}

impl Connection {
    /// With a key, if the service asks for one.
    pub(crate) async fn open(address: SocketAddr, key: Option<&str>) -> Self {
        let stream = TcpStream::connect(address).await.unwrap();
        stream.set_nodelay(true).unwrap();
        let (sender, connection) = http1::handshake(TokioIo::new(stream)).await.unwrap();
        tokio::spawn(connection);
        Self { sender, key: key.map(|key| format!("Bearer {key}")) }
    }

    async fn send(&mut self, method: &str, path: &str, headers: &[(&str, &str)], body: Bytes) -> hyper::Result<hyper::Response<Incoming>> {
        self.sender.ready().await?;
        let mut request = Request::builder().method(method).uri(path).header("host", "localhost");
        if let Some(key) = &self.key {
            request = request.header("authorization", key);
        }
        for (name, value) in headers {
            request = request.header(*name, *value);
        }
        self.sender.send_request(request.body(Full::new(body)).unwrap()).await
    }

    /// Sends a request and reads the whole answer. An error where the service closed the connection.
    pub(crate) async fn ask(&mut self, method: &str, path: &str, headers: &[(&str, &str)], body: Bytes) -> hyper::Result<Answer> {
        let (head, body) = self.send(method, path, headers, body).await?.into_parts();
        let retry_after_s = head.headers.get("retry-after").and_then(|value| value.to_str().ok()?.parse().ok());
        Ok(Answer { status: head.status.as_u16(), retry_after_s, body: body.collect().await?.to_bytes() })
    }

    pub(crate) async fn get(&mut self, path: &str) -> hyper::Result<Answer> {
        self.ask("GET", path, &[], Bytes::new()).await
    }

    /// A stream of events; the connection is theirs.
    pub(crate) async fn listen(mut self, path: &str) -> hyper::Result<(u16, Events)> {
        let answer = self.send("GET", path, &[("accept", "text/event-stream")], Bytes::new()).await?;
        Ok((answer.status().as_u16(), Events { body: answer.into_body(), _connection: self }))
    }
}

/// A stream of events.
pub(crate) struct Events {
    body: Incoming,
    _connection: Connection,
}

impl Events {
    /// What came next; `None` at the end of the stream, an error where it was cut off.
    pub(crate) async fn next(&mut self) -> Option<hyper::Result<Bytes>> {
        loop {
            match self.body.frame().await? {
                Ok(frame) => {
                    if let Ok(data) = frame.into_data() {
                        return Some(Ok(data));
                    }
                }
                Err(error) => return Some(Err(error)),
            }
        }
    }
}
