//! `ventricle accuracy`: how far the presets are from the truth.

use anyhow::{Context as _, ensure};
use serde::Deserialize;
use std::{
    collections::BTreeMap,
    fs,
    io::Write as _,
    num::NonZeroUsize,
    path::{Path, PathBuf},
    thread,
};
use ventricle::{
    accuracy::{
        self, ablation, bland_altman, criteria,
        family::{self, Group, Member},
        line, pictures, published, real, regional,
        score::{Method, Run},
        spoiled, tables,
    },
    drawing::markdown,
    intake::{self, Limits, Options, Part},
    pipeline::Reconstruction,
};

/// Arguments of `ventricle accuracy`.
#[expect(clippy::struct_excessive_bools, reason = "each is a flag that a person types")]
#[derive(clap::Args)]
pub(crate) struct Args {
    /// The methods to run: paper, gradient, clinical, psf-given [default: all].
    #[arg(long, value_name = "NAMES", value_delimiter = ',')]
    methods: Vec<String>,

    /// Only families of phantoms whose name contains this.
    #[arg(long, value_name = "NAME")]
    family: Option<String>,

    /// Only every n-th study of those; 0: none.
    #[arg(long, value_name = "N", default_value_t = 1)]
    every: usize,

    /// Runs a part of them again without each ingredient of the clinical preset.
    #[arg(long)]
    ablation: bool,

    /// Runs the hearts whose parts beat, thicken or take up differently, and no other phantoms.
    #[arg(long, conflicts_with_all = ["methods", "ablation", "plots"])]
    regional: bool,

    /// Runs studies that are spoiled in a known way, and good ones beside them, to see which flags they carry, and no other phantoms.
    #[arg(long, conflicts_with_all = ["methods", "ablation", "plots", "regional"])]
    spoiled: bool,

    /// With `--spoiled`: runs the half of the studies that the flags' limits were set by instead of the published one.
    #[arg(long, requires = "spoiled", conflicts_with = "write")]
    setting: bool,

    /// A folder of labelled studies: `labels.json` and NIfTI files.
    #[arg(long, value_name = "DIR")]
    real: Option<PathBuf>,

    /// Where to write a picture of every labelled study with both surfaces drawn, as PNG. They show a patient: keep them to yourself.
    #[arg(long, value_name = "DIR", requires = "real")]
    pictures: Option<PathBuf>,

    /// A document whose tables, between marks such as `<!-- clinical -->` and `<!-- end -->`, are replaced.
    #[arg(long, value_name = "FILE", conflicts_with_all = ["family", "every", "methods"])]
    write: Option<PathBuf>,

    /// Where to write the Bland-Altman plots of the clinical preset, as SVG.
    #[arg(long, value_name = "DIR")]
    plots: Option<PathBuf>,

    /// Studies at a time [default: one a processor].
    #[arg(long)]
    threads: Option<NonZeroUsize>,

    /// Prints a line a study as it ends.
    #[arg(long)]
    verbose: bool,
}

/// Where tables go: to the terminal, and into the document's places.
struct Output<'a>(Option<&'a Path>);

impl Output<'_> {
    fn put(&self, name: &str, text: &str) -> anyhow::Result<()> {
        writeln!(std::io::stdout().lock(), "## {name}\n\n{}\n", text.trim())?;
        let Some(path) = self.0 else { return Ok(()) };
        let document = fs::read_to_string(path).with_context(|| format!("{} could not be read", path.display()))?;
        let document = markdown::replace(&document, name, text)
            .with_context(|| format!("{} has no place for {name} (<!-- {name} --> … <!-- end -->)", path.display()))?;
        fs::write(path, document).with_context(|| format!("{} could not be written", path.display()))
    }
}

