//! The parent: starts a child for the frames of one study, waits for each answer, ends what takes too long.

use super::{Codec, Layout, SUBCOMMAND, protocol};
use std::{
    ffi::OsString,
    io::{self, Read as _},
    path::PathBuf,
    process::{Child, ChildStdin, ChildStdout, Command, ExitStatus, Stdio},
    sync::{
        Arc, Mutex, PoisonError,
        atomic::{AtomicBool, Ordering},
        mpsc::{self, RecvTimeoutError, Sender},
    },
    thread::{self, JoinHandle},
    time::Duration,
};

/// Processor time of a child beside that for each voxel, in s.
const LEAST_SECONDS: u64 = 2;
/// Voxels that have another second. The slowest decoder (JPEG 2000) needs some 0.3 s for so much noise, and half of that for images.
const VOXELS_A_SECOND: usize = 2 << 20;

/// Why a frame was not decoded.
#[derive(Debug, thiserror::Error)]
pub enum DecodeError {
    /// No child could be started, or it was ended from outside: nothing is said about the frame.
    #[error("the decoder of compressed images did not run ({0})")]
    Unavailable(String),
    /// The decoder refused the frame.
    #[error("{0}")]
    Frame(String),
    /// The child ended, or was ended.
    #[error("{0}")]
    Ended(String),
}

/// Where compressed frames can be decoded: the program whose subcommand [`SUBCOMMAND`] runs [`serve`](super::serve).
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Decoder {
    /// The program.
    pub program: PathBuf,
}

/// Processor time of the child for all frames of a study of so many voxels, in s. It has twice that by the clock.
pub fn child_seconds(voxels: usize) -> u64 {
    LEAST_SECONDS + (voxels / VOXELS_A_SECOND) as u64
}

impl Decoder {
    /// A session for a study of so many voxels. No child is started before the first frame.
    pub fn session(&self, voxels: usize) -> Session {
        let seconds = child_seconds(voxels);
        let command = [self.program.clone().into_os_string(), SUBCOMMAND.into(), "--seconds".into(), seconds.to_string().into()];
        Session { command: command.into(), seconds, process: None }
    }
}

/// Decodes the frames of one study, in one child, which ends with it.
#[derive(Debug)]
pub struct Session {
    /// Program and arguments.
    command: Vec<OsString>,
    seconds: u64,
    process: Option<Process>,
}

impl Session {
    /// Decodes a frame whose header was checked, to [`Layout::frame_bytes`] bytes: samples row by row, little-endian.
    ///
    /// # Errors
    /// [`DecodeError`]; after [`DecodeError::Ended`] the next frame has a new child.
    pub fn decode(&mut self, codec: Codec, layout: Layout, frame: &[u8]) -> Result<Vec<u8>, DecodeError> {
        let mut process = match self.process.take() {
            Some(process) => process,
            None => Process::start(&self.command, self.seconds)?,
        };
        match process.exchange(codec, layout, frame) {
            Ok(answer) => {
                self.process = Some(process);
                answer.map_err(DecodeError::Frame)
            }
            Err(error) => {
                let end = process.end();
                let reason = end.reason(&error, self.seconds);
                // One that answers wrongly is ended here, by a signal as well.
                let lied = error.kind() == io::ErrorKind::InvalidData;
                Err(if !lied && end.was_from_outside() { DecodeError::Unavailable(reason) } else { DecodeError::Ended(reason) })
            }
        }
    }
}

/// A running child and the thread that ends it when its time is over.
#[derive(Debug)]
struct Process {
    child: Arc<Mutex<Child>>,
    input: ChildStdin,
    output: ChildStdout,
    over_time: Arc<AtomicBool>,
    /// Dropped to let the thread go before the time is over.
    done: Option<Sender<()>>,
    watch: Option<JoinHandle<()>>,
}

/// How a child ended.
struct End {
    over_time: bool,
    status: Option<ExitStatus>,
}

impl Process {
    fn start(command: &[OsString], seconds: u64) -> Result<Self, DecodeError> {
        let unavailable = |error: io::Error| DecodeError::Unavailable(error.to_string());
        let (program, arguments) = command.split_first().ok_or_else(|| unavailable(io::ErrorKind::NotFound.into()))?;
        let mut child = Command::new(program)
            .args(arguments)
            .env_clear()
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .map_err(unavailable)?;
        let (Some(input), Some(output)) = (child.stdin.take(), child.stdout.take()) else {
            return Err(DecodeError::Unavailable("it has no pipes".to_owned()));
        };
        let child = Arc::new(Mutex::new(child));
        let over_time = Arc::new(AtomicBool::new(false));
        let (done, waits) = mpsc::channel::<()>();
        let mut process =
            Self { child: Arc::clone(&child), input, output, over_time: Arc::clone(&over_time), done: Some(done), watch: None };
        let watch = move || {
            if waits.recv_timeout(Duration::from_secs(2 * seconds)) == Err(RecvTimeoutError::Timeout) {
                over_time.store(true, Ordering::Relaxed);
                let _ = child.lock().unwrap_or_else(PoisonError::into_inner).kill();
            }
        };
        process.watch = Some(thread::Builder::new().name("decoder's time".to_owned()).spawn(watch).map_err(unavailable)?);
        let mut ready = [0; protocol::READY.len()];
        match process.output.read_exact(&mut ready) {
            Ok(()) if ready == protocol::READY => Ok(process),
            Ok(()) => Err(DecodeError::Unavailable("the program is another".to_owned())),
            Err(_) => Err(DecodeError::Unavailable(process.end().reason(&io::ErrorKind::UnexpectedEof.into(), seconds))),
        }
    }

