//! Certificates: shown to clients of both versions of TLS, replaced while the service runs, and asked by its own health check.

use super::{
    child::{Identity, Service},
    client::{self, BOTH, Http2, PATIENCE, encrypted, get, shows},
};
use http_body_util::BodyExt;
use std::{process::Command, time::Duration};
use tokio::{net::TcpStream, time::timeout};
use tokio_rustls::rustls::{ProtocolVersion, version};

const YEAR: &str = "max-age=31536000";

#[tokio::test]
async fn both_versions_of_tls_and_both_of_http_are_spoken() {
    let identity = Identity::new();
    let certificate = identity.renew();
    let service = Service::encrypted(&identity, &[]);
    let address = service.address;
    assert!(service.lines[0].ends_with(&format!("listens on https://{address}")), "{:?}", service.lines);
    for (versions, expected) in [([&version::TLS13], ProtocolVersion::TLSv1_3), ([&version::TLS12], ProtocolVersion::TLSv1_2)] {
        for (offered, agreed) in [(&["h2", "http/1.1"][..], Some("h2")), (&["http/1.1"], Some("http/1.1")), (&[], None)] {
            let stream = encrypted(address, &certificate, &versions, offered).await.unwrap();
            let connection = stream.get_ref().1;
            assert_eq!(connection.protocol_version(), Some(expected));
            assert_eq!(connection.alpn_protocol(), agreed.map(str::as_bytes));
            let request = get(address, "https", "/readyz");
            let (status, headers, _) =
                if agreed == Some("h2") { Http2::over(stream).await.ask(request).await } else { client::ask(stream, request).await };
            assert_eq!((status, headers["strict-transport-security"].to_str().unwrap()), (200, YEAR), "{expected:?} {agreed:?}");
        }
    }
    // A client that stays connected does not hold up the end.
    let idle = Http2::over(encrypted(address, &certificate, &BOTH, &["h2"]).await.unwrap()).await;
    assert_eq!(idle.ask(get(address, "https", "/healthz")).await.0, 200);
    service.signal("TERM");
    assert!(tokio::task::spawn_blocking(|| service.ended()).await.unwrap().success());
}

#[tokio::test]
async fn without_tls_http2_is_spoken_to_who_knows_it_and_browsers_are_told_nothing() {
    let service = Service::start(&[], 1);
    let address = service.address;
    let http2 = Http2::over(TcpStream::connect(address).await.unwrap()).await;
    let (status, headers, _) = http2.ask(get(address, "http", "/readyz")).await;
    assert!(status == 200 && !headers.contains_key("strict-transport-security"));
    let (status, headers, _) = client::ask(TcpStream::connect(address).await.unwrap(), get(address, "http", "/readyz")).await;
    assert!(status == 200 && !headers.contains_key("strict-transport-security"));
}

#[tokio::test]
async fn who_forgets_to_encrypt_is_told() {
    let identity = Identity::new();
    identity.renew();
    let service = Service::encrypted(&identity, &["--hsts-seconds", "0"]);
    let answer = client::raw(service.address, b"GET / HTTP/1.1\r\nHost: localhost\r\n\r\n").await;
    let answer = String::from_utf8(answer).unwrap();
    assert!(answer.starts_with("HTTP/1.1 400 ") && answer.contains("HTTPS"), "{answer}");
    assert_eq!(client::raw(service.address, &[0; 64]).await, b"");
}

#[tokio::test]
async fn the_health_check_asks_an_encrypted_service() {
    let identity = Identity::new();
    identity.renew();
    let service = Service::encrypted(&identity, &["--hsts-seconds", "0"]);
    let (listen, certificate) = (service.address.to_string(), identity.certificate());
    let check = |flags: &[&str]| Command::new(env!("CARGO_BIN_EXE_ventricle")).arg("healthcheck").args(flags).output().unwrap();
    let url = format!("https://{listen}");
    for flags in [&["--listen", &*listen, "--tls-cert", certificate.to_str().unwrap()][..], &["--url", &*url]] {
        let said = check(flags);
        assert!(said.status.success() && String::from_utf8_lossy(&said.stdout).contains("\"ready\""), "{said:?}");
    }
    assert!(!check(&["--listen", &listen]).status.success(), "it is not asked without TLS");
}

#[tokio::test]
async fn a_certificate_is_replaced_under_way_and_a_broken_one_is_not() {
    let identity = Identity::new();
    let first = identity.renew();
    let (certificate, key) = (identity.certificate(), identity.key());
    let (certificate, key) = (certificate.to_str().unwrap(), key.to_str().unwrap());
    let dimse = ["--dimse-listen", "127.0.0.1:0", "--dimse-tls-cert", certificate, "--dimse-tls-key", key];
    let service = Service::start(&[&["--tls-cert", certificate, "--tls-key", key][..], &dimse].concat(), 2);
    let address = service.address;
    let dimse_address = service.lines[1].rsplit('@').next().unwrap().parse().unwrap();
    assert!(shows(address, &first).await && shows(dimse_address, &first).await);

    // A stream of events and a connection that were there before.
    let before = Http2::over(encrypted(address, &first, &BOTH, &["h2"]).await.unwrap()).await;
    let mut events = before.send(get(address, "https", "/v1/reconstructions/events")).await.into_body();
    timeout(PATIENCE, events.frame()).await.unwrap().unwrap().unwrap();

    let second = identity.renew();
    assert!(shows(address, &first).await, "it is read again only when told");
    service.signal("HUP");
    service.says("the certificate was read again", 2);
    for address in [address, dimse_address] {
        assert!(shows(address, &second).await && !shows(address, &first).await);
    }
    identity.spoil();
    service.signal("HUP");
    service.says("the certificate that was read before is used further", 2);
    assert!(service.log().contains("it holds no certificate") && service.log().contains("--dimse-tls-cert"), "{}", service.log());
    assert!(shows(address, &second).await && shows(dimse_address, &second).await);

    assert_eq!(before.ask(get(address, "https", "/readyz")).await.0, 200, "the old connection goes on");
    assert!(timeout(Duration::from_millis(50), events.frame()).await.is_err(), "the stream has not ended");
}

#[test]
fn a_certificate_that_cannot_be_used_ends_the_start_with_a_sentence() {
    let identity = Identity::new();
    identity.renew();
    identity.spoil();
    let (certificate, key) = (identity.certificate(), identity.key());
    let said = Command::new(env!("CARGO_BIN_EXE_ventricle"))
        .args(["serve", "--listen", "127.0.0.1:0", "--data-dir", "/nonexistent/never", "--tls-cert"])
        .args([certificate.as_os_str(), "--tls-key".as_ref(), key.as_os_str()])
        .output()
        .unwrap();
    let error = String::from_utf8_lossy(&said.stderr);
    assert!(!said.status.success() && error.contains("The HTTP listener cannot use ") && error.contains("with --tls-cert"), "{error}");
}