/// Runs the studies, prints what came of them and writes what was asked for.
#[expect(clippy::needless_pass_by_value, reason = "every subcommand takes its arguments")]
pub(crate) fn run(args: Args) -> anyhow::Result<()> {
    let methods = methods(&args.methods)?;
    // Asked before minutes are spent.
    if let Some(path) = &args.write {
        fs::OpenOptions::new().write(true).open(path).with_context(|| format!("{} cannot be written", path.display()))?;
    }
    for folder in [&args.plots, &args.pictures].into_iter().flatten() {
        fs::create_dir_all(folder).with_context(|| format!("{} could not be made", folder.display()))?;
    }
    let labelled = args.real.as_deref().map(labelled).transpose()?;
    let threads = args.threads.map_or_else(|| thread::available_parallelism().map_or(1, NonZeroUsize::get), NonZeroUsize::get);
    let output = Output(args.write.as_deref());
    if args.regional {
        parts_of_hearts(&args, &output, threads)?;
    }
    if args.spoiled {
        spoiled_studies(&args, &output, threads)?;
    }
    let members = members(&args)?;
    if !members.is_empty() {
        phantoms(&args, &output, &members, &methods, threads)?;
    }
    if let Some(studies) = labelled {
        real_studies(&args, &output, &studies, &methods, threads)?;
    }
    Ok(())
}

fn members(args: &Args) -> anyhow::Result<Vec<Member>> {
    if args.every == 0 || args.regional || args.spoiled {
        return Ok(Vec::new());
    }
    let chosen =
        family::members().into_iter().filter(|member| args.family.as_ref().is_none_or(|name| member.family.contains(name.as_str())));
    let members: Vec<Member> = chosen.step_by(args.every).collect();
    ensure!(!members.is_empty(), "no family's name contains “{}”", args.family.as_deref().unwrap_or_default());
    Ok(members)
}

fn phantoms(args: &Args, output: &Output<'_>, members: &[Member], methods: &[Method], threads: usize) -> anyhow::Result<()> {
    let each = |run: &Run| {
        if args.verbose {
            // A closed pipe ends nothing here; the tables below will say so.
            let _ = writeln!(std::io::stdout().lock(), "{}", line::of(run));
        }
    };
    let runs = accuracy::run(members, methods, threads, each)?;
    output.put("families", &tables::definitions())?;
    output.put("criteria", &criteria::markdown(&criteria::judged(&runs)))?;
    for &method in methods {
        output.put(method.name(), &tables::families(&runs, method))?;
    }
    output.put("agreement", &tables::agreement(&runs))?;
    output.put("found by itself", &tables::found_by_itself(&runs))?;
    output.put("coverage", &tables::coverage(&runs, Method::Clinical))?;
    if runs.iter().any(|run| run.group == Group::Negative) {
        output.put("negatives", &tables::negatives(&runs))?;
    }
    output.put("published", &published::markdown(&runs))?;
    output.put("seconds", &tables::seconds(&runs))?;
    if let Some(folder) = &args.plots {
        for quantity in &bland_altman::QUANTITIES {
            let path = folder.join(format!("{}.svg", quantity.file));
            let svg = bland_altman::draw(&runs, Method::Clinical, quantity);
            fs::write(&path, svg).with_context(|| format!("{} could not be written", path.display()))?;
        }
    }
    if args.ablation {
        output.put("ablation", &ablation::markdown(&runs, &ablation::run(threads)?))?;
    }
    Ok(())
}

fn parts_of_hearts(args: &Args, output: &Output<'_>, threads: usize) -> anyhow::Result<()> {
    let each = |run: &regional::score::Run| {
        if args.verbose {
            let _ = writeln!(std::io::stdout().lock(), "{}", regional::score::line(run));
        }
    };
    let chosen = regional::family::hearts()
        .into_iter()
        .filter(|heart| args.family.as_ref().is_none_or(|name| heart.kind.name().contains(name.as_str())));
    let hearts: Vec<_> = chosen.step_by(args.every.max(1)).collect();
    let runs = regional::run(&hearts, threads, each)?;
    output.put("regional hearts", &regional::tables::definitions())?;
    output.put("regional criteria", &criteria::markdown(&regional::criteria::judged(&runs)))?;
    output.put("regional segments", &regional::tables::segments(&runs))?;
    output.put("regional phases", &regional::tables::phases(&runs))?;
    output.put("regional late", &regional::tables::late(&runs))?;
    output.put("regional rates", &regional::tables::rates(&runs))?;
    output.put("regional shapes", &regional::tables::shapes(&runs))?;
    output.put("regional defects", &regional::tables::defects(&runs))?;
    output.put("regional pairs", &regional::tables::pairs(&runs))
}

