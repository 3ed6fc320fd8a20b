//! The `DICOMweb` client libraries that people write scripts with: Python's `dicomweb-client` and npm's, and the recipes of `docs/pacs.md`.

use crate::{
    dimse::write,
    parted,
    served::{Directory, Served},
    shared,
};
use dicom_core::VR;
use dicom_dictionary_std::tags;
use serde_json::{Value, json};
use std::{
    path::{Path, PathBuf},
    process::{Command, Output},
    time::{Duration, Instant},
};

/// SOP Instance UID of the CT beside the good ones.
const CT: &str = "1.2.3.1";
const SOON: Duration = Duration::from_mins(1);

fn tools() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/tools")
}

/// The tests' own Python; `None` with a word where it is absent.
fn python() -> Option<PathBuf> {
    let python = tools().join(".venv/bin/python");
    if !python.exists() {
        shared::absent("python3-venv");
        return None;
    }
    Some(python)
}

fn said(output: &Output) -> String {
    [output.stdout.as_slice(), &output.stderr].map(String::from_utf8_lossy).concat()
}

fn printed(output: &Output) -> Value {
    assert!(output.status.success(), "{}", said(output));
    serde_json::from_slice(&output.stdout).unwrap_or_else(|_| panic!("{}", said(output)))
}

/// A study's gates as files, a CT of the same study, and the UIDs of the gates.
fn study(folder: &Directory, seed: u64) -> (Vec<PathBuf>, PathBuf, Vec<String>) {
    let gates = parted::gates(&parted::whole(seed));
    let ct =
        [(tags::SOP_CLASS_UID, VR::UI, "1.2.840.10008.5.1.4.1.1.2"), (tags::MODALITY, VR::CS, "CT"), (tags::SOP_INSTANCE_UID, VR::UI, CT)];
    let ct = write(&folder.0, &format!("{seed}-ct.dcm"), &parted::with(&gates[0], &ct));
    let uids = gates.iter().map(|gate| parted::text_of(gate, tags::SOP_INSTANCE_UID)).collect();
    let files = gates.iter().enumerate().map(|(gate, bytes)| write(&folder.0, &format!("{seed}-{gate}.dcm"), bytes));
    (files.collect(), ct, uids)
}

/// The one job of the service, once it is finished.
fn the_job(service: &Served) -> Value {
    let start = Instant::now();
    loop {
        let jobs = service.get("/v1/reconstructions").json()["reconstructions"].as_array().unwrap().clone();
        assert!(jobs.len() <= 1, "{jobs:#?}");
        if let Some(job) = jobs.first().filter(|job| job["finished_at"].is_string()) {
            return job.clone();
        }
        assert!(start.elapsed() < SOON, "{jobs:#?}");
        std::thread::sleep(Duration::from_millis(50));
    }
}

/// The UIDs in a sequence of a DICOM JSON answer.
fn instances(answer: &Value, sequence: &str) -> Vec<String> {
    let items = answer[sequence]["Value"].as_array().cloned().unwrap_or_default();
    items.iter().map(|item| item["00081155"]["Value"][0].as_str().unwrap().to_owned()).collect()
}

#[test]
fn python_s_client_returns_what_is_stored_and_what_is_not_and_raises_where_nothing_is() {
    let Some(python) = python() else { return };
    let (data, folder) = (Directory::new("python"), Directory::new("python-files"));
    let service = Served::start(&data.0, &["--quiet-seconds", "3600"]);
    let url = format!("{}/dicom-web", service.url);
    let store = |files: &[&PathBuf]| printed(&Command::new(&python).arg(tools().join("store.py")).arg(&url).args(files).output().unwrap());
    let (files, ct, uids) = study(&folder, 50);
    // The study in two requests, and something else in the second.
    let first = store(&[&files[0], &files[1]]);
    assert_eq!(first, json!({ "statuses": [200], "raised": false, "stored": uids[..2], "failed": [], "reasons": [] }));
    let second = store(&[&files[2], &ct, &files[3]]);
    assert_eq!(second, json!({ "statuses": [202], "raised": false, "stored": uids[2..], "failed": [CT], "reasons": [0x0122] }));
    assert_eq!(the_job(&service)["state"], "succeeded");
    assert_eq!(store(&[&ct]), json!({ "statuses": [409], "raised": true, "stored": [], "failed": [], "reasons": [] }));
    // All of it again is the same job.
    assert_eq!(store(&files.iter().collect::<Vec<_>>())["stored"], json!(uids));
    assert_eq!(the_job(&service)["progress"]["gates_total"], parted::GATES);
}

