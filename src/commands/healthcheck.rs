//! `ventricle healthcheck`: what a container runs to learn whether its service is ready.

use anyhow::Context as _;
use std::{
    net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr},
    path::{Path, PathBuf},
    sync::Arc,
    time::Duration,
};
use tokio_rustls::rustls::crypto::ring;
use ureq::{
    http::Uri,
    tls::{Certificate, PemItem, RootCerts, TlsConfig},
};

/// Time the service has to answer.
const ANSWER_TIME: Duration = Duration::from_secs(3);

/// Arguments of `ventricle healthcheck`.
#[derive(clap::Args)]
pub(crate) struct Args {
    /// Address of the service [default: where `--listen` says].
    #[arg(long, env = "VENTRICLE_URL")]
    url: Option<String>,

    /// Address the service listens on, as `ventricle serve` reads it; all addresses are asked through the loopback one.
    #[arg(long, env = "VENTRICLE_LISTEN", default_value = "127.0.0.1:8080")]
    listen: SocketAddr,

    /// Certificate of the service, as `ventricle serve` reads it: where there is one, it is asked by HTTPS.
    #[arg(long, env = "VENTRICLE_TLS_CERT")]
    tls_cert: Option<PathBuf>,

    /// PEM file of the certificate authorities that a service under `--url` is checked against; one on this machine (`--listen`, or a
    /// loopback address) is not checked.
    #[arg(long, env = "VENTRICLE_CA_FILE", default_value = "/etc/ssl/certs/ca-certificates.crt")]
    ca_file: PathBuf,
}

/// Where a service on this machine is asked that listens on an address.
fn local_url(listen: SocketAddr, encrypted: bool) -> String {
    let ip = match listen.ip() {
        IpAddr::V4(Ipv4Addr::UNSPECIFIED) => IpAddr::V4(Ipv4Addr::LOCALHOST),
        IpAddr::V6(Ipv6Addr::UNSPECIFIED) => IpAddr::V6(Ipv6Addr::LOCALHOST),
        ip => ip,
    };
    format!("{}://{}", if encrypted { "https" } else { "http" }, SocketAddr::new(ip, listen.port()))
}

/// Whether a URL leads to this machine, however its network is set up.
fn is_loopback(url: &str) -> bool {
    let Ok(uri) = url.parse::<Uri>() else { return false };
    let host = uri.host().unwrap_or_default().trim_start_matches('[').trim_end_matches(']');
    host.eq_ignore_ascii_case("localhost") || host.parse::<IpAddr>().is_ok_and(|address| address.is_loopback())
}

/// Certificates of the service on this machine name the hosts that clients know it by, not the address that it is asked at here; nobody else
/// answers there. Others are checked.
fn tls(own: bool, ca_file: &Path) -> anyhow::Result<TlsConfig> {
    let config = TlsConfig::builder().unversioned_rustls_crypto_provider(Arc::new(ring::default_provider()));
    if own {
        return Ok(config.disable_verification(true).root_certs(RootCerts::new_with_certs(&[])).build());
    }
    let pem = std::fs::read(ca_file).with_context(|| format!("The file of --ca-file, {}, cannot be read", ca_file.display()))?;
    let items = ureq::tls::parse_pem(&pem).filter_map(Result::ok);
    let roots: Vec<Certificate<'static>> =
        items.filter_map(|item| if let PemItem::Certificate(certificate) = item { Some(certificate) } else { None }).collect();
    Ok(config.root_certs(RootCerts::new_with_certs(&roots)).build())
}

/// Prints what the service answers and fails if it is not ready.
pub(crate) fn run(Args { url, listen, tls_cert, ca_file }: Args) -> anyhow::Result<()> {
    let own = url.as_deref().is_none_or(is_loopback);
    let url = url.unwrap_or_else(|| local_url(listen, tls_cert.is_some()));
    let mut config = ureq::Agent::config_builder().timeout_global(Some(ANSWER_TIME)).http_status_as_error(false).proxy(None);
    if url.starts_with("https://") {
        config = config.tls_config(tls(own, &ca_file)?);
    }
    let agent: ureq::Agent = config.build().into();
    let url = format!("{}/readyz", url.trim_end_matches('/'));
    let mut response = agent.get(&url).call().map_err(|error| anyhow::anyhow!("{url} does not answer: {error}"))?;
    let text = response.body_mut().read_to_string()?;
    anyhow::ensure!(response.status().is_success(), "{url} answers {}: {text}", response.status());
    println!("{text}");
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_service_on_all_addresses_is_asked_on_the_loopback_one() {
        for (listen, url) in
            [("0.0.0.0:8080", "http://127.0.0.1:8080"), ("[::]:9000", "http://[::1]:9000"), ("192.0.2.7:80", "http://192.0.2.7:80")]
        {
            assert_eq!(local_url(listen.parse().unwrap(), false), url);
        }
        assert_eq!(local_url("0.0.0.0:443".parse().unwrap(), true), "https://127.0.0.1:443");
    }

    #[test]
    fn only_a_service_on_this_machine_goes_unchecked() {
        for own in ["https://127.0.0.1:8443", "https://[::1]", "https://localhost:8443/", "https://127.8.8.8"] {
            assert!(is_loopback(own), "{own}");
        }
        for other in
            ["https://ventricle.example", "https://192.0.2.7:8443", "https://localhost.example", "https://127.0.0.1.example", "x y"]
        {
            assert!(!is_loopback(other), "{other}");
        }
        assert!(tls(true, Path::new("/no/such/file")).unwrap().disable_verification());
        let refused = tls(false, Path::new("/no/such/file")).unwrap_err().to_string();
        assert!(refused.contains("--ca-file, /no/such/file"), "{refused}");
    }
}
