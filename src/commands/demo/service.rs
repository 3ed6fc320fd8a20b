//! The demo's own service: the same binary as a child process, stopped as an operator would stop it.

use super::client::Client;
use anyhow::{Context as _, bail};
use std::{
    fs::{self, File},
    net::{Ipv4Addr, SocketAddr, TcpListener},
    path::{Path, PathBuf},
    process::{Child, Command, ExitStatus, Stdio},
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::{Duration, Instant},
};

/// How long the service may take to become ready.
const READY_WITHIN: Duration = Duration::from_secs(30);

/// How long it may take to stop, a little more than its own drain time.
const STOPPED_WITHIN: Duration = Duration::from_secs(40);

const STEP: Duration = Duration::from_millis(50);

/// Whether someone asked the demo to end (SIGINT, SIGTERM).
#[derive(Clone)]
pub(super) struct Signals(Arc<AtomicBool>);

impl Signals {
    /// Starts listening. From now on a signal does not end the process by itself: the service is to be stopped first.
    pub(super) fn listen() -> anyhow::Result<Self> {
        let flag = Arc::new(AtomicBool::new(false));
        let raised = Arc::clone(&flag);
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
        std::thread::Builder::new().name("signals".to_owned()).spawn(move || {
            runtime.block_on(async {
                asked_to_end().await;
                raised.store(true, Ordering::SeqCst);
                // A second request is not waited for.
                asked_to_end().await;
                std::process::exit(130);
            });
        })?;
        Ok(Self(flag))
    }

    /// Whether one has come.
    pub(super) fn received(&self) -> bool {
        self.0.load(Ordering::SeqCst)
    }
}

#[cfg(unix)]
async fn asked_to_end() {
    use tokio::signal::unix::{SignalKind, signal};
    match signal(SignalKind::terminate()) {
        Ok(mut terminate) => {
            tokio::select! {
                _ = tokio::signal::ctrl_c() => {}
                _ = terminate.recv() => {}
            }
        }
        Err(_) => {
            let _ = tokio::signal::ctrl_c().await;
        }
    }
}

#[cfg(not(unix))]
async fn asked_to_end() {
    let _ = tokio::signal::ctrl_c().await;
}

/// A running service; killed when dropped, stopped by [`Service::stop`].
pub(super) struct Service {
    child: Child,
    address: SocketAddr,
    log: PathBuf,
}

impl Service {
    /// Starts one and waits until it is ready.
    pub(super) fn start(listen: Option<SocketAddr>, data_dir: &Path, signals: &Signals) -> anyhow::Result<Self> {
        let address = address(listen)?;
        fs::create_dir_all(data_dir).with_context(|| format!("{} could not be made", data_dir.display()))?;
        let log = data_dir.join("service.log");
        // Appended to: should another demo use the directory, its service still writes there.
        let file =
            File::options().create(true).append(true).open(&log).with_context(|| format!("{} could not be written", log.display()))?;
        let program = std::env::current_exe().context("the path of this program is unknown")?;
        let child = Command::new(program)
            .args(["serve", "--listen", &address.to_string(), "--data-dir"])
            .arg(data_dir)
            .env_remove("VENTRICLE_DATABASE_URL")
            .env_remove("VENTRICLE_TLS_CERT")
            .env_remove("VENTRICLE_TLS_KEY")
            .stdin(Stdio::null())
            .stdout(file.try_clone()?)
            .stderr(file)
            .spawn()
            .context("the service could not be started")?;
        let mut service = Self { child, address, log };
        let client = Client::new(&service.url());
        let began = Instant::now();
        while !client.is_ready() {
            if let Some(status) = service.child.try_wait()? {
                bail!("the service ended at once ({status}):\n{}", service.last_lines());
            }
            if signals.received() {
                service.stop()?;
                bail!("interrupted");
            }
            if began.elapsed() > READY_WITHIN {
                bail!("the service did not become ready in {} s:\n{}", READY_WITHIN.as_secs(), service.last_lines());
            }
            std::thread::sleep(STEP);
        }
        Ok(service)
    }

    /// Its address as a URL.
    pub(super) fn url(&self) -> String {
        format!("http://{}", self.address)
    }

    /// Where it logs to.
    pub(super) fn log(&self) -> &Path {
        &self.log
    }

    /// Asks it to stop (SIGTERM), as a container engine or init would, and waits for its end.
    pub(super) fn stop(mut self) -> anyhow::Result<()> {
        ask_to_stop(&mut self.child)?;
        let began = Instant::now();
        while began.elapsed() < STOPPED_WITHIN {
            if let Some(status) = self.child.try_wait()? {
                return ended(status, &self);
            }
            std::thread::sleep(STEP);
        }
        bail!("the service did not stop in {} s and is killed:\n{}", STOPPED_WITHIN.as_secs(), self.last_lines())
    }

    /// Waits until it ends or someone asks the demo to, and then stops it.
    pub(super) fn run_until(mut self, signals: &Signals) -> anyhow::Result<()> {
        while !signals.received() {
            if let Some(status) = self.child.try_wait()? {
                return ended(status, &self);
            }
            std::thread::sleep(STEP);
        }
        self.stop()
    }

    fn last_lines(&self) -> String {
        let text = fs::read_to_string(&self.log).unwrap_or_default();
        let lines: Vec<&str> = text.lines().collect();
        lines[lines.len().saturating_sub(10)..].join("\n")
    }
}

impl Drop for Service {
    fn drop(&mut self) {
        // Accepted jobs are on disk: a killed service loses none. After an orderly stop this finds nothing to kill.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn ended(status: ExitStatus, service: &Service) -> anyhow::Result<()> {
    if status.success() { Ok(()) } else { bail!("the service ended with {status}:\n{}", service.last_lines()) }
}

/// The address asked for; else port 8080, or a free one when it is taken.
fn address(listen: Option<SocketAddr>) -> anyhow::Result<SocketAddr> {
    let free = |address: SocketAddr| TcpListener::bind(address).and_then(|listener| listener.local_addr());
    match listen {
        Some(address) => free(address).with_context(|| format!("{address} cannot be listened on")),
        None => {
            free((Ipv4Addr::LOCALHOST, 8080).into()).or_else(|_| free((Ipv4Addr::LOCALHOST, 0).into())).context("no local port is free")
        }
    }
}

#[cfg(unix)]
fn ask_to_stop(child: &mut Child) -> anyhow::Result<()> {
    // A child that has ended is still ours until it is waited for, so its id cannot belong to another process.
    if let Some(pid) = rustix::process::Pid::from_raw(child.id().cast_signed()) {
        rustix::process::kill_process(pid, rustix::process::Signal::TERM).context("the service could not be asked to stop")?;
    }
    Ok(())
}

#[cfg(not(unix))]
fn ask_to_stop(child: &mut Child) -> anyhow::Result<()> {
    child.kill().context("the service could not be stopped")
}