    fn exchange(&mut self, codec: Codec, layout: Layout, frame: &[u8]) -> io::Result<Result<Vec<u8>, String>> {
        protocol::write_request(&mut self.input, codec, layout, frame)?;
        protocol::read_answer(&mut self.output, layout.frame_bytes())
    }

    /// Ends the child if it has not ended, and says how it did.
    fn end(&mut self) -> End {
        self.done = None;
        // What already died keeps its own status.
        let mut child = self.child.lock().unwrap_or_else(PoisonError::into_inner);
        let _ = child.kill();
        let status = child.wait().ok();
        drop(child);
        if let Some(watch) = self.watch.take() {
            let _ = watch.join();
        }
        End { over_time: self.over_time.load(Ordering::Relaxed), status }
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        self.end();
    }
}

impl End {
    fn reason(&self, error: &io::Error, seconds: u64) -> String {
        if self.over_time || self.signal() == Some(SIGXCPU) {
            return format!("its decoding takes longer than {seconds} s");
        }
        if error.kind() == io::ErrorKind::InvalidData {
            return "its decoder gave another number of samples".to_owned();
        }
        match self.status {
            Some(status) => format!("its decoder ended ({status})"),
            None => "its decoder ended".to_owned(),
        }
    }

    /// Whether somebody ended the child who does not know the frame: whoever stops the service, or the system out of memory.
    fn was_from_outside(&self) -> bool {
        !self.over_time && self.signal().is_some_and(|signal| OUTSIDE_SIGNALS.contains(&signal))
    }

    #[cfg(unix)]
    fn signal(&self) -> Option<i32> {
        use std::os::unix::process::ExitStatusExt as _;
        self.status.and_then(|status| status.signal())
    }

    #[cfg(not(unix))]
    fn signal(&self) -> Option<i32> {
        None
    }
}

/// The signal at the limit of processor time: 24 on Linux and the BSDs.
const SIGXCPU: i32 = 24;
/// SIGHUP, SIGINT, SIGKILL, SIGTERM: what a child that fails by itself does not get.
const OUTSIDE_SIGNALS: [i32; 4] = [1, 2, 9, 15];

#[cfg(test)]
#[cfg(unix)]
mod tests {
    use super::*;
    use std::time::Instant;

    const LAYOUT: Layout = Layout { rows: 16, columns: 16, bits_allocated: 16, bits_stored: 16 };

    /// What comes of a child that says it is ready and then does this.
    fn outcome(does: &str) -> DecodeError {
        let script = format!("printf 'ventricle frames 1'; {does}");
        let command = ["/bin/sh".into(), "-c".into(), script.into()];
        let mut session = Session { command: command.into(), seconds: 2, process: None };
        session.decode(Codec::JpegLs, LAYOUT, &[0; 100]).unwrap_err()
    }

    #[test]
    fn a_child_that_dies_or_lies_is_one_refused_frame() {
        let killed = outcome("kill -ABRT $$");
        assert!(matches!(&killed, DecodeError::Ended(reason) if reason.contains("signal: 6")), "{killed}");
        let lies = outcome("head -c 111 >/dev/null; printf '\\000\\004\\000\\000\\000abcd'; sleep 60");
        assert!(matches!(&lies, DecodeError::Ended(reason) if reason.contains("number of samples")), "{lies}");
        let refused = outcome("head -c 111 >/dev/null; printf '\\001\\003\\000\\000\\000bad'; sleep 60");
        assert!(matches!(&refused, DecodeError::Frame(reason) if reason == "bad"), "{refused}");
    }

    #[test]
    fn a_child_that_is_stopped_says_nothing_about_the_frame() {
        for signal in ["TERM", "KILL"] {
            let stopped = outcome(&format!("kill -{signal} $$; sleep 60"));
            assert!(matches!(&stopped, DecodeError::Unavailable(reason) if reason.contains("signal")), "{signal}: {stopped}");
        }
        // INT is not tried on a child: a shell tells what it runs in the background to ignore it.
        let by = |signal: i32| End { over_time: false, status: Some(std::os::unix::process::ExitStatusExt::from_raw(signal)) };
        assert!(by(2).was_from_outside() && !by(11).was_from_outside());
    }

    #[test]
    fn a_child_that_hangs_is_ended() {
        let start = Instant::now();
        let hangs = outcome("exec sleep 60");
        assert!(matches!(&hangs, DecodeError::Ended(reason) if reason.contains("longer than 2 s")), "{hangs}");
        assert!(start.elapsed() < Duration::from_secs(15), "{:?}", start.elapsed());
    }

    #[test]
    fn a_program_that_is_no_decoder_is_said_so() {
        for program in ["/bin/true", "/bin/does-not-exist"] {
            let error = Decoder { program: program.into() }.session(0).decode(Codec::Jpeg, LAYOUT, &[]).unwrap_err();
            assert!(matches!(error, DecodeError::Unavailable(_)), "{program}: {error}");
        }
    }

    #[test]
    fn larger_studies_have_more_time() {
        assert_eq!(child_seconds(64 * 64 * 24 * 8), 2);
        assert_eq!(child_seconds(16 << 20), 10);
    }
}
