//! A client that keeps its connection: requests one after the other, and events as they come.

use http_body_util::{BodyExt, Full};
use hyper::{
    Request, StatusCode,
    body::{Bytes, Incoming},
    client::conn::http1::{self, SendRequest},
};
use hyper_util::rt::TokioIo;
use serde_json::Value;
use std::net::SocketAddr;
use tokio::net::TcpStream;

/// One connection.
pub(crate) struct Client {
    sender: SendRequest<Full<Bytes>>,
}

impl Client {
    pub(crate) async fn connect(address: SocketAddr) -> Self {
        let stream = TcpStream::connect(address).await.unwrap();
        stream.set_nodelay(true).unwrap();
        let (sender, connection) = http1::handshake(TokioIo::new(stream)).await.unwrap();
        tokio::spawn(connection);
        Self { sender }
    }

    async fn send(&mut self, method: &str, path: &str, headers: &[(&str, &str)], body: Bytes) -> (StatusCode, Incoming) {
        self.sender.ready().await.unwrap();
        let mut request = Request::builder().method(method).uri(path).header("host", "bench");
        for (name, value) in headers {
            request = request.header(*name, *value);
        }
        let answer = self.sender.send_request(request.body(Full::new(body)).unwrap()).await.unwrap();
        (answer.status(), answer.into_body())
    }

    /// The body of a successful answer.
    pub(crate) async fn get(&mut self, path: &str) -> Bytes {
        let (status, body) = self.send("GET", path, &[], Bytes::new()).await;
        let body = body.collect().await.unwrap().to_bytes();
        assert_eq!(status, StatusCode::OK, "GET {path}: {}", String::from_utf8_lossy(&body));
        body
    }

    pub(crate) async fn json(&mut self, path: &str) -> Value {
        serde_json::from_slice(&self.get(path).await).unwrap()
    }

    /// Submits a DICOM file; the id of its job.
    pub(crate) async fn submit(&mut self, preset: &str, dicom: &Bytes) -> String {
        let path = format!("/v1/reconstructions?preset={preset}");
        let (status, body) = self.send("POST", &path, &[("content-type", "application/dicom")], dicom.clone()).await;
        let body = body.collect().await.unwrap().to_bytes();
        assert_eq!(status, StatusCode::ACCEPTED, "{}", String::from_utf8_lossy(&body));
        let job: Value = serde_json::from_slice(&body).unwrap();
        job["id"].as_str().unwrap().to_owned()
    }

    /// Waits until a job has succeeded.
    pub(crate) async fn succeeded(&mut self, id: &str) {
        let path = format!("/v1/reconstructions/{id}");
        loop {
            let (_, body) = self.send("GET", &path, &[("prefer", "wait=30")], Bytes::new()).await;
            let job: Value = serde_json::from_slice(&body.collect().await.unwrap().to_bytes()).unwrap();
            match job["state"].as_str().unwrap() {
                "succeeded" => return,
                "queued" | "running" => {}
                state => panic!("job {id} is {state}: {job}"),
            }
        }
    }

    /// Listens to events; the connection is theirs.
    pub(crate) async fn listen(mut self, path: &str) -> Events {
        let (status, body) = self.send("GET", path, &[("accept", "text/event-stream")], Bytes::new()).await;
        assert_eq!(status, StatusCode::OK, "{path}");
        Events { body, _client: self }
    }
}

/// A stream of events.
pub(crate) struct Events {
    body: Incoming,
    _client: Client,
}

impl Events {
    /// What came next; `None` at the end of the stream.
    pub(crate) async fn next(&mut self) -> Option<Bytes> {
        loop {
            let frame = self.body.frame().await?.unwrap();
            if let Ok(data) = frame.into_data() {
                return Some(data);
            }
        }
    }
}
