//! `ventricle reconstruct`: a file in, a report out, without a service.

use super::table::table;
use anyhow::Context as _;
use rayon::ThreadPoolBuilder;
use serde_json::Value;
use std::{
    fs,
    io::{IsTerminal as _, Write as _},
    num::NonZeroUsize,
    path::PathBuf,
};
use ventricle::{
    analysis::analyse,
    codecs::Decoder,
    config,
    export::{glb, vtu},
    intake::{self, Limits, Options, Part},
    jobs::Progress,
    parameters,
    pipeline::{
        self,
        monitor::{Monitor, Stage},
    },
    report::{self, Report, Timing},
};

/// Arguments of `ventricle reconstruct`.
#[derive(clap::Args)]
pub(crate) struct Args {
    /// The study: one DICOM, NIfTI, NPY or JSON file, or several DICOM files of one study.
    #[arg(required = true, value_name = "FILE")]
    files: Vec<PathBuf>,

    /// The named set of parameters to start from.
    #[arg(long, value_name = "NAME")]
    preset: Option<String>,

    /// Parameters as JSON, or @FILE that holds them. They win over those of a JSON study.
    #[arg(long, value_name = "JSON|@FILE")]
    parameters: Option<String>,

    /// One parameter by its path; may be repeated and wins over the rest: `--set region.radius_mm=60 --set region.centre_mm=[90,88]`.
    #[arg(long = "set", value_name = "PATH=VALUE")]
    settings: Vec<String>,

    /// Distance between voxel centres along slices, rows and columns in mm; needed for NPY, which cannot say it.
    #[arg(long, value_name = "Z,Y,X", value_parser = spacing)]
    spacing_mm: Option<[f64; 3]>,

    /// Where to write the report.
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,

    /// Where to write the animated surfaces.
    #[arg(long, value_name = "FILE")]
    glb: Option<PathBuf>,

    /// Where to write the wall of every gate as tetrahedra: a directory that gets `wall-1.vtu`, `wall-2.vtu` and so on.
    #[arg(long, value_name = "DIR")]
    wall: Option<PathBuf>,

    /// Threads to use [default: one a processor].
    #[arg(long)]
    threads: Option<NonZeroUsize>,

    /// Prints the report as JSON instead of a table.
    #[arg(long)]
    json: bool,
}

/// Reads, reconstructs and reports.
#[expect(clippy::needless_pass_by_value, reason = "every subcommand takes its arguments")]
pub(crate) fn run(args: Args) -> anyhow::Result<()> {
    let received = read(&args)?;
    let requested = parameters::parse(&requested(&args, received.parameters)?)?;
    anyhow::ensure!(
        requested.callback_url.is_none(),
        "`callback_url` is for jobs of the service; this command ends when it has its result."
    );
    let chosen = parameters::resolve(requested)?;
    let study = received.study;
    let pool = ThreadPoolBuilder::new().num_threads(args.threads.map_or(0, NonZeroUsize::get)).build()?;
    let watch = Watch::new();
    let reconstruction = pool.install(|| pipeline::reconstruct(&study, &chosen, &watch));
    let timing = watch.finish();
    let reconstruction = reconstruction?;
    let analysis = analyse(&study, &reconstruction);
    let report = report::build("local", &study, &reconstruction, &analysis, &timing);
    if let Some(path) = &args.output {
        fs::write(path, pretty(&report)?).with_context(|| format!("{} could not be written", path.display()))?;
    }
    if let Some(path) = &args.glb {
        fs::write(path, glb::cycle(&study, &reconstruction, &analysis)?)
            .with_context(|| format!("{} could not be written", path.display()))?;
    }
    if let Some(folder) = &args.wall {
        fs::create_dir_all(folder).with_context(|| format!("{} could not be made", folder.display()))?;
        for gate in 0..reconstruction.gates.len() {
            let path = folder.join(format!("wall-{}.vtu", gate + 1));
            fs::write(&path, vtu::wall(&study, &reconstruction, gate)?)
                .with_context(|| format!("{} could not be written", path.display()))?;
        }
    }
    let shown = if args.json { pretty(&report)? } else { table(&report, None) };
    std::io::stdout().write_all(shown.as_bytes())?;
    Ok(())
}

fn pretty(report: &Report) -> serde_json::Result<String> {
    serde_json::to_string_pretty(report).map(|text| text + "\n")
}

