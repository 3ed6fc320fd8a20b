//! A service with a certificate.

use crate::served::Directory;
use std::{
    fs,
    io::{BufRead, BufReader},
    net::SocketAddr,
    path::PathBuf,
    process::{Child, Command, ExitStatus, Stdio},
    time::{Duration, Instant},
};
use tokio_rustls::rustls::pki_types::CertificateDer;

/// A certificate with its key in files.
pub(super) struct Identity {
    directory: Directory,
}

impl Identity {
    /// Without files yet.
    pub(super) fn new() -> Self {
        Self { directory: Directory::new("identity") }
    }

    /// Writes another certificate and returns it.
    pub(super) fn renew(&self) -> CertificateDer<'static> {
        let made = rcgen::generate_simple_self_signed(["localhost".to_owned(), "127.0.0.1".to_owned()]).unwrap();
        fs::write(self.key(), made.signing_key.serialize_pem()).unwrap();
        fs::write(self.certificate(), made.cert.pem()).unwrap();
        made.cert.der().clone()
    }

    /// Makes the file of the certificate hold none.
    pub(super) fn spoil(&self) {
        fs::write(self.certificate(), "no certificate").unwrap();
    }

    pub(super) fn certificate(&self) -> PathBuf {
        self.directory.0.join("cert.pem")
    }

    pub(super) fn key(&self) -> PathBuf {
        self.directory.0.join("key.pem")
    }
}

/// `ventricle serve` with these flags, killed when dropped.
pub(super) struct Service {
    child: Child,
    /// What it says where it listens, line by line.
    pub(super) lines: Vec<String>,
    /// Where it listens for HTTP.
    pub(super) address: SocketAddr,
    data: Directory,
}

impl Service {
    /// Starts it and waits for so many lines.
    pub(super) fn start(flags: &[&str], lines: usize) -> Self {
        let data = Directory::new("transport");
        let log = fs::File::create(data.0.join("log")).unwrap();
        let mut child = Command::new(env!("CARGO_BIN_EXE_ventricle"))
            .args(["serve", "--listen", "127.0.0.1:0", "--log", "info", "--workers", "1", "--data-dir"])
            .arg(&data.0)
            .args(flags)
            .stdout(Stdio::piped())
            .stderr(log)
            .spawn()
            .unwrap();
        let mut stdout = BufReader::new(child.stdout.take().unwrap()).lines();
        let lines: Vec<String> = (0..lines).filter_map(|_| stdout.next()).map(Result::unwrap).collect();
        let address = lines.first().and_then(|line| line.rsplit("//").next()?.parse().ok());
        let Some(address) = address else { panic!("the service said {lines:?} and {}", fs::read_to_string(data.0.join("log")).unwrap()) };
        Self { child, lines, address, data }
    }

    /// With this certificate for HTTP.
    pub(super) fn encrypted(identity: &Identity, flags: &[&str]) -> Self {
        let (certificate, key) = (identity.certificate(), identity.key());
        let own = ["--tls-cert", certificate.to_str().unwrap(), "--tls-key", key.to_str().unwrap()];
        Self::start(&[&own, flags].concat(), 1)
    }

    /// The most memory it has held so far, in MiB.
    pub(super) fn peak_mib(&self) -> f64 {
        let status = fs::read_to_string(format!("/proc/{}/status", self.child.id())).unwrap();
        let line = status.lines().find(|line| line.starts_with("VmHWM:")).unwrap();
        line.split_whitespace().nth(1).unwrap().parse::<f64>().unwrap() / 1024.0
    }

    pub(super) fn log(&self) -> String {
        fs::read_to_string(self.data.0.join("log")).unwrap()
    }

    /// Sends it a signal by name.
    pub(super) fn signal(&self, name: &str) {
        let status = Command::new("kill").args([format!("-{name}"), self.child.id().to_string()]).status().unwrap();
        assert!(status.success(), "kill -{name}: {status}");
    }

    /// Waits until its log has a text so many times.
    pub(super) fn says(&self, text: &str, times: usize) {
        let began = Instant::now();
        while self.log().matches(text).count() < times {
            assert!(began.elapsed() < Duration::from_secs(20), "the log does not have {text:?} {times} times: {}", self.log());
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    /// The status with which it ends by itself.
    pub(super) fn ended(mut self) -> ExitStatus {
        let began = Instant::now();
        loop {
            if let Some(status) = self.child.try_wait().unwrap() {
                return status;
            }
            assert!(began.elapsed() < Duration::from_secs(30), "it runs on: {}", self.log());
            std::thread::sleep(Duration::from_millis(20));
        }
    }
}

impl Drop for Service {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
