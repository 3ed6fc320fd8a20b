//! `ventricle healthcheck`: what a container runs to learn whether its service is ready.

use std::{
    net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr},
    time::Duration,
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
}

/// Where a service on this machine is asked that listens on an address.
fn local_url(listen: SocketAddr) -> String {
    let ip = match listen.ip() {
        IpAddr::V4(Ipv4Addr::UNSPECIFIED) => IpAddr::V4(Ipv4Addr::LOCALHOST),
        IpAddr::V6(Ipv6Addr::UNSPECIFIED) => IpAddr::V6(Ipv6Addr::LOCALHOST),
        ip => ip,
    };
    format!("http://{}", SocketAddr::new(ip, listen.port()))
}

/// Prints what the service answers and fails if it is not ready.
pub(crate) fn run(Args { url, listen }: Args) -> anyhow::Result<()> {
    let url = url.unwrap_or_else(|| local_url(listen));
    let agent: ureq::Agent =
        ureq::Agent::config_builder().timeout_global(Some(ANSWER_TIME)).http_status_as_error(false).proxy(None).build().into();
    let url = format!("{}/readyz", url.trim_end_matches('/'));
    let mut response = agent.get(&url).call().map_err(|error| anyhow::anyhow!("{url} does not answer: {error}"))?;
    let text = response.body_mut().read_to_string()?;
    anyhow::ensure!(response.status().is_success(), "{url} answers {}: {text}", response.status());
    println!("{text}");
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::local_url;

    #[test]
    fn a_service_on_all_addresses_is_asked_on_the_loopback_one() {
        for (listen, url) in
            [("0.0.0.0:8080", "http://127.0.0.1:8080"), ("[::]:9000", "http://[::1]:9000"), ("192.0.2.7:80", "http://192.0.2.7:80")]
        {
            assert_eq!(local_url(listen.parse().unwrap()), url);
        }
    }
}
