//! What would change nothing, and is refused: whoever sends it expects something to happen. A preset's own values pass, so that the parameters
//! of a report can be sent again as they are.

use super::{Complaint, ParameterError, check::dotted};
use crate::pipeline::parameters::{Parameters, Preset};
use serde_json::Value;

/// The parameters, by the beginning of their pointers, that only one preset reads. All others are of both.
const OF_ONE_PRESET: [(&str, Preset); 7] = [
    ("/pose", Preset::Clinical),
    ("/refine", Preset::Clinical),
    ("/edges", Preset::Paper),
    ("/gvf", Preset::Paper),
    ("/mesh/seed", Preset::Paper),
    ("/mesh/seed_scale", Preset::Paper),
    ("/deform", Preset::Paper),
];

/// The presets that read a parameter, the default one first.
pub(super) fn presets(pointer: &str) -> Vec<&'static str> {
    match only(pointer) {
        Some(preset) => vec![preset.name()],
        None => [Preset::Clinical, Preset::Paper].map(Preset::name).to_vec(),
    }
}

/// The one preset that reads a parameter, if only one does.
fn only(pointer: &str) -> Option<Preset> {
    let under = |part: &str| pointer.strip_prefix(part).is_some_and(|rest| rest.is_empty() || rest.starts_with('/'));
    OF_ONE_PRESET.iter().find(|(part, _)| under(part)).map(|(_, preset)| *preset)
}

/// Refuses what another preset would read and departs from what this one, whose values are `used`, has. `written` is the request.
pub(super) fn refuse_of_other_preset(written: &Value, used: &Parameters) -> Result<(), ParameterError> {
    let beside = |pointer: &str| {
        let other = only(pointer).filter(|preset| *preset != used.preset)?;
        Some((format!("the preset `{}`", used.preset.name()), format!("the preset `{}`", other.name())))
    };
    refuse(written, used, &beside)
}

/// Refuses what the model of the camera would read where it is switched off.
pub(super) fn refuse_without_model(written: &Value, used: &Parameters) -> Result<(), ParameterError> {
    let beside = |pointer: &str| {
        let idle = pointer.starts_with("/refine/") && pointer != "/refine/enabled";
        idle.then(|| ("`refine.enabled` false".to_owned(), "`refine.enabled` true".to_owned()))
    };
    refuse(written, used, &beside)
}

/// Beside what a parameter changes nothing, and what to choose for it to change something; `None` where it does already.
type Beside<'a> = dyn Fn(&str) -> Option<(String, String)> + 'a;

fn refuse(written: &Value, used: &Parameters, beside: &Beside<'_>) -> Result<(), ParameterError> {
    let used = serde_json::to_value(used).unwrap_or_default();
    let mut complaints = Vec::new();
    compare(written, &used, "", beside, &mut complaints);
    if complaints.is_empty() { Ok(()) } else { Err(ParameterError { complaints }) }
}

fn compare(written: &Value, used: &Value, pointer: &str, beside: &Beside<'_>, complaints: &mut Vec<Complaint>) {
    match written {
        Value::Null => {}
        Value::Object(fields) => {
            for (field, value) in fields {
                compare(value, &used[field], &format!("{pointer}/{field}"), beside, complaints);
            }
        }
        value if value == used => {}
        _ => {
            if let Some((this, other)) = beside(pointer) {
                let detail = format!("{} changes nothing with {this}; leave it out or choose {other}.", dotted(pointer));
                complaints.push(Complaint { code: "invalid_parameter", pointer: pointer.to_owned(), detail });
            }
        }
    }
}

/// Refuses what departs from the preset and changes nothing beside what was chosen: `fields` of `part`, each with whether it does.
pub(super) fn refuse_idle(fields: &[(&str, bool)], part: &str, beside: &str) -> Result<(), ParameterError> {
    match fields.iter().find(|(_, idle)| *idle) {
        None => Ok(()),
        Some((field, _)) => Err(ParameterError::one(
            "invalid_parameter",
            &format!("/{part}/{field}"),
            format!("`{part}.{field}` changes nothing with {beside}; leave it out or choose another."),
        )),
    }
}