fn spoiled_studies(args: &Args, output: &Output<'_>, threads: usize) -> anyhow::Result<()> {
    let each = |run: &spoiled::score::Run| {
        if args.verbose {
            let _ = writeln!(std::io::stdout().lock(), "{}", spoiled::tables::line(run));
        }
    };
    let half = if args.setting { spoiled::family::Half::Setting } else { spoiled::family::Half::Published };
    let chosen = spoiled::family::studies(half)
        .into_iter()
        .filter(|study| args.family.as_ref().is_none_or(|name| study.kind.name().contains(name.as_str())));
    let studies: Vec<_> = chosen.step_by(args.every.max(1)).collect();
    let runs = spoiled::run(&studies, threads, each)?;
    output.put("spoiled kinds", &spoiled::tables::definitions())?;
    output.put("spoiled criteria", &criteria::markdown(&spoiled::tables::judged(&runs)))?;
    output.put("spoiled flags by kind", &spoiled::tables::kinds(&runs))?;
    output.put("spoiled flags", &spoiled::tables::by_flag(&runs))
}

fn real_studies(args: &Args, output: &Output<'_>, studies: &[real::Labelled], methods: &[Method], threads: usize) -> anyhow::Result<()> {
    // A real study's width is not known: there is nothing to be told.
    let methods: Vec<Method> = methods.iter().copied().filter(|&method| method != Method::PsfGiven).collect();
    let picture = |labelled: &real::Labelled, found: &Reconstruction| {
        let Some(folder) = &args.pictures else { return };
        let path = folder.join(format!("{}.png", labelled.name));
        let written = pictures::sheet(&labelled.study, found)
            .png()
            .map_err(anyhow::Error::from)
            .and_then(|png| fs::write(&path, png).map_err(anyhow::Error::from));
        if let Err(error) = written {
            let _ = writeln!(std::io::stderr(), "{} could not be written: {error}", path.display());
        }
    };
    let runs = real::run(studies, &methods, threads, picture)?;
    output.put("real", &real::summaries(&runs, &methods))?;
    if methods.contains(&Method::Clinical) {
        output.put("real studies", &real::studies(&runs, Method::Clinical))?;
    }
    Ok(())
}

fn methods(names: &[String]) -> anyhow::Result<Vec<Method>> {
    if names.is_empty() {
        return Ok(Method::ALL.to_vec());
    }
    let of_name = |name: &String| {
        let known = Method::ALL.into_iter().find(|method| method.name() == name.trim());
        known.with_context(|| format!("“{name}” is no method; there are {}", Method::ALL.map(Method::name).join(", ")))
    };
    names.iter().map(of_name).collect()
}

/// A study's entry in `labels.json`; what else it says is not read.
#[derive(Deserialize)]
struct Label {
    endocardial_ml: Vec<f64>,
    epicardial_ml: Vec<f64>,
}

/// The labelled studies of a folder, by name.
fn labelled(folder: &Path) -> anyhow::Result<Vec<real::Labelled>> {
    let read = |path: &Path| fs::read(path).with_context(|| format!("{} could not be read", path.display()));
    let labels = folder.join("labels.json");
    let entries: BTreeMap<String, Label> =
        serde_json::from_slice(&read(&labels)?).with_context(|| format!("{} is not what was expected", labels.display()))?;
    let study = |(name, label): (String, Label)| {
        let path = folder.join(format!("{name}.nii.gz"));
        let bytes = read(&path)?;
        let part = Part { media_type: None, filename: None, bytes: &bytes };
        let received = intake::read(&[part], &Options::default(), &Limits::default())
            .with_context(|| format!("{} could not be read as a study", path.display()))?;
        Ok(real::Labelled { name, study: received.study, cavity_ml: label.endocardial_ml, whole_ml: label.epicardial_ml })
    };
    entries.into_iter().map(study).collect()
}
