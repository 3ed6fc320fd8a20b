//! The audit log: who did what, when, with which job. One JSON object a line, only ever added to a file of its own.
//!
//! A thread writes; who has something to tell waits until his line is in the file, so that nothing is answered without it, except when the file cannot
//! be written at all: then it is said in the other log, counted, and `/readyz` fails.

use jiff::Timestamp;
use serde::Serialize;
use std::{
    fs::{File, OpenOptions},
    io::{self, Write as _},
    net::IpAddr,
    path::{Path, PathBuf},
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    thread,
};
use tokio::sync::{mpsc, oneshot};
use uuid::Uuid;

/// Lines that may wait to be written.
const BACKLOG: usize = 4096;

/// The file cannot be opened.
#[derive(Debug, thiserror::Error)]
#[error("The audit log {} cannot be written: {source}. Name another file with --audit-log.", path.display())]
pub struct AuditError {
    /// The file.
    pub path: PathBuf,
    /// What the system says.
    pub source: io::Error,
}

/// What was done. It holds nothing of a patient: jobs are known by their ids.
#[derive(Debug, Clone, Serialize)]
pub struct Deed {
    /// When it was asked.
    pub at: Timestamp,
    /// What: the method and the matched path of a request; `C-STORE`, or `A-ASSOCIATE` of an association that was rejected; `assembly` of a series
    /// that went quiet; `keys add` and `keys revoke`.
    pub what: String,
    /// How it went: the status that the protocol has for it, if there is one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub status: Option<u16>,
    /// Whose jobs were in question.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub owner: Option<String>,
    /// Who: the id of a key, the subject of a token, the calling AE title, which proves nothing, or the system's user.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub who: Option<String>,
    /// From where, if over a network.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub address: Option<IpAddr>,
    /// With which jobs.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub jobs: Vec<Uuid>,
    /// With which key, by its id.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub key: Option<String>,
    /// Why it was refused: a problem's code, or what DICOM calls the reason.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub refused: Option<String>,
    /// The id of the request or the association, as in the other log.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub request_id: Option<String>,
}

impl Deed {
    /// What is done now, by nobody over a network.
    pub fn now(what: impl Into<String>) -> Self {
        Self {
            at: Timestamp::now(),
            what: what.into(),
            status: None,
            owner: None,
            who: None,
            address: None,
            jobs: Vec::new(),
            key: None,
            refused: None,
            request_id: None,
        }
    }

    /// What is asked now, before it is known by whom and how it goes.
    pub fn asked(what: impl Into<String>, address: IpAddr, request_id: String) -> Self {
        Self { address: Some(address), request_id: Some(request_id), ..Self::now(what) }
    }
}

/// The file of an audit log.
#[derive(Debug)]
pub struct AuditFile {
    path: PathBuf,
    file: File,
    /// The last line has no end: the disk was full in the middle of it.
    torn: bool,
}

impl AuditFile {
    /// Opens it, to add to it; makes it if it is absent.
    ///
    /// # Errors
    /// It cannot be opened.
    pub fn open(path: &Path) -> Result<Self, AuditError> {
        let file = opened(path).map_err(|source| AuditError { path: path.to_owned(), source })?;
        Ok(Self { path: path.to_owned(), file, torn: false })
    }

    /// Adds a line in one call, so that lines of several processes do not mix. What is left of a line that could not be written ends before the next.
    ///
    /// # Errors
    /// It cannot be written.
    pub fn add(&mut self, deed: &Deed) -> io::Result<()> {
        let mut line = if self.torn { vec![b'\n'] } else { Vec::new() };
        serde_json::to_writer(&mut line, deed)?;
        line.push(b'\n');
        let written = self.file.write(&line)?;
        self.torn = written < line.len();
        if self.torn { Err(io::Error::from(io::ErrorKind::WriteZero)) } else { Ok(()) }
    }

    /// Opens it anew, after somebody has moved it away.
    fn reopen(&mut self) -> io::Result<()> {
        (self.file, self.torn) = (opened(&self.path)?, false);
        Ok(())
    }
}

fn opened(path: &Path) -> io::Result<File> {
    use std::os::unix::fs::OpenOptionsExt as _;
    OpenOptions::new().create(true).append(true).mode(0o600).open(path)
}

enum Order {
    Write(Box<Deed>, oneshot::Sender<()>),
    Reopen,
}

/// The audit log.
#[derive(Clone)]
pub struct Audit {
    orders: mpsc::Sender<Order>,
    writable: Arc<AtomicBool>,
}

impl Audit {
    /// Opens the file, to add to it.
    ///
    /// # Errors
    /// It cannot be opened, or the system gives no thread.
    pub fn open(path: &Path) -> Result<Self, AuditError> {
        let file = AuditFile::open(path)?;
        let (orders, receiver) = mpsc::channel(BACKLOG);
        let writable = Arc::new(AtomicBool::new(true));
        let writer = Writer { file, writable: Arc::clone(&writable) };
        let started = thread::Builder::new().name("audit".to_owned()).spawn(move || writer.run(receiver));
        started.map_err(|source| AuditError { path: path.to_owned(), source })?;
        Ok(Self { orders, writable })
    }

    /// Tells of a deed; when this returns, its line is in the file, or it was said that it could not be written.
    pub async fn tell(&self, deed: Deed) {
        let (written, done) = oneshot::channel();
        if self.orders.send(Order::Write(Box::new(deed), written)).await.is_err() || done.await.is_err() {
            self.writable.store(false, Ordering::Relaxed);
        }
    }

    /// Opens the file anew, after somebody has moved it away.
    pub async fn reopen(&self) {
        // Where the writer is gone, `is_writable` says so.
        drop(self.orders.send(Order::Reopen).await);
    }

    /// Whether the last line could be written.
    pub fn is_writable(&self) -> bool {
        self.writable.load(Ordering::Relaxed)
    }
}

struct Writer {
    file: AuditFile,
    writable: Arc<AtomicBool>,
}

impl Writer {
    fn run(mut self, mut orders: mpsc::Receiver<Order>) {
        while let Some(order) = orders.blocking_recv() {
            let (done, waits) = match order {
                Order::Write(deed, waits) => (self.file.add(&deed), Some(waits)),
                Order::Reopen => (self.file.reopen(), None),
            };
            if let Err(error) = &done {
                metrics::counter!("ventricle_audit_failures_total").increment(1);
                tracing::error!(%error, "the audit log cannot be written");
            }
            self.writable.store(done.is_ok(), Ordering::Relaxed);
            if let Some(waits) = waits {
                // Who asked may have gone away.
                let _ = waits.send(());
            }
        }
    }
}
