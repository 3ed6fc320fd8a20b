//! The viewer in a browser: Debian's Chromium on the pages that the program has inside, driven by `web/tests`; and what programs take home, the
//! typed client, the component for other sites, and the recipe of `docs/clients.md`.

use crate::{
    dimse::write,
    parted,
    served::{Directory, Served},
    shared,
};
use std::{
    path::{Path, PathBuf},
    process::{Command, Output},
};

fn web() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("web")
}

/// Whether node, the packages that the tests use and a browser are there; says what to install otherwise.
fn ready(browser: bool) -> bool {
    if Command::new("node").arg("--version").output().is_err() {
        shared::absent("nodejs");
        return false;
    }
    if browser && !Path::new("/usr/bin/chromium").exists() {
        shared::absent("chromium");
        return false;
    }
    if !web().join("node_modules/playwright-core").exists() || !web().join("client/dist/index.js").exists() {
        shared::absent("npm");
        println!("skipped: the pages are not built (`make web`)");
        return false;
    }
    true
}

fn said(output: &Output) -> String {
    [output.stdout.as_slice(), &output.stderr].map(String::from_utf8_lossy).concat()
}

/// Runs a script of `web/tests`, which must end well.
fn run(script: &str, arguments: &[&str]) {
    let output = Command::new("node").arg(web().join("tests").join(script)).args(arguments).current_dir(web()).output().unwrap();
    assert!(output.status.success(), "{script}: {}", said(&output));
    println!("{}", said(&output));
}

/// A file of the shared data.
fn data(folder: &str, file: &str) -> Option<String> {
    Some(shared::folder(folder)?.join(file).to_str().unwrap().to_owned())
}

#[test]
fn a_dropped_study_is_reconstructed_shown_and_run_again_with_another_circle() {
    let Some(study) = data("gated-short-axis", "dev-01a.dcm").filter(|_| ready(true)) else { return };
    let store = Directory::new("viewer-drop");
    let service = Served::start(&store.0, &[]);
    run("drop.mjs", &[&service.url, &study]);
}

#[test]
fn the_list_is_live_speaks_three_languages_and_makes_a_phantom() {
    let Some(study) = data("gated-short-axis", "dev-02a.nii.gz").filter(|_| ready(true)) else { return };
    let store = Directory::new("viewer-list");
    let service = Served::start(&store.0, &[]);
    run("studies.mjs", &[&service.url, &study]);
}

#[test]
fn files_of_two_series_dropped_together_become_two_studies() {
    if !ready(true) {
        return;
    }
    let (store, folder) = (Directory::new("viewer-series"), Directory::new("viewer-series-files"));
    let service = Served::start(&store.0, &[]);
    let gates = parted::gates(&parted::whole(60));
    let files = gates.iter().enumerate().map(|(gate, bytes)| write(&folder.0, &format!("{gate}.dcm"), bytes));
    let files: Vec<PathBuf> = files.chain([write(&folder.0, "whole.dcm", &parted::whole(61))]).collect();
    let mut arguments = vec![service.url.as_str(), "2"];
    arguments.extend(files.iter().map(|file| file.to_str().unwrap()));
    run("series.mjs", &arguments);
}

#[test]
fn what_goes_wrong_is_told_in_words_with_a_way_on() {
    let Some(refused) = data("negatives", "MR_small.dcm").filter(|_| ready(true)) else { return };
    let store = Directory::new("viewer-trouble");
    let service = Served::start(&store.0, &[]);
    run("trouble.mjs", &[&service.url, &refused]);
}

#[test]
fn another_site_shows_the_model_under_its_own_policy() {
    let Some(study) = data("gated-short-axis", "dev-01a.dcm").filter(|_| ready(true)) else { return };
    let store = Directory::new("viewer-embed");
    let service = Served::start(&store.0, &["--cors-origin", "*"]);
    run("embed.mjs", &[&service.url, &study]);
}

#[test]
fn the_client_goes_from_file_to_report_and_is_what_the_contract_says() {
    let Some(study) = data("gated-short-axis", "dev-01a.dcm").filter(|_| ready(false)) else { return };
    let store = Directory::new("viewer-client");
    let service = Served::start(&store.0, &[]);
    let tests = web().join("client/tests/client.test.mjs");
    let tested = Command::new("node")
        .arg("--test")
        .arg(tests)
        .envs([("VENTRICLE_URL", &service.url), ("VENTRICLE_STUDY", &study)])
        .output()
        .unwrap();
    assert!(tested.status.success(), "{}", said(&tested));
    let checked = Command::new("npm").args(["run", "--silent", "check"]).current_dir(web()).output().unwrap();
    assert!(checked.status.success(), "{}", said(&checked));
}

#[test]
fn the_python_recipe_posts_waits_and_fetches() {
    let python = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/tools/.venv/bin/python");
    if !python.exists() {
        return shared::absent("python3-venv");
    }
    let Some(study) = data("gated-short-axis", "dev-01a.dcm") else { return };
    let text = std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/clients.md")).unwrap();
    let script = text.split("```python\n").nth(1).and_then(|rest| rest.split("```").next()).unwrap();
    let (store, folder) = (Directory::new("viewer-python"), Directory::new("viewer-python-files"));
    let service = Served::start(&store.0, &[]);
    let script = write(&folder.0, "reconstruct.py", script.as_bytes());
    let output = Command::new(&python).arg(&script).arg(&service.url).arg(&study).current_dir(&folder.0).output().unwrap();
    assert!(output.status.success(), "{}", said(&output));
    let job = service.get("/v1/reconstructions").json()["reconstructions"][0].clone();
    let own = service.get(job["links"]["report"].as_str().unwrap()).json();
    let ef = own["function"]["ef_percent"].as_f64().unwrap();
    assert!(said(&output).contains(&format!("EF {ef:.1} %")), "{}", said(&output));
    let surfaces = service.get(job["links"]["surfaces"].as_str().unwrap()).body;
    assert!(std::fs::read(folder.0.join("surfaces.glb")).unwrap() == surfaces);
    let refused = Command::new(&python).arg(&script).arg(&service.url).arg(&script).current_dir(&folder.0).output().unwrap();
    assert!(!refused.status.success() && said(&refused).contains("unknown_format"), "{}", said(&refused));
}
