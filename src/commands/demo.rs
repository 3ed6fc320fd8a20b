//! `ventricle demo`: what a newcomer sees first. Starts the service as anyone would, posts a study through HTTP, follows the job, shows
//! what came out and where to look. Nothing here is a shortcut: only the public interface is used.

mod client;
mod progress;
mod service;

use super::table::table;
use anyhow::{Context as _, bail};
use client::{Client, Job};
use progress::Progress;
use service::{Service, Signals};
use std::{fs, net::SocketAddr, path::PathBuf};
use ventricle::{
    phantom::{self, Phantom, Truth},
    report::Report,
};

/// Arguments of `ventricle demo`.
#[derive(clap::Args)]
pub(crate) struct Args {
    /// A study to post instead of a simulated one: DICOM, NIfTI or JSON.
    #[arg(long)]
    file: Option<PathBuf>,

    /// A service that already runs, instead of one of the demo's own, as <http://127.0.0.1:8080>.
    #[arg(long, conflicts_with = "listen")]
    url: Option<String>,

    /// Stops the service and exits after the table.
    #[arg(long)]
    once: bool,

    /// The format the simulated study is posted in.
    #[arg(long, value_enum, default_value = "dicom", conflicts_with = "file")]
    format: Format,

    /// Address of the demo's own service [default: 127.0.0.1:8080, or a free port when that is taken].
    #[arg(long)]
    listen: Option<SocketAddr>,

    /// Where the demo's own service keeps its data and its log.
    #[arg(long, default_value = "./data/demo")]
    data_dir: PathBuf,

    /// Where the results are saved.
    #[arg(long, default_value = "./out/demo")]
    output: PathBuf,
}

/// A format the simulated study can be written in.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Format {
    /// Nuclear medicine image storage.
    Dicom,
    /// NIfTI-1.
    Nifti,
}

/// What is posted.
struct Posted {
    what: String,
    media_type: &'static str,
    bytes: Vec<u8>,
    truth: Option<Truth>,
}

/// Runs the demo.
#[expect(clippy::needless_pass_by_value, reason = "every subcommand takes its arguments")]
pub(crate) fn run(args: Args) -> anyhow::Result<()> {
    let posted = match &args.file {
        Some(path) => Posted::file(path)?,
        None => Posted::phantom(args.format)?,
    };
    let signals = Signals::listen()?;
    let service = match &args.url {
        Some(_) => None,
        None => Some(Service::start(args.listen, &args.data_dir, &signals)?),
    };
    let base = args.url.clone().or(service.as_ref().map(Service::url)).unwrap_or_default();
    let client = Client::new(&base);
    if let Some(service) = &service {
        say(&format!("The service listens on {base} (its log: {}).", service.log().display()))?;
    }
    say(&format!("Posting {}, {} KiB, as {}.", posted.what, posted.bytes.len().div_ceil(1024), posted.media_type))?;
    let job = client.submit(posted.media_type, &posted.bytes)?;
    let job = follow(&client, job, &signals)?;
    show(&client, &job, &posted, &args)?;
    match service {
        Some(service) if args.once => service.stop(),
        Some(service) => {
            say("\nThe service keeps running; Ctrl-C stops it.")?;
            service.run_until(&signals)
        }
        None => Ok(()),
    }
}

impl Posted {
    fn phantom(format: Format) -> anyhow::Result<Self> {
        let simulation = phantom::simulate(&Phantom::demo())?;
        let (media_type, bytes) = match format {
            Format::Dicom => ("application/dicom", phantom::dicom::write(&simulation.study)?),
            Format::Nifti => ("application/x-nifti", phantom::nifti::write(&simulation.study)),
        };
        let what = format!("a simulated beating ventricle of {} gates", simulation.study.gates.len());
        Ok(Self { what, media_type, bytes, truth: Some(simulation.truth) })
    }

    fn file(path: &PathBuf) -> anyhow::Result<Self> {
        let bytes = fs::read(path).with_context(|| format!("{} could not be read", path.display()))?;
        let name = path.file_name().map(|name| name.to_string_lossy().to_lowercase()).unwrap_or_default();
        let extension = name.rsplit('.').next().unwrap_or_default();
        let media_type = match extension {
            "nii" => "application/x-nifti",
            "gz" => "application/gzip",
            "json" => "application/json",
            _ => "application/dicom",
        };
        Ok(Self { what: path.display().to_string(), media_type, bytes, truth: None })
    }
}

/// Waits for the end of a job, showing how far it is.
fn follow(client: &Client, mut job: Job, signals: &Signals) -> anyhow::Result<Job> {
    let mut progress = Progress::new();
    while !job.is_final() {
        progress.show(&job);
        let next = client.wait(&job);
        if signals.received() {
            bail!("interrupted; the job {} is kept and goes on when the service is started again", job.id);
        }
        job = next?;
    }
    progress.end(&job);
    match (job.state.as_str(), &job.error) {
        ("succeeded", _) => Ok(job),
        (_, Some(error)) => bail!("the job {}: {}", job.state, error.sentence()),
        (state, None) => bail!("the job {state}"),
    }
}

/// Fetches the results, prints the table and says where everything is.
fn show(client: &Client, job: &Job, posted: &Posted, args: &Args) -> anyhow::Result<()> {
    let report_path = format!("/v1/reconstructions/{}/report", job.id);
    let surfaces_path = format!("/v1/reconstructions/{}/surfaces.glb", job.id);
    let report_bytes = client.get(&report_path)?;
    let report: Report = serde_json::from_slice(&report_bytes).context("the report is not what this version understands")?;
    let surfaces = client.get(&surfaces_path)?;
    fs::create_dir_all(&args.output).with_context(|| format!("{} could not be made", args.output.display()))?;
    let saved = [("report.json", &report_bytes), ("surfaces.glb", &surfaces)].map(|(name, bytes)| (args.output.join(name), bytes));
    for (path, bytes) in &saved {
        fs::write(path, bytes).with_context(|| format!("{} could not be written", path.display()))?;
    }
    say(&format!("\n{}", table(&report, posted.truth.as_ref())))?;
    say(&format!("  computed in {:.1} s\n", report.timing_ms.total / 1000.0))?;
    let kept = args.url.is_some() || !args.once;
    if kept {
        for (what, path) in [
            ("viewer", format!("/studies/{}", job.id)),
            ("job", format!("/v1/reconstructions/{}", job.id)),
            ("report", report_path),
            ("surfaces", surfaces_path),
            ("HTTP interface", "/docs".to_owned()),
        ] {
            say(&format!("  {what:<15}{}", client.url(&path)))?;
        }
    }
    say(&format!("  {:<15}{} (any glTF viewer shows it beating)", "saved", saved[1].0.display()))?;
    say(&format!("  {:<15}{}", "", saved[0].0.display()))
}

/// A line on standard output.
fn say(line: &str) -> anyhow::Result<()> {
    use std::io::Write as _;
    writeln!(std::io::stdout(), "{line}").context("standard output is closed")
}
