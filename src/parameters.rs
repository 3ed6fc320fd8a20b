//! Parameters as a client writes them: every field optional, unknown ones refused by name, each with its default and range in the
//! schema. The OpenAPI schema of [`Request`] is also what a request is checked against, so that contract and check cannot differ.

mod check;
mod describe;
mod idle;
mod query;
mod request;
mod resolve;

pub use describe::{Description, describe};
pub use query::{from_query, merge};
pub use request::{
    Analysis, Bend, Deform, EdgeMode, EdgeOperator, Edges, Gvf, Mesh, Metadata, Model, Pose, Preset, Refine, Region, Request, Seed, Shear,
    Solver, SpringDirection, Stretch,
};
pub use resolve::resolve;

use serde::Serialize;
use serde_json::Value;
use utoipa::ToSchema;

/// Shortest `retention_seconds`: whoever waits for a job is told to look every 30 s, and must find its end there.
pub const SHORTEST_RETENTION_S: u64 = 60;

/// One thing wrong with the parameters.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, ToSchema)]
pub struct Complaint {
    /// Stable code: `unknown_parameter`, `invalid_parameter` or `unavailable_parameter`.
    #[schema(value_type = String)]
    pub code: &'static str,
    /// JSON pointer to the field.
    #[schema(example = "/edges/sigma")]
    pub pointer: String,
    /// What was received and what is allowed.
    #[schema(example = "`edges.sigma` is 99; allowed is 0.3 to 8.")]
    pub detail: String,
}

/// Most complaints about one request: more than there are parameters (a test counts them), so that only nonsense has more.
const MOST_COMPLAINTS: usize = 64;

/// Why parameters were refused: everything that is wrong with them (the first `MOST_COMPLAINTS` of it), never empty.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{}", sentence(.complaints))]
pub struct ParameterError {
    /// What is wrong, in the order of the request.
    pub complaints: Vec<Complaint>,
}

impl ParameterError {
    /// The stable code of the first complaint.
    pub fn code(&self) -> &'static str {
        self.complaints.first().map_or("invalid_parameter", |complaint| complaint.code)
    }

    /// One thing that is wrong.
    pub fn one(code: &'static str, pointer: &str, detail: impl Into<String>) -> Self {
        Self { complaints: vec![Complaint { code, pointer: pointer.to_owned(), detail: detail.into() }] }
    }
}

fn sentence(complaints: &[Complaint]) -> String {
    complaints.iter().map(|complaint| complaint.detail.as_str()).collect::<Vec<_>>().join(" ")
}

/// Reads parameters from JSON: refuses unknown fields and values out of range, all at once and by name. `null` counts as left out. What only a
/// job has is refused too.
pub fn parse(value: &Value) -> Result<Request, ParameterError> {
    parse_by(value, &check::schema(None))
}

/// Reads the parameters of a job that may be kept for so long, in s.
pub fn parse_for_job(value: &Value, longest_retention_s: u64) -> Result<Request, ParameterError> {
    parse_by(value, &check::schema(Some(longest_retention_s)))
}

