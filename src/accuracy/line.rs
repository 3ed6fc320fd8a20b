//! A run as a line of text, for those who look for what went wrong.

use super::score::{Outcome, Run, Score};
use crate::pipeline::Surface;

/// Values with their errors in brackets, distances, what the model says of itself, and the warnings.
pub fn of(run: &Run) -> String {
    let head = format!("{:<22} {:<9}", run.name, run.method.name());
    let body = match &run.outcome {
        Outcome::Failed { code, why } => format!("{code}: {why}"),
        Outcome::Found(score) => parts(score).join("  "),
    };
    format!("{head} {body}  {:.2} s", run.seconds)
}

fn parts(score: &Score) -> Vec<String> {
    let found = &score.found;
    let wall = |surface| score.distance.as_ref().map_or(f64::NAN, |distance| distance.get(surface).wall_mm);
    let mut parts = vec![
        format!("EF {:5.1} ({:+5.1})", found.ef_percent, score.ef_points()),
        format!("EDV {:6.1} ({:+6.1}%)", found.edv_ml, score.edv_percent()),
        format!("ESV {:6.1} ({:+6.1}%)", found.esv_ml, score.esv_percent()),
        format!("mass {:6.1} ({:+6.1}%)", found.mass_g, score.mass_percent()),
        format!("mm {:.2}/{:.2}", score.distance_mm(Surface::Endocardial), score.distance_mm(Surface::Epicardial)),
        format!("wall {:.2}/{:.2}", wall(Surface::Endocardial), wall(Surface::Epicardial)),
        format!("spread {:.1}%", found.wall_spread_percent),
    ];
    if let Some(pose) = &score.pose {
        parts.push(format!("axis {:.1}° apex {:.1} base {:+.1} mm", pose.axis_degrees, pose.apex_mm, pose.base_mm));
    }
    if let Some(model) = &score.model {
        let bound = if model.psf_at_bound { "!" } else { "" };
        parts.push(format!("psf {:+.2}{bound} residual {:.2}", model.psf_error_mm, model.residual_over_noise));
        if let Some([edv, esv, ef, mass]) = model.over_standard_error {
            parts.push(format!("z EDV {edv:+.1} ESV {esv:+.1} EF {ef:+.1} mass {mass:+.1}"));
        }
    }
    if !score.warnings.is_empty() {
        parts.push(format!("[{}]", score.warnings.join(" ")));
    }
    parts
}
