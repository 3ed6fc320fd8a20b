//! Clients that send too much, too slowly, or take back what they sent.

use super::{
    child::Service,
    client::{self, Http2, PATIENCE, get, raw},
};
use axum::{
    body::{Body, Bytes},
    http::Request,
};
use futures_util::{StreamExt, stream};
use serde_json::Value;
use std::convert::Infallible;
use tokio::{net::TcpStream, time::timeout};

/// The start of every connection of HTTP/2, with no settings of the client's.
const PREFACE: &[u8] = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n\0\0\0\x04\0\0\0\0\0";
/// `GET /` without a body, as HPACK has it.
const HEAD: &[u8] = b"\x82\x86\x84\x41\x04test";
const HEADERS: u8 = 1;
const RST_STREAM: u8 = 3;
const GOAWAY: u8 = 7;
const WINDOW_UPDATE: u8 = 8;
const END_HEADERS: u8 = 4;
const ENHANCE_YOUR_CALM: u8 = 11;

fn frame(kind: u8, flags: u8, stream: u32, payload: &[u8]) -> Vec<u8> {
    let length = (payload.len() as u32).to_be_bytes();
    [&length[1..], &[kind, flags], &stream.to_be_bytes(), payload].concat()
}

/// The code of the GOAWAY that a connection ended with.
fn goaway(mut read: &[u8]) -> Option<u8> {
    while read.len() >= 9 {
        let length = usize::from(read[1]) << 8 | usize::from(read[2]);
        if read[3] == GOAWAY {
            return Some(read[9 + 7]);
        }
        read = read.get(9 + length..)?;
    }
    None
}

#[tokio::test]
async fn clients_that_take_back_what_they_sent_are_disconnected() {
    let service = Service::start(&[], 1);
    // CVE-2023-44487: requests that are reset at once. CVE-2025-8671: requests that the server is made to reset.
    let attacks = [("reset", RST_STREAM, &[0, 0, 0, 8][..], 200_u32), ("made to reset", WINDOW_UPDATE, &[0x7f, 0xff, 0xff, 0xff], 2500)];
    for (attack, kind, payload, times) in attacks {
        let mut bytes = PREFACE.to_vec();
        for stream in (1..).step_by(2).take(times as usize) {
            bytes.extend(frame(HEADERS, END_HEADERS, stream, HEAD));
            bytes.extend(frame(kind, 0, stream, payload));
        }
        assert_eq!(goaway(&raw(service.address, &bytes).await), Some(ENHANCE_YOUR_CALM), "{attack}");
    }
    let http2 = Http2::over(TcpStream::connect(service.address).await.unwrap()).await;
    assert_eq!(http2.ask(get(service.address, "http", "/readyz")).await.0, 200, "others are answered");
}

#[tokio::test]
async fn heads_that_are_too_large_are_refused_over_both_http() {
    let service = Service::start(&[], 1);
    let address = service.address;
    let connect = || async { TcpStream::connect(address).await.unwrap() };
    let with_cookie = |bytes: usize| {
        let mut request = get(address, "http", "/readyz");
        request.headers_mut().insert("cookie", "x".repeat(bytes).parse().unwrap());
        request
    };
    let with_query = |bytes: usize| get(address, "http", &format!("/readyz?{}", "x".repeat(bytes)));
    for (large, code) in [(with_cookie(40 << 10), "headers_too_large"), (with_query(9 << 10), "uri_too_long")] {
        let again = large.uri().clone();
        let mut copy = Request::get(again).body(Body::empty()).unwrap();
        *copy.headers_mut() = large.headers().clone();
        for (status, _, body) in [client::ask(connect().await, large).await, Http2::over(connect().await).await.ask(copy).await] {
            let problem: Value = serde_json::from_slice(&body).unwrap();
            assert_eq!((problem["code"].as_str().unwrap(), problem["status"].as_u64().unwrap()), (code, u64::from(status)));
        }
    }
    // Beyond what is taken in at all, the answer is the protocol's, without a document.
    let head = format!("GET /readyz HTTP/1.1\r\nHost: localhost\r\nCookie: {}\r\n\r\n", "x".repeat(70 << 10));
    let answer = String::from_utf8(raw(address, head.as_bytes()).await).unwrap();
    assert!(answer.is_empty() || answer.starts_with("HTTP/1.1 431 "), "{answer}");
    let (status, _, body) = Http2::over(connect().await).await.ask(with_cookie(70 << 10)).await;
    assert_eq!((status, body.len()), (431, 0));
    assert_eq!(client::ask(connect().await, with_cookie(20 << 10)).await.0, 200);
}

