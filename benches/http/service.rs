//! The service as a process of its own, and what the system says of it.

use std::{
    env, fs,
    io::{BufRead, BufReader},
    net::SocketAddr,
    path::{Path, PathBuf},
    process::{Child, Command, Stdio},
};

/// Where the service keeps its jobs.
pub(crate) enum Place<'a> {
    /// A directory of its own.
    Sqlite,
    /// This database.
    Postgres(&'a str),
}

/// A running service; killed, and its directory deleted, when dropped.
pub(crate) struct Service {
    child: Child,
    directory: PathBuf,
    pub(crate) address: SocketAddr,
}

impl Service {
    #[allow(clippy::disallowed_methods)] // which program is measured is no setting of the service
    pub(crate) fn start(place: &Place<'_>, flags: &[&str]) -> Self {
        let directory = env::temp_dir().join(format!("ventricle-bench-{}", uuid::Uuid::now_v7()));
        // Another build can be measured beside this one.
        let program = env::var_os("BENCH_PROGRAM").unwrap_or_else(|| env!("CARGO_BIN_EXE_ventricle").into());
        let mut command = Command::new(program);
        command.args(["serve", "--listen", "127.0.0.1:0", "--log", "warn", "--max-queued-jobs", "1000000", "--max-queued-mb", "1000000"]);
        command.arg("--data-dir").arg(&directory).args(flags);
        if let Place::Postgres(url) = place {
            command.args(["--database-url", url]);
        }
        let mut child = command.stdout(Stdio::piped()).spawn().unwrap();
        let mut line = String::new();
        BufReader::new(child.stdout.take().unwrap()).read_line(&mut line).unwrap();
        let address = line.trim().rsplit_once("http://").unwrap_or_else(|| panic!("the service does not start: {line}")).1.parse().unwrap();
        Self { child, directory, address }
    }

    fn status(&self, key: &str) -> f64 {
        let status = fs::read_to_string(format!("/proc/{}/status", self.child.id())).unwrap();
        let line = status.lines().find_map(|line| line.strip_prefix(key)).unwrap_or_else(|| panic!("no {key}"));
        line.trim_matches([':', ' ', '\t']).trim_end_matches(" kB").parse::<f64>().unwrap() * 1024.0 / 1e6
    }

    /// Memory that is resident, in MB.
    pub(crate) fn resident_mb(&self) -> f64 {
        self.status("VmRSS")
    }

    /// The most that ever was, in MB.
    pub(crate) fn peak_mb(&self) -> f64 {
        self.status("VmHWM")
    }

    /// Processor time of all its threads so far, in s.
    pub(crate) fn processor_s(&self) -> f64 {
        let stat = fs::read_to_string(format!("/proc/{}/stat", self.child.id())).unwrap();
        let fields: Vec<&str> = stat.rsplit_once(')').unwrap().1.split_whitespace().collect();
        // proc(5): user and system time, fields 14 and 15, in ticks of which Linux tells 100 a second.
        (fields[11].parse::<f64>().unwrap() + fields[12].parse::<f64>().unwrap()) / 100.0
    }
}

impl Drop for Service {
    fn drop(&mut self) {
        drop(self.child.kill());
        drop(self.child.wait());
        drop(fs::remove_dir_all(&self.directory));
    }
}

/// A PostgreSQL server whose commits are synchronised to disk; it lives as long as this.
pub(crate) struct Cluster {
    directory: PathBuf,
    pub(crate) url: String,
}

impl Cluster {
    fn script(action: &str, directory: &Path) -> Command {
        let mut command = Command::new(Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/tools/postgres.sh"));
        command.arg(action).arg(directory);
        command
    }

    /// `None` where PostgreSQL is not installed.
    pub(crate) fn start() -> Option<Self> {
        let directory = env::temp_dir().join(format!("ventricle-bench-{}", uuid::Uuid::now_v7()));
        let output = Self::script("durable", &directory).stderr(Stdio::inherit()).output().unwrap();
        if output.status.code() == Some(3) {
            return None;
        }
        assert!(output.status.success(), "PostgreSQL does not start: {}", output.status);
        Some(Self { directory, url: String::from_utf8(output.stdout).unwrap().trim().to_owned() })
    }
}

impl Drop for Cluster {
    fn drop(&mut self) {
        drop(Self::script("stop", &self.directory).status());
    }
}
