//! `ventricle accuracy`: how far the presets are from the truth.

use anyhow::{Context as _, ensure};
use std::{io::Write as _, num::NonZeroUsize, thread};
use ventricle::accuracy::{
    self,
    family::{self, Group, Member},
    line,
    score::{Method, Run},
    tables,
};

/// Arguments of `ventricle accuracy`.
#[derive(clap::Args)]
pub(crate) struct Args {
    /// The methods to run: paper, gradient, clinical, psf-given [default: all].
    #[arg(long, value_name = "NAMES", value_delimiter = ',')]
    methods: Vec<String>,

    /// Only families whose name contains this.
    #[arg(long, value_name = "NAME")]
    family: Option<String>,

    /// Only every n-th study of those.
    #[arg(long, value_name = "N", default_value = "1")]
    every: NonZeroUsize,

    /// Studies at a time [default: one a processor].
    #[arg(long)]
    threads: Option<NonZeroUsize>,

    /// Prints a line a study as it ends.
    #[arg(long)]
    verbose: bool,
}

/// Runs the studies and prints what came of them.
pub(crate) fn run(args: Args) -> anyhow::Result<()> {
    let methods = methods(&args.methods)?;
    let members: Vec<Member> = family::members()
        .into_iter()
        .filter(|member| args.family.as_ref().is_none_or(|name| member.family.contains(name.as_str())))
        .step_by(args.every.get())
        .collect();
    ensure!(!members.is_empty(), "no family's name contains “{}”", args.family.unwrap_or_default());
    let threads = args.threads.map_or_else(|| thread::available_parallelism().map_or(1, NonZeroUsize::get), NonZeroUsize::get);
    let each = |run: &Run| {
        if args.verbose {
            // A closed pipe ends nothing here; the tables below will say so.
            let _ = writeln!(std::io::stdout().lock(), "{}", line::of(run));
        }
    };
    let runs = accuracy::run(&members, &methods, threads, each)?;
    let mut out = std::io::stdout().lock();
    for &method in &methods {
        writeln!(out, "\n## {}\n\n{}", method.name(), tables::families(&runs, method))?;
        writeln!(out, "{}", tables::coverage(&runs, method))?;
    }
    if runs.iter().any(|run| run.group == Group::Negative) {
        writeln!(out, "## Negative controls\n\n{}", tables::negatives(&runs))?;
    }
    let seconds = |method| runs.iter().filter(|run| run.method == method).map(|run| run.seconds).sum::<f64>();
    for &method in &methods {
        writeln!(out, "{}: {:.2} s a study", method.name(), seconds(method) / members.len() as f64)?;
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