#[tokio::test]
async fn bodies_that_come_too_slowly_are_given_up_over_both_http() {
    let service = Service::start(&["--upload-seconds", "1"], 1);
    let address = service.address;
    let slow = || {
        let body = stream::iter([Ok::<_, Infallible>(Bytes::from("beginning"))]).chain(stream::pending());
        Request::post(format!("http://{address}/v1/reconstructions")).header("host", "localhost").body(Body::from_stream(body)).unwrap()
    };
    let first = client::ask(TcpStream::connect(address).await.unwrap(), slow()).await;
    let http2 = Http2::over(TcpStream::connect(address).await.unwrap()).await;
    for (status, _, body) in [first, http2.ask(slow()).await] {
        let problem: Value = serde_json::from_slice(&body).unwrap();
        assert_eq!((status, problem["code"].as_str().unwrap()), (408, "request_timeout"));
    }
    assert_eq!(http2.ask(get(address, "http", "/healthz")).await.0, 200, "the connection goes on");
}

#[tokio::test]
async fn no_more_connections_are_held_than_may_be() {
    let service = Service::start(&["--max-connections", "3", "--max-connections-per-client", "1"], 1);
    let address = service.address;
    let mut held = Vec::new();
    for _ in 0..3 {
        let http2 = Http2::over(TcpStream::connect(address).await.unwrap()).await;
        assert_eq!(http2.ask(get(address, "http", "/healthz")).await.0, 200, "loopback may have more than one client may");
        held.push(http2);
    }
    assert_eq!(raw(address, b"GET /healthz HTTP/1.1\r\nHost: localhost\r\n\r\n").await, b"");
    let (_, _, metrics) = held[0].ask(get(address, "http", "/metrics")).await;
    let metrics = String::from_utf8(metrics.to_vec()).unwrap();
    assert!(metrics.contains("\nventricle_http_connections 3\n"), "{metrics}");
    assert!(metrics.contains("\nventricle_http_connections_refused_total{reason=\"all\"} 1\n"), "{metrics}");
    held.clear();
    let room = async { while raw(address, b"GET /healthz HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n").await.is_empty() {} };
    timeout(PATIENCE, room).await.expect("ended connections make room");
}

#[tokio::test]
async fn many_large_bodies_at_once_take_no_more_memory_than_they_may() {
    const BODY_BYTES: usize = 16 << 20;
    let service = Service::start(&["--max-body-mb", "16", "--max-upload-memory-mb", "32", "--upload-seconds", "2"], 1);
    let before_mib = service.peak_mib();
    let clients: Vec<_> = (0..16)
        .map(|_| {
            let address = service.address;
            // All but the end, so that what is read is held until its time is over.
            let body = stream::iter([Ok::<_, Infallible>(Bytes::from(vec![0; BODY_BYTES - 1]))]).chain(stream::pending());
            let request = Request::post("/v1/reconstructions").header("host", "localhost").header("content-length", BODY_BYTES);
            let request = request.body(Body::from_stream(body)).unwrap();
            tokio::spawn(async move { client::ask(TcpStream::connect(address).await.unwrap(), request).await.0 })
        })
        .collect();
    let mut answers = Vec::new();
    for client in clients {
        answers.push(client.await.unwrap());
    }
    assert!(answers.contains(&408) && answers.iter().all(|status| [408, 503].contains(status)), "{answers:?}");
    let taken_mib = service.peak_mib() - before_mib;
    eprintln!("16 bodies of 16 MiB at once, of which two had room, took {taken_mib:.0} MiB");
    // Buffers that grow leave some behind (91 MiB were seen); all bodies together have 256.
    assert!(taken_mib < 160.0, "{taken_mib} MiB");
    let (_, _, metrics) = client::ask(TcpStream::connect(service.address).await.unwrap(), get(service.address, "http", "/metrics")).await;
    assert!(String::from_utf8(metrics.to_vec()).unwrap().contains("\nventricle_upload_reserved_bytes 0\n"), "all room is given back");
}
