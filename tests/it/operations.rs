//! What `docs/operations.md` lists is what the program has: every setting and every metric, no more and no less.

use clap::{Arg, Args as _, Command};
use std::{
    collections::{BTreeMap, BTreeSet},
    fs,
    path::Path,
};
use ventricle::config::ServeSettings;

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// The rows of the table below a heading of `docs/operations.md`, without its head.
fn table(heading: &str) -> Vec<String> {
    let text = fs::read_to_string(root().join("docs/operations.md")).unwrap();
    let section = text.split(&format!("\n{heading}\n")).nth(1).unwrap_or_else(|| panic!("docs/operations.md has no heading {heading:?}"));
    let section = section.split("\n## ").next().unwrap();
    section.lines().skip_while(|line| !line.starts_with('|')).take_while(|line| line.starts_with('|')).skip(2).map(str::to_owned).collect()
}

/// A setting as the table has it: flag, variable, default, meaning.
fn row(setting: &Arg) -> String {
    let flag = format!("`--{}`", setting.get_long().unwrap());
    let variable = setting.get_env().unwrap().to_str().unwrap();
    let defaults: Vec<_> = setting.get_default_values().iter().map(|value| format!("`{}`", value.to_str().unwrap())).collect();
    let help = setting.get_long_help().or(setting.get_help()).unwrap().to_string();
    let meaning = help.split_whitespace().collect::<Vec<_>>().join(" ");
    // A default that depends on the machine stands in the text, as clap shows defaults.
    let (meaning, told) = meaning.split_once(" [default: ").unwrap_or((&meaning, ""));
    let default = match (defaults.is_empty(), setting.get_action().takes_values()) {
        (false, _) => defaults.join(", "),
        (true, true) if told.is_empty() => "none".to_owned(),
        (true, true) => told.trim_end_matches(['.', ']']).to_owned(),
        (true, false) => "`false`".to_owned(),
    };
    format!("| {flag} | `{variable}` | {default} | {}. |", meaning.trim_end_matches('.'))
}

#[test]
fn every_setting_is_in_the_table_as_the_program_has_it() {
    let command = ServeSettings::augment_args(Command::new("serve"));
    let expected: Vec<String> = command.get_arguments().map(row).collect();
    assert!(expected.len() > 10, "{expected:?}");
    let written = table("## Settings");
    assert!(
        written == expected,
        "the table of settings in docs/operations.md differs from src/config/; it should be\n{}",
        expected.join("\n")
    );
}

/// The files of `deploy/` that start the service, by name; what is in its folders starts others.
fn deployed() -> Vec<(String, String)> {
    let entries = fs::read_dir(root().join("deploy")).unwrap().map(|entry| entry.unwrap().path());
    entries
        .filter(|path| path.is_file())
        .map(|path| (path.file_name().unwrap().to_str().unwrap().to_owned(), fs::read_to_string(&path).unwrap()))
        .collect()
}

#[test]
fn what_is_deployed_names_settings_that_are_there_and_gives_time_to_stop() {
    let command = ServeSettings::augment_args(Command::new("serve"));
    let known: BTreeSet<String> = command.get_arguments().map(|setting| setting.get_env().unwrap().to_str().unwrap().to_owned()).collect();
    // Draining, jobs (6 s) and callbacks (5 s) given back, last answers (5 s) and traces (3 s), as docs/operations.md tells under "Stopping".
    let stopping_s = ServeSettings::from_flags([]).unwrap().drain_seconds + 19;
    let files = deployed();
    assert_eq!(files.len(), 3);
    for (file, text) in files {
        let named: Vec<&str> = text
            .match_indices("VENTRICLE_")
            .map(|(start, _)| text[start..].split(|letter: char| !letter.is_ascii_uppercase() && letter != '_').next().unwrap())
            .collect();
        assert!(!named.is_empty(), "{file}");
        for name in named {
            assert!(known.contains(name), "{file} has {name}, which is no setting");
        }
        let patience = ["TimeoutStopSec=", "stop_grace_period: ", "terminationGracePeriodSeconds: "]
            .iter()
            .find_map(|key| text.split(key).nth(1))
            .and_then(|rest| rest.split(|letter: char| !letter.is_ascii_digit()).next()?.parse::<u64>().ok());
        assert!(patience.is_some_and(|patience| patience > stopping_s), "{file}: {patience:?} s to stop, {stopping_s} s are needed");
    }
}

