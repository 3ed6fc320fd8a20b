//! The paper's tables and figures, redone on simulated hearts whose volumes are known, beside what the paper prints.
//!
//! Each table is a file with a `measure` that runs what the table is about and a `markdown` that writes it with the printed numbers
//! ([`printed`]) next to it. Seconds are of the machine that ran it; everything else is the same wherever it runs.

pub mod cycle;
pub mod experiment;
pub mod figures;
pub mod initial_meshes;
pub mod markdown;
pub mod missing;
pub mod models;
pub mod oscillation;
pub mod printed;
pub mod reconstructions;
pub mod threshold;
pub mod volumes;

use crate::{phantom::PhantomError, pipeline::PipelineError};

/// Why a table or figure could not be made.
#[derive(Debug, thiserror::Error)]
pub enum PaperError {
    /// The simulated heart is impossible.
    #[error(transparent)]
    Phantom(#[from] PhantomError),
    /// The reconstruction failed where it must not.
    #[error(transparent)]
    Pipeline(#[from] PipelineError),
    /// A picture could not be encoded.
    #[error("a picture could not be encoded as PNG: {0}")]
    Png(#[from] png::EncodingError),
    /// There is no such table.
    #[error("the paper has tables 1 to 6, not {0}")]
    NoSuchTable(usize),
}

/// The numbers of the paper's tables.
pub const TABLES: std::ops::RangeInclusive<usize> = 1..=6;

/// A table of the paper by its number, measured now, as Markdown.
///
/// Errors: what cannot be simulated, reconstructed or is no table.
pub fn table(number: usize) -> Result<String, PaperError> {
    Ok(match number {
        1 => models::markdown(&models::measure(&models::Steps::PRINTED)?),
        2 => initial_meshes::markdown(&initial_meshes::measure()?),
        3 => reconstructions::markdown(&reconstructions::measure()?),
        4 => volumes::markdown(&volumes::measure()?),
        5 => cycle::markdown(&cycle::measure()?),
        6 => missing::markdown(&missing::measure()?),
        other => return Err(PaperError::NoSuchTable(other)),
    })
}

/// The distances behind figure 5, measured now, as Markdown.
///
/// Errors: what cannot be simulated or reconstructed.
pub fn distances() -> Result<String, PaperError> {
    Ok(oscillation::markdown(&oscillation::measure()?))
}

/// Replaces what stands between `<!-- name -->` and `<!-- end -->` in a document (`table 1` to `table 6`, `figure 5`); `None` if it has no
/// such place.
pub fn replace(document: &str, name: &str, text: &str) -> Option<String> {
    let (begin, end) = (format!("<!-- {name} -->"), "<!-- end -->");
    let from = document.find(&begin)? + begin.len();
    let to = from + document[from..].find(end)?;
    // A second beginning before the end would belong to another place.
    (!document[from..to].contains("<!-- ")).then(|| format!("{}\n\n{}\n\n{}", &document[..from], text.trim(), &document[to..]))
}

/// What stands between the marks of a place in a document.
pub fn written<'a>(document: &'a str, name: &str) -> Option<&'a str> {
    let begin = format!("<!-- {name} -->");
    let from = document.find(&begin)? + begin.len();
    let to = from + document[from..].find("<!-- end -->")?;
    Some(document[from..to].trim())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_the_part_between_the_marks_is_replaced() {
        let document = "a\n<!-- table 1 -->\nold\n<!-- end -->\nb\n<!-- table 2 -->\nkept\n<!-- end -->\n";
        let new = replace(document, "table 1", "new\n").unwrap();
        assert_eq!(new, "a\n<!-- table 1 -->\n\nnew\n\n<!-- end -->\nb\n<!-- table 2 -->\nkept\n<!-- end -->\n");
        assert_eq!(replace(&new, "table 1", "new").as_deref(), Some(new.as_str()));
        assert_eq!(written(&new, "table 1"), Some("new"));
        assert_eq!(written(&new, "table 2"), Some("kept"));
        assert_eq!(replace(document, "table 3", "new"), None);
        assert_eq!(replace("<!-- table 1 --> <!-- table 2 --> <!-- end -->", "table 1", "new"), None);
    }
}