fn parse_by(value: &Value, schema: &Value) -> Result<Request, ParameterError> {
    let mut complaints = Vec::new();
    check::check(value, schema, "", &mut complaints);
    if !complaints.is_empty() {
        complaints.truncate(MOST_COMPLAINTS);
        return Err(ParameterError { complaints });
    }
    serde_json::from_value(value.clone()).map_err(|error| ParameterError::one("invalid_parameter", "", format!("{error}.")))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pipeline::parameters as chosen;
    use serde_json::json;

    fn refused(value: &Value) -> Vec<(&'static str, String)> {
        let error = parse(value).and_then(resolve).unwrap_err();
        error.complaints.into_iter().map(|complaint| (complaint.code, complaint.pointer)).collect()
    }

    #[test]
    fn nothing_given_is_the_clinical_preset() {
        assert_eq!(resolve(Request::default()).unwrap(), chosen::Parameters::clinical());
        assert_eq!(parse(&json!({"preset": null, "refine": {}})).and_then(resolve).unwrap(), chosen::Parameters::clinical());
        assert_eq!(
            parse(&json!({"preset": "paper", "region": null, "edges": {"sigma": null}})).and_then(resolve).unwrap(),
            chosen::Parameters::paper()
        );
    }

    #[test]
    fn documented_defaults_are_the_values_used() {
        let described = describe(None);
        assert!((18..MOST_COMPLAINTS).contains(&described.len()), "{described:#?}");
        for (name, preset) in [("clinical", chosen::Parameters::clinical()), ("paper", chosen::Parameters::paper())] {
            let used = serde_json::to_value(preset).unwrap();
            for field in described
                .iter()
                .filter(|field| field.presets.contains(&name) && !["/preset", "/callback_url"].contains(&field.pointer.as_str()))
            {
                assert!(!field.description.is_empty(), "{} has no description", field.pointer);
                let value = used.pointer(&field.pointer).unwrap_or_else(|| panic!("{} is not a pipeline parameter", field.pointer));
                match &field.default {
                    None => assert!(value.is_null(), "{} has a default that is not documented", field.pointer),
                    Some(default) if default.is_number() => assert_eq!(default.as_f64(), value.as_f64(), "{}", field.pointer),
                    Some(default) => assert_eq!(default, value, "{}", field.pointer),
                }
            }
        }
        let default = described.iter().find(|field| field.pointer == "/preset").and_then(|field| field.default.clone());
        assert_eq!(default, Some(json!("clinical")));
    }

    #[test]
    fn each_parameter_names_the_presets_it_is_of() {
        let of = |pointer: &str| describe(None).into_iter().find(|field| field.pointer == pointer).unwrap().presets;
        assert_eq!(of("/mesh/level"), ["clinical", "paper"]);
        assert_eq!(of("/region/centre_mm"), ["clinical", "paper"]);
        assert_eq!(of("/pose/apex_mm"), ["clinical"]);
        assert_eq!(of("/refine/psf_fwhm_mm"), ["clinical"]);
        for pointer in ["/edges/sigma", "/gvf/mu", "/mesh/seed", "/mesh/seed_scale", "/deform/stretch/k"] {
            assert_eq!(of(pointer), ["paper"], "{pointer}");
        }
    }

    #[test]
    fn every_value_reaches_the_pipeline() {
        let sent = json!({
            "preset": "paper",
            "region": {"centre_mm": [90.0, 95.5], "radius_mm": 60.0, "first_slice": 3, "last_slice": 20},
            "pose": {"apex_mm": null, "base_mm": null},
            "edges": {"operator": "canny", "sigma": 1.5, "low": 0.2, "high": 0.7, "mode": "volume", "threshold": 0.5, "close_ends": false},
            "gvf": {"mu": 5.0, "tolerance": 1e-5},
            "mesh": {"level": 4, "seed": "common_ellipsoid", "seed_scale": 1.5},
            "deform": {
                "model": "plane", "solver": "midpoint", "time_step_s": 0.05, "mass": 2.0, "damping_percent": 2.0,
                "stretch": {"k": 3.0, "kd": 0.3}, "shear": {"k": 4.0, "kd": 0.4}, "bend": {"k": 5.0, "kd": 0.5},
                "spring_direction": "along_field", "smoothing": false, "freezing": false, "subvoxel": false, "rest_voxels": 0.1,
                "max_steps": 100, "record_distances": true,
            },
            "refine": serde_json::to_value(chosen::RefineParameters::default()).unwrap(),
            "analysis": {"anterior": [0.0, -1.0, 0.5], "perfusion_threshold_percent": 50.0},
            "metadata": {"height_m": 1.72, "weight_kg": 81.5},
        });
        assert_eq!(serde_json::to_value(parse(&sent).and_then(resolve).unwrap()).unwrap(), sent);
        let mut clinical = serde_json::to_value(chosen::Parameters::clinical()).unwrap();
        merge(
            &mut clinical,
            json!({
                "region": sent["region"].clone(), "pose": {"apex_mm": [90.0, 80.0, 20.0], "base_mm": [91.0, 82.0, 100.5]}, "mesh": {"level": 2},
                "refine": {"psf_fwhm_mm": 12.5, "base_tilt": false, "wall_conservation": false, "temporal_prior": false, "shape_prior": false,
                           "uptake_map": false},
            }),
        );
        assert_eq!(serde_json::to_value(parse(&clinical).and_then(resolve).unwrap()).unwrap(), clinical);
        let off = json!({"refine": {"enabled": false}});
        assert!(!parse(&off).and_then(resolve).unwrap().refine.enabled);
    }

    #[test]
    fn what_belongs_to_the_other_preset_is_refused_by_name() {
        for (sent, pointer) in [
            (json!({"edges": {"sigma": 1.0}}), "/edges/sigma"),
            (json!({"edges": {"operator": "gradient"}}), "/edges/operator"),
            (json!({"gvf": {"mu": 5}}), "/gvf/mu"),
            (json!({"mesh": {"seed": "previous_gate"}}), "/mesh/seed"),
            (json!({"mesh": {"seed_scale": 1.5}}), "/mesh/seed_scale"),
            (json!({"deform": {"model": "plane"}}), "/deform/model"),
            (json!({"deform": {"stretch": {"k": 20}}}), "/deform/stretch/k"),
            (json!({"deform": {"record_distances": true}}), "/deform/record_distances"),
            (json!({"preset": "paper", "pose": {"apex_mm": [1, 2, 3]}}), "/pose/apex_mm"),
            (json!({"preset": "paper", "pose": {"base_mm": [1, 2, 3]}}), "/pose/base_mm"),
            (json!({"preset": "paper", "refine": {"enabled": false}}), "/refine/enabled"),
            (json!({"preset": "paper", "refine": {"psf_fwhm_mm": 12}}), "/refine/psf_fwhm_mm"),
            (json!({"preset": "paper", "refine": {"uptake_map": false}}), "/refine/uptake_map"),
            (json!({"refine": {"enabled": false, "psf_fwhm_mm": 12}}), "/refine/psf_fwhm_mm"),
            (json!({"refine": {"enabled": false, "base_tilt": false}}), "/refine/base_tilt"),
            (json!({"refine": {"enabled": false, "wall_conservation": false}}), "/refine/wall_conservation"),
            (json!({"refine": {"enabled": false, "temporal_prior": false}}), "/refine/temporal_prior"),
            (json!({"refine": {"enabled": false, "shape_prior": false}}), "/refine/shape_prior"),
            (json!({"refine": {"enabled": false, "uptake_map": false}}), "/refine/uptake_map"),
        ] {
            assert_eq!(refused(&sent), [("invalid_parameter", pointer.to_owned())], "{sent}");
        }
        let error = parse(&json!({"edges": {"sigma": 1, "low": 0.1}})).and_then(resolve).unwrap_err();
        assert_eq!(
            error.complaints[1].detail,
            "`edges.sigma` changes nothing with the preset `clinical`; leave it out or choose the preset `paper`."
        );
        assert_eq!(error.complaints.len(), 2, "all at once");
    }

    #[test]
    fn the_parameters_of_a_report_can_be_sent_again() {
        let mut given = chosen::Parameters::clinical();
        given.refine.psf_fwhm_mm = Some(11.0);
        given.pose.apex_mm = Some([1.0, 2.0, 3.0]);
        let mut off = chosen::Parameters::clinical();
        off.refine.enabled = false;
        for parameters in [chosen::Parameters::clinical(), chosen::Parameters::paper(), given, off] {
            let sent = serde_json::to_value(&parameters).unwrap();
            assert_eq!(parse(&sent).and_then(resolve).unwrap(), parameters);
        }
    }

    /// As the version before wrote them: without `pose` and `refine`.
    #[test]
    fn parameters_of_the_version_before_are_still_read() {
        let mut before = serde_json::to_value(chosen::Parameters::paper()).unwrap();
        for later in ["pose", "refine"] {
            before.as_object_mut().unwrap().remove(later);
        }
        assert_eq!(serde_json::from_value::<chosen::Parameters>(before.clone()).unwrap(), chosen::Parameters::paper());
        assert_eq!(parse(&before).and_then(resolve).unwrap(), chosen::Parameters::paper());
    }

    #[test]
    fn wrong_fields_are_all_named_at_once() {
        let sent = json!({"edges": {"sigma": 99, "colour": 1}, "mesh": {"level": 3.5}, "gvf": 7, "regoin": {}, "region": {"centre_mm": [1, 2, 3]}});
        let mut got = refused(&sent);
        got.sort();
        assert_eq!(
            got,
            [
                ("invalid_parameter", "/edges/sigma"),
                ("invalid_parameter", "/gvf"),
                ("invalid_parameter", "/mesh/level"),
                ("invalid_parameter", "/region/centre_mm"),
                ("unknown_parameter", "/edges/colour"),
                ("unknown_parameter", "/regoin"),
            ]
            .map(|(code, pointer)| (code, pointer.to_owned()))
        );
    }

    #[test]
    fn a_refusal_names_field_value_and_range() {
        assert_eq!(parse(&json!({"edges": {"sigma": 99}})).unwrap_err().to_string(), "`edges.sigma` is 99; allowed is 0.3 to 8.");
        assert_eq!(parse(&json!({"mesh": {"level": "fine"}})).unwrap_err().to_string(), "`mesh.level` is \"fine\"; an integer is needed.");
    }

    #[test]
    fn fields_belonging_together_are_compared() {
        assert_eq!(refused(&json!({"preset": "paper", "edges": {"low": 0.9}})), [("invalid_parameter", "/edges/low".to_owned())]);
        assert_eq!(
            refused(&json!({"region": {"first_slice": 9, "last_slice": 3}})),
            [("invalid_parameter", "/region/first_slice".to_owned())]
        );
    }

    #[test]
    fn what_does_not_go_together_is_refused_by_name() {
        for (deform, pointer) in [
            (json!({"model": "restricted_spring_mass", "solver": "implicit_euler"}), "/deform/solver"),
            (json!({"stretch": {"k": 20}}), "/deform/stretch"),
            (json!({"model": "spring_mass", "bend": {"kd": 2}}), "/deform/bend"),
            (json!({"model": "restricted_spring_mass", "shear": {"k": 2}}), "/deform/shear"),
            (json!({"model": "plane", "spring_direction": "across_field"}), "/deform/spring_direction"),
        ] {
            assert_eq!(
                refused(&json!({"preset": "paper", "deform": deform.clone()})),
                [("invalid_parameter", pointer.to_owned())],
                "{deform}"
            );
        }
        for (edges, pointer) in [
            (json!({"threshold": 0.4}), "/edges/threshold"),
            (json!({"operator": "gradient", "sigma": 1.0}), "/edges/sigma"),
            (json!({"operator": "gradient", "low": 0.1}), "/edges/low"),
        ] {
            assert_eq!(
                refused(&json!({"preset": "paper", "edges": edges.clone()})),
                [("invalid_parameter", pointer.to_owned())],
                "{edges}"
            );
        }
    }

    #[test]
    fn every_model_goes_with_every_solver_but_one() {
        for model in ["free", "spring_mass", "restricted_spring_mass", "plane"] {
            for solver in ["euler", "midpoint", "rk4", "implicit_euler"] {
                let sent = json!({"preset": "paper", "deform": {"model": model, "solver": solver}});
                let refused = parse(&sent).and_then(resolve).is_err();
                assert_eq!(refused, (model, solver) == ("restricted_spring_mass", "implicit_euler"), "{sent}");
            }
        }
    }

    #[test]
    fn the_plane_model_brings_its_solver_and_time_step() {
        let deform = parse(&json!({"preset": "paper", "deform": {"model": "plane"}})).and_then(resolve).unwrap().deform;
        assert_eq!((deform.solver, deform.time_step_s), (chosen::Solver::ImplicitEuler, 0.05));
        let given = json!({"preset": "paper", "deform": {"model": "plane", "solver": "rk4", "time_step_s": 0.01}});
        let given = parse(&given).and_then(resolve).unwrap().deform;
        assert_eq!((given.solver, given.time_step_s), (chosen::Solver::Rk4, 0.01));
    }

    #[test]
    fn the_body_is_given_in_metres_and_kilograms() {
        let given = |metadata: Value| resolve(parse(&json!({"metadata": metadata})).unwrap()).unwrap().metadata;
        assert_eq!(given(json!({"height_m": 1.72, "weight_kg": 80})), chosen::Metadata { height_m: Some(1.72), weight_kg: Some(80.0) });
        assert_eq!(given(json!({})), chosen::Metadata::default());
        for wrong in [json!({"height_m": 172}), json!({"height_m": 0}), json!({"weight_kg": -70}), json!({"weight_kg": "70 kg"})] {
            assert_eq!(refused(&json!({"metadata": wrong.clone()}))[0].0, "invalid_parameter", "{wrong}");
        }
        assert_eq!(refused(&json!({"metadata": {"name": "X"}}))[0].0, "unknown_parameter");
    }

    #[test]
    fn a_job_is_kept_as_long_as_is_asked_within_the_cap_and_the_numbers_know_nothing_of_it() {
        let parsed = |sent: Value| parse_for_job(&sent, 7200);
        let request = parsed(json!({"mesh": {"level": 2}, "retention_seconds": 7200})).unwrap();
        assert_eq!(request.retention_seconds, Some(7200));
        assert_eq!(resolve(request).unwrap(), resolve(parsed(json!({"mesh": {"level": 2}})).unwrap()).unwrap());
        assert_eq!(parsed(json!({"retention_seconds": null})).unwrap().retention_seconds, None);
        assert_eq!(parsed(json!({"retention_seconds": SHORTEST_RETENTION_S})).unwrap().retention_seconds, Some(60));
        for wrong in [json!(7201), json!(59), json!(0), json!(-1), json!(u64::MAX), json!(1.5), json!("long"), json!(1e300)] {
            let error = parsed(json!({"retention_seconds": wrong.clone()})).unwrap_err();
            let complaint = &error.complaints[0];
            assert_eq!((complaint.code, complaint.pointer.as_str()), ("invalid_parameter", "/retention_seconds"), "{wrong}");
        }
        let error = parsed(json!({"retention_seconds": 7201})).unwrap_err();
        assert_eq!(error.to_string(), "`retention_seconds` is 7201; allowed is 60 to 7200.");
        let described = describe(Some(7200)).into_iter().find(|field| field.pointer == "/retention_seconds").unwrap();
        assert_eq!((described.minimum, described.maximum, described.default), (Some(60.0), Some(7200.0), None));
    }

    #[test]
    fn where_no_job_is_kept_nothing_can_be_said_of_its_keeping() {
        assert_eq!(refused(&json!({"retention_seconds": 60})), [("unavailable_parameter", "/retention_seconds".to_owned())]);
        assert!(!describe(None).iter().any(|field| field.pointer == "/retention_seconds"));
    }

    #[test]
    fn whether_the_input_is_kept_is_of_the_job_and_not_of_the_numbers() {
        let request = parse_for_job(&json!({"keep_input": true}), 7200).unwrap();
        assert_eq!(request.keep_input, Some(true));
        assert_eq!(resolve(request).unwrap(), chosen::Parameters::clinical());
        assert_eq!(parse_for_job(&json!({"keep_input": null}), 7200).unwrap().keep_input, None);
        assert_eq!(parse_for_job(&json!({"keep_input": 1}), 7200).unwrap_err().code(), "invalid_parameter");
        assert_eq!(refused(&json!({"keep_input": true})), [("unavailable_parameter", "/keep_input".to_owned())]);
        assert!(!describe(None).iter().any(|field| field.pointer == "/keep_input"));
    }

    #[test]
    fn a_list_in_a_query_needs_no_brackets() {
        let read = |text: &str| from_query(&[("region.centre_mm".to_owned(), text.to_owned())]).unwrap()["region"]["centre_mm"].clone();
        assert_eq!(read("30,31.5"), json!([30, 31.5]));
        assert_eq!(read("[30,31.5]"), json!([30, 31.5]));
        assert_eq!(read("30,x"), json!("30,x"));
    }

    #[test]
    fn complaints_end_somewhere() {
        let many: serde_json::Map<_, _> = (0..1000).map(|i| (i.to_string(), 1.into())).collect();
        assert_eq!(parse(&many.into()).unwrap_err().complaints.len(), MOST_COMPLAINTS);
    }

    #[test]
    fn a_query_nests_by_dots() {
        let pairs = [("preset", "paper"), ("mesh.level", "4"), ("edges.sigma", "1.5"), ("edges.mode", "volume")];
        let pairs = pairs.map(|(key, value)| (key.to_owned(), value.to_owned()));
        let mut base = json!({"edges": {"sigma": 2.0, "low": 0.1}});
        merge(&mut base, from_query(&pairs).unwrap());
        assert_eq!(base, json!({"preset": "paper", "mesh": {"level": 4}, "edges": {"sigma": 1.5, "low": 0.1, "mode": "volume"}}));
        let twice = [("mesh.level".to_owned(), "4".to_owned()), ("mesh.level".to_owned(), "3".to_owned())];
        assert_eq!(from_query(&twice).unwrap_err().code(), "invalid_parameter");
    }
}
