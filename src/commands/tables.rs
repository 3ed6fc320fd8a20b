//! `ventricle tables`: the paper's tables and figures, redone.

use anyhow::{Context as _, ensure};
use std::{fs, io::Write as _, path::PathBuf};
use ventricle::{
    drawing::markdown,
    paper::{self, figures},
};

/// Arguments of `ventricle tables`.
#[derive(clap::Args)]
pub(crate) struct Args {
    /// The tables to run, by number [default: all, and the distances behind figure 5].
    #[arg(long, value_name = "1,4", value_delimiter = ',')]
    only: Vec<usize>,

    /// Where to write the figures, as SVG.
    #[arg(long, value_name = "DIR")]
    figures: Option<PathBuf>,

    /// A document whose tables, between `<!-- table 1 -->` and `<!-- end -->`, and distances (`<!-- figure 5 -->`) are replaced.
    #[arg(long, value_name = "FILE")]
    write: Option<PathBuf>,
}

/// Runs the tables one after the other, so that seconds are comparable, prints each, and writes what was asked for.
#[expect(clippy::needless_pass_by_value, reason = "every subcommand takes its arguments")]
pub(crate) fn run(args: Args) -> anyhow::Result<()> {
    for number in &args.only {
        ensure!(paper::TABLES.contains(number), "the paper has tables 1 to 6, not {number}");
    }
    // Asked before minutes are spent.
    if let Some(path) = &args.write {
        fs::OpenOptions::new().write(true).open(path).with_context(|| format!("{} cannot be written", path.display()))?;
    }
    if let Some(folder) = &args.figures {
        fs::create_dir_all(folder).with_context(|| format!("{} could not be made", folder.display()))?;
    }
    let mut out = std::io::stdout().lock();
    let mut put = |heading: &str, name: &str, text: &str| -> anyhow::Result<()> {
        writeln!(out, "## {heading}\n\n{text}")?;
        let Some(path) = &args.write else { return Ok(()) };
        let document = fs::read_to_string(path).with_context(|| format!("{} could not be read", path.display()))?;
        let document = markdown::replace(&document, name, text)
            .with_context(|| format!("{} has no place for {name} (<!-- {name} --> … <!-- end -->)", path.display()))?;
        fs::write(path, document).with_context(|| format!("{} could not be written", path.display()))
    };
    for number in paper::TABLES.filter(|number| args.only.is_empty() || args.only.contains(number)) {
        let text = paper::table(number).with_context(|| format!("table {number} could not be made"))?;
        put(&format!("Table {number}"), &format!("table {number}"), &text)?;
    }
    if args.only.is_empty() {
        let text = paper::distances().context("the distances behind figure 5 could not be made")?;
        put("Distances behind figure 5", "figure 5", &text)?;
    }
    if let Some(folder) = &args.figures {
        for number in figures::FIGURES {
            if let Some(figure) = figures::figure(number).with_context(|| format!("figure {number} could not be made"))? {
                let path = folder.join(figure.file);
                fs::write(&path, &figure.svg).with_context(|| format!("{} could not be written", path.display()))?;
                writeln!(out, "Figure {number}: {}", path.display())?;
            }
        }
    }
    Ok(())
}
