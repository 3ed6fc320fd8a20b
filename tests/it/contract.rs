//! Schemathesis, which makes requests up from the contract and holds the answers to it: against a real service, with a key and without.

use crate::{
    served::{Directory, Served, answer},
    shared::absent,
};
use serde_json::Value;
use std::{
    path::{Path, PathBuf},
    process::Command,
};

/// Fewest requests of both runs together.
const CASES: u64 = 2000;

/// Where schemathesis is, if it is installed; required in CI.
fn program() -> Option<PathBuf> {
    let program = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/tools/.venv/bin/schemathesis");
    if !program.exists() {
        absent("schemathesis (tests/tools/prepare.sh)");
        return None;
    }
    Some(program)
}

/// Runs it; returns how many requests it made.
fn run(program: &Path, service: &Served, jobs: &[String; 2], folder: &Path, config: Option<&Path>, arguments: &[&str]) -> u64 {
    let config = config.map(|path| ["--config-file".into(), path.as_os_str().to_owned()]);
    let output = Command::new(program)
        .current_dir(folder)
        .args(config.into_iter().flatten())
        .args(["run", &format!("{}/openapi.json", service.url), "--phases", "examples,coverage,fuzzing", "--seed", "1"])
        // By one thread: Python 3.11 fails now and then where two parse Python at once (python/cpython#106905), as hypothesis does for its messages.
        .args(["--workers", "1"])
        // The stream of all jobs has no end.
        .args(["--exclude-path", "/v1/reconstructions/events", "--request-timeout", "60", "--continue-on-failure", "--no-shrink"])
        .args(arguments)
        .env("SCHEMATHESIS_HOOKS", Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/tools/schemathesis_hooks.py"))
        .env("VENTRICLE_JOB", &jobs[0])
        .env("VENTRICLE_JOB_TO_DELETE", &jobs[1])
        .output()
        .unwrap();
    let told = String::from_utf8_lossy(&output.stdout);
    // As `1406 generated, 1406 passed`.
    let cases = told.lines().find_map(|line| line.trim().split_once(" generated")?.0.parse().ok());
    assert!(output.status.success(), "{told}\n{}", String::from_utf8_lossy(&output.stderr));
    cases.unwrap_or_else(|| panic!("how many requests were made is not told:\n{told}"))
}

/// A finished job whose input is kept.
fn job(service: &Served, key: &str) -> String {
    let agent: ureq::Agent = ureq::Agent::config_builder().http_status_as_error(false).build().into();
    let bearer = format!("Bearer {key}");
    let study = answer(agent.get(format!("{}/v1/phantom.dcm", service.url)).header("authorization", &bearer).call().unwrap());
    let post = agent.post(format!("{}/v1/reconstructions?preset=paper&keep_input=true", service.url));
    let posted = answer(post.header("authorization", &bearer).header("content-type", "application/dicom").send(&study.body[..]).unwrap());
    let id = posted.json()["id"].as_str().unwrap().to_owned();
    for _ in 0..20 {
        let look =
            agent.get(format!("{}/v1/reconstructions/{id}", service.url)).header("authorization", &bearer).header("prefer", "wait=20");
        if answer(look.call().unwrap()).json()["state"] == "succeeded" {
            return id;
        }
    }
    panic!("{id} did not succeed");
}

#[test]
fn schemathesis_finds_no_answer_that_the_contract_does_not_promise() {
    let Some(program) = program() else { return };
    let directory = Directory::new("contract");
    let data = &directory.0;
    let made = Command::new(env!("CARGO_BIN_EXE_ventricle"))
        .args(["keys", "add", "--owner", "ours", "--scope", "admin", "--requests-per-second", "0", "--json", "--data-dir"])
        .arg(data)
        .output()
        .unwrap();
    let key: Value = serde_json::from_slice(&made.stdout).unwrap();
    let key = key["key"].as_str().unwrap();
    // Each wrong key is to be refused as such.
    let service = Served::start(data, &["--upload-seconds", "5", "--refusals-per-minute", "1000000"]);
    let jobs = [job(&service, key), job(&service, key)];
    let header = format!("Authorization: Bearer {key}");
    // What the contract allows, asked of what is there; what it does not, asked of anything; and both of everybody who has no key.
    let config = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/tools/schemathesis.toml");
    let run = |config: Option<&Path>, arguments: &[&str]| run(&program, &service, &jobs, data, config, arguments);
    let allowed = run(Some(&config), &["--mode", "positive", "--header", &header, "--max-examples", "25"]);
    // Nothing that could be asked wrongly of the phantom. What is forbidden of one part of a request may be right in the others, which for bodies of
    // bytes no schema says.
    let negative = ["--mode", "negative", "--exclude-path", "/v1/phantom.dcm", "--exclude-checks", "positive_data_acceptance"];
    let forbidden =
        run(None, &[&negative[..], &["--header", &header, "--max-examples", "25", "--suppress-health-check", "filter_too_much"]].concat());
    let without = run(Some(&config), &["--max-examples", "3"]);
    eprintln!("schemathesis: {allowed} requests that the contract allows, {forbidden} that it does not, {without} without a key");
    assert!(allowed + forbidden + without >= CASES, "{allowed}, {forbidden} and {without}");
}