#[test]
fn npm_s_client_resolves_with_what_is_stored_and_what_is_not_and_rejects_where_nothing_is() {
    let (data, folder) = (Directory::new("npm"), Directory::new("npm-files"));
    let service = Served::start(&data.0, &["--quiet-seconds", "3600"]);
    let url = format!("{}/dicom-web", service.url);
    let store = |files: &[&PathBuf]| match Command::new("node").arg(tools().join("store.mjs")).arg(&url).args(files).output() {
        Ok(output) if output.status.code() != Some(2) => Some(printed(&output)),
        _ => {
            shared::absent("nodejs");
            None
        }
    };
    let (files, ct, uids) = study(&folder, 51);
    let Some(first) = store(&[&files[0], &files[1]]) else { return };
    let outcome = |answer: &Value| (answer["status"].as_u64().unwrap(), answer["rejected"].as_bool().unwrap());
    assert_eq!((outcome(&first), instances(&first["answer"], "00081199")), ((200, false), uids[..2].to_vec()), "{first:#}");
    let second = store(&[&files[2], &ct, &files[3]]).unwrap();
    assert_eq!((outcome(&second), instances(&second["answer"], "00081199")), ((202, false), uids[2..].to_vec()), "{second:#}");
    assert_eq!(instances(&second["answer"], "00081198"), [CT]);
    assert_eq!(the_job(&service)["state"], "succeeded");
    let third = store(&[&ct]).unwrap();
    assert_eq!((outcome(&third), instances(&third["answer"], "00081198")), ((409, true), vec![CT.to_owned()]), "{third:#}");
    let again = store(&files.iter().collect::<Vec<_>>()).unwrap();
    assert_eq!(instances(&again["answer"], "00081199"), uids);
    assert_eq!(the_job(&service)["progress"]["gates_total"], parted::GATES);
}

/// The code block of `docs/pacs.md` that begins with these words, after its fence.
fn recipe(fence: &str, beginning: &str) -> String {
    let text = std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/pacs.md")).unwrap();
    let start = text.find(&format!("```{fence}\n{beginning}")).unwrap_or_else(|| panic!("no recipe begins with {beginning}"));
    let block = &text[start + 3 + fence.len() + 1..];
    block[..=block.find("\n```").unwrap()].to_owned()
}

/// That a folder holds the service's report and structured report of a job, under the names that the recipes give them.
fn assert_fetched(service: &Served, folder: &Path, job: &Value) {
    assert_eq!(job["state"], "succeeded", "{job}");
    let id = job["id"].as_str().unwrap();
    for (name, link) in [(format!("{id}.json"), "report"), (format!("{id}.dcm"), "sr")] {
        let own = service.get(job["links"][link].as_str().unwrap());
        assert_eq!(own.status, 200);
        assert!(std::fs::read(folder.join(&name)).unwrap() == own.body, "{name}");
    }
}

#[test]
fn the_python_recipe_sends_waits_and_fetches() {
    let Some(python) = python() else { return };
    let (data, folder) = (Directory::new("recipe"), Directory::new("recipe-files"));
    let service = Served::start(&data.0, &[]);
    let script = write(&folder.0, "send.py", recipe("python", "# send.py").as_bytes());
    let (files, ct, _) = study(&folder, 52);
    let output = Command::new(&python).arg(&script).arg(&service.url).args(&files).arg(&ct).current_dir(&folder.0).output().unwrap();
    assert!(output.status.success(), "{}", said(&output));
    let job = the_job(&service);
    assert_fetched(&service, &folder.0, &job);
    let ef = service.get(job["links"]["report"].as_str().unwrap()).json()["function"]["ef_percent"].as_f64().unwrap();
    let said = said(&output);
    assert!(said.contains(&format!("EF {ef:.1} %")) && said.contains(&format!("refused: {CT}")), "{said}");
}

#[test]
fn the_curl_recipe_sends_waits_and_fetches() {
    if Command::new("curl").arg("--version").output().is_err() {
        return shared::absent("curl");
    }
    let (data, folder) = (Directory::new("curl"), Directory::new("curl-files"));
    let service = Served::start(&data.0, &[]);
    write(&folder.0, "gated.dcm", &parted::whole(53));
    let script = recipe("sh", "url=http://127.0.0.1:8080").replace("http://127.0.0.1:8080", &service.url);
    let output = Command::new("sh").args(["-e", "-c", &script]).current_dir(&folder.0).output().unwrap();
    assert!(output.status.success(), "{}", said(&output));
    assert_fetched(&service, &folder.0, &the_job(&service));
}
