//! `ventricle healthcheck`: what a container runs to learn whether its service is ready.

use std::time::Duration;

/// Time the service has to answer.
const ANSWER_TIME: Duration = Duration::from_secs(3);

/// Arguments of `ventricle healthcheck`.
#[derive(clap::Args)]
pub(crate) struct Args {
    /// Address of the service.
    #[arg(long, env = "VENTRICLE_URL", default_value = "http://127.0.0.1:8080")]
    url: String,
}

/// Prints what the service answers and fails if it is not ready.
pub(crate) fn run(Args { url }: Args) -> anyhow::Result<()> {
    let agent: ureq::Agent =
        ureq::Agent::config_builder().timeout_global(Some(ANSWER_TIME)).http_status_as_error(false).proxy(None).build().into();
    let url = format!("{}/readyz", url.trim_end_matches('/'));
    let mut response = agent.get(&url).call().map_err(|error| anyhow::anyhow!("{url} does not answer: {error}"))?;
    let text = response.body_mut().read_to_string()?;
    anyhow::ensure!(response.status().is_success(), "{url} answers {}: {text}", response.status());
    println!("{text}");
    Ok(())
}