fn read(args: &Args) -> anyhow::Result<intake::Received> {
    let contents = args
        .files
        .iter()
        .map(|path| fs::read(path).with_context(|| format!("{} could not be read", path.display())))
        .collect::<anyhow::Result<Vec<_>>>()?;
    let names: Vec<_> = args.files.iter().map(|path| path.file_name().map(|name| name.to_string_lossy().into_owned())).collect();
    let parts: Vec<Part<'_>> =
        contents.iter().zip(&names).map(|(bytes, name)| Part { media_type: None, filename: name.as_deref(), bytes }).collect();
    let limits = Limits { decoder: config::own_program().ok().map(|program| Decoder { program }), ..Limits::default() };
    Ok(intake::read(&parts, &Options { spacing_mm: args.spacing_mm, ..Options::default() }, &limits)?)
}

/// Three positive numbers with commas between them.
fn spacing(text: &str) -> Result<[f64; 3], String> {
    let numbers: Option<Vec<f64>> = text.split(',').map(|number| number.trim().parse().ok().filter(|mm| *mm > 0.0)).collect();
    numbers.and_then(|numbers| numbers.try_into().ok()).ok_or_else(|| "three positive numbers are needed, as 5.74,2.87,2.87".to_owned())
}

/// What is asked for, the most particular last: the JSON study's own parameters, `--parameters`, `--preset`, `--set`.
fn requested(args: &Args, of_study: Option<Value>) -> anyhow::Result<Value> {
    let mut all = of_study.unwrap_or_else(|| Value::Object(serde_json::Map::new()));
    if let Some(given) = &args.parameters {
        let text = match given.strip_prefix('@') {
            Some(path) => fs::read_to_string(path).with_context(|| format!("{path} could not be read"))?,
            None => given.clone(),
        };
        parameters::merge(&mut all, serde_json::from_str(&text).context("--parameters is not JSON")?);
    }
    let preset = args.preset.iter().map(|name| ("preset".to_owned(), name.clone()));
    let settings = args.settings.iter().map(|setting| {
        let (path, value) = setting.split_once('=').with_context(|| format!("--set {setting} is not PATH=VALUE"))?;
        Ok((path.to_owned(), value.to_owned()))
    });
    let pairs = preset.map(Ok).chain(settings).collect::<anyhow::Result<Vec<_>>>()?;
    parameters::merge(&mut all, parameters::from_query(&pairs)?);
    Ok(all)
}

/// Measures the stages and shows on a terminal how far it is.
struct Watch {
    progress: Progress,
    shows: bool,
}

impl Watch {
    fn new() -> Self {
        Self { progress: Progress::begin_now(), shows: std::io::stderr().is_terminal() }
    }

    fn finish(&self) -> Timing {
        if self.shows {
            let _ = write!(std::io::stderr(), "\r\x1b[2K");
        }
        Timing { total_ms: self.progress.elapsed_ms(), stages_ms: self.progress.stages_ms() }
    }
}

impl Monitor for Watch {
    fn begin(&self, stage: Stage, gate: Option<usize>) {
        self.progress.begin(stage, gate);
    }

    fn end(&self, stage: Stage, gate: Option<usize>) {
        self.progress.end(stage, gate);
    }

    fn advance(&self, done: usize, total: usize) {
        if self.shows {
            let _ = write!(std::io::stderr(), "\r\x1b[2K  {} %", 100 * done / total.max(1));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn args(line: &[&str]) -> Args {
        #[derive(clap::Parser)]
        struct Line {
            #[command(flatten)]
            args: Args,
        }
        <Line as clap::Parser>::try_parse_from(["reconstruct", "study.dcm"].iter().chain(line)).unwrap().args
    }

    #[test]
    fn the_most_particular_parameter_wins() {
        let of_study = json!({"mesh": {"level": 2}, "edges": {"sigma": 1.0}, "gvf": {"mu": 1.0}});
        let args =
            args(&["--parameters", r#"{"mesh": {"level": 3}, "edges": {"sigma": 2.0}}"#, "--set", "mesh.level=4", "--preset", "paper"]);
        let all = requested(&args, Some(of_study)).unwrap();
        assert_eq!(all, json!({"preset": "paper", "mesh": {"level": 4}, "edges": {"sigma": 2.0}, "gvf": {"mu": 1.0}}));
    }

    #[test]
    fn marks_are_set_one_by_one() {
        let all = requested(&args(&["--set", "region.centre_mm=[90,88.5]", "--set", "region.radius_mm=60"]), None).unwrap();
        assert_eq!(all, json!({"region": {"centre_mm": [90, 88.5], "radius_mm": 60}}));
        assert!(requested(&args(&["--set", "region"]), None).is_err());
        assert!(requested(&args(&["--parameters", "{"]), None).is_err());
    }

    #[test]
    fn spacing_is_three_positive_numbers() {
        assert_eq!(spacing("5.74, 2.87,2.87"), Ok([5.74, 2.87, 2.87]));
        for wrong in ["1,2", "1,2,3,4", "1,-2,3", "1,nan,3", "a,b,c", ""] {
            assert!(spacing(wrong).is_err(), "{wrong}");
        }
    }
}