#[test]
fn every_metric_is_in_the_table() {
    let mut expected = BTreeSet::new();
    metrics_in(&root().join("src"), &mut expected);
    expected.extend(ventricle::telemetry::process::readings().iter().map(|reading| reading.name.to_owned()));
    assert!(expected.len() > 8, "{expected:?}");
    let written: Vec<String> = table("## Metrics").iter().map(|row| row.split('`').nth(1).unwrap().to_owned()).collect();
    let unique: BTreeSet<String> = written.iter().cloned().collect();
    assert_eq!(unique.len(), written.len(), "a metric is listed twice: {written:?}");
    assert_eq!(unique, expected, "the table of metrics in docs/operations.md (left) differs from the sources (right)");
}

/// Metrics that the table has, with their labels.
fn listed() -> BTreeMap<String, BTreeSet<String>> {
    let quoted = |cell: &str| cell.split('`').skip(1).step_by(2).map(str::to_owned).collect::<Vec<_>>();
    let rows = table("## Metrics");
    let cells = rows.iter().map(|row| row.trim_matches('|').split('|').collect::<Vec<_>>());
    cells.map(|cells| (quoted(cells[0]).remove(0), quoted(cells[2]).into_iter().collect())).collect()
}

/// The metrics that a text names, each with the labels that it asks for.
fn asked(text: &str) -> Vec<(String, BTreeSet<String>)> {
    let is_name = |letter: char| letter.is_ascii_alphanumeric() || letter == '_';
    let mut found = Vec::new();
    for (start, _) in ["ventricle_", "process_"].into_iter().flat_map(|prefix| text.match_indices(prefix)) {
        if text[..start].ends_with(is_name) {
            continue;
        }
        let name = text[start..].split(|letter| !is_name(letter)).next().unwrap();
        let rest = &text[start + name.len()..];
        let selected = rest.strip_prefix('{').map_or("", |rest| rest.split('}').next().unwrap());
        let labels = selected.split(',').filter_map(|pair| Some(pair.split_once('=')?.0.trim_end_matches('!').trim().to_owned()));
        let histogram = ["_bucket", "_sum", "_count"].into_iter().find_map(|end| name.strip_suffix(end));
        found.push((histogram.unwrap_or(name).to_owned(), labels.collect()));
    }
    found
}

#[test]
fn what_is_watched_is_what_is_measured() {
    let listed = listed();
    let dashboard = fs::read_to_string(root().join("deploy/grafana/ventricle.json")).unwrap();
    let dashboard: serde_json::Value = serde_json::from_str(&dashboard).unwrap();
    let expressions: Vec<&str> = dashboard["panels"]
        .as_array()
        .unwrap()
        .iter()
        .flat_map(|panel| panel["targets"].as_array().into_iter().flatten())
        .map(|target| target["expr"].as_str().unwrap())
        .collect();
    assert!(expressions.len() > 30, "{}", expressions.len());
    let rules = fs::read_to_string(root().join("deploy/prometheus/alerts.yaml")).unwrap();
    let tests = fs::read_to_string(root().join("deploy/prometheus/alerts-test.yaml")).unwrap();
    let mut shown = BTreeSet::new();
    for (what, text) in [("the dashboard", expressions.join("\n")), ("alerts.yaml", rules), ("alerts-test.yaml", tests)] {
        let asked = asked(&text);
        assert!(asked.len() > 15, "{what}: {asked:?}");
        for (name, labels) in asked {
            let known = listed.get(&name).unwrap_or_else(|| panic!("{what} asks for {name}, which is not in the table of metrics"));
            // What Prometheus adds.
            let unknown: Vec<_> =
                labels.iter().filter(|label| !known.contains(*label) && *label != "instance" && *label != "job").collect();
            assert!(unknown.is_empty(), "{what}: {name} has no label {unknown:?}");
            if what == "the dashboard" {
                shown.insert(name);
            }
        }
    }
    let missing: Vec<_> = listed.keys().filter(|name| !shown.contains(*name)).collect();
    assert!(missing.is_empty(), "not on the dashboard: {missing:?}");
}

/// The names in `counter!("…")`, `gauge!("…")` and `histogram!("…")` of the sources, tests left out.
fn metrics_in(folder: &Path, found: &mut BTreeSet<String>) {
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            metrics_in(&path, found);
        } else if path.extension().is_some_and(|extension| extension == "rs") {
            let text = fs::read_to_string(&path).unwrap();
            let code = text.split("#[cfg(test)]\nmod tests").next().unwrap();
            for recorded in ["counter!(\"", "gauge!(\"", "histogram!(\""] {
                found.extend(code.split(recorded).skip(1).map(|after| after.split('"').next().unwrap().to_owned()));
            }
        }
    }
}
