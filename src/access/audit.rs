//! The audit log: who did what, when, with which job. One JSON object a line, only ever added to a file of its own.
//!
//! A thread writes; who has something to tell waits while it is behind, so that nothing is done without its line, except when the file cannot be
//! written at all: then it is said in the other log, counted, and `/readyz` fails.

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
use tokio::sync::mpsc;
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
    /// What: the method and the matched path of a request; `C-STORE`, or `A-ASSOCIATE` of an association that was rejected.
    pub what: String,
    /// How it went: the status that the protocol has for it.
    pub status: u16,
    /// Whose jobs were in question.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub owner: Option<String>,
    /// Who: the id of a key, the subject of a token, or the calling AE title, which proves nothing.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub who: Option<String>,
    /// From where.
    pub address: IpAddr,
    /// With which jobs.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub jobs: Vec<Uuid>,
    /// Why it was refused: a problem's code, or what DICOM calls the reason.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub refused: Option<String>,
    /// The id of the request or the association, as in the other log.
    pub request_id: String,
}

impl Deed {
    /// What is asked now, before it is known by whom and how it goes.
    pub fn asked(what: String, address: IpAddr, request_id: String) -> Self {
        Self { at: Timestamp::now(), what, status: 0, owner: None, who: None, address, jobs: Vec::new(), refused: None, request_id }
    }
}

enum Order {
    Write(Deed),
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
        let failed = |source| AuditError { path: path.to_owned(), source };
        let file = opened(path).map_err(failed)?;
        let (orders, receiver) = mpsc::channel(BACKLOG);
        let writable = Arc::new(AtomicBool::new(true));
        let writer = Writer { path: path.to_owned(), file, writable: Arc::clone(&writable), torn: false };
        thread::Builder::new().name("audit".to_owned()).spawn(move || writer.run(receiver)).map_err(failed)?;
        Ok(Self { orders, writable })
    }

    /// Tells of a deed.
    pub async fn tell(&self, deed: Deed) {
        if self.orders.send(Order::Write(deed)).await.is_err() {
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

fn opened(path: &Path) -> io::Result<File> {
    use std::os::unix::fs::OpenOptionsExt as _;
    OpenOptions::new().create(true).append(true).mode(0o600).open(path)
}

struct Writer {
    path: PathBuf,
    file: File,
    writable: Arc<AtomicBool>,
    /// The last line has no end: the disk was full in the middle of it.
    torn: bool,
}

impl Writer {
    fn run(mut self, mut orders: mpsc::Receiver<Order>) {
        while let Some(order) = orders.blocking_recv() {
            let done = match order {
                Order::Write(deed) => self.write(&deed),
                Order::Reopen => opened(&self.path).map(|file| (self.file, self.torn) = (file, false)),
            };
            if let Err(error) = &done {
                metrics::counter!("ventricle_audit_failures_total").increment(1);
                tracing::error!(%error, "the audit log cannot be written");
            }
            self.writable.store(done.is_ok(), Ordering::Relaxed);
        }
    }

    /// In one call, so that lines of several processes do not mix. What is left of a line that could not be written ends before the next.
    fn write(&mut self, deed: &Deed) -> io::Result<()> {
        let mut line = if self.torn { vec![b'\n'] } else { Vec::new() };
        serde_json::to_writer(&mut line, deed)?;
        line.push(b'\n');
        let written = self.file.write(&line)?;
        self.torn = written < line.len();
        if self.torn { Err(io::Error::from(io::ErrorKind::WriteZero)) } else { Ok(()) }
    }
}
