//! Keys as an operator has them: made and revoked by `ventricle keys` while a real service runs, with its audit log.

use crate::{
    parted,
    served::{Answer, Directory, Served, answer, audited},
};
use serde_json::{Value, json};
use std::{
    fs,
    io::Write as _,
    path::Path,
    process::{Command, Output},
    time::{Duration, Instant},
};

/// As long as a service may take to notice another file of keys, and as much again.
const SOON: Duration = Duration::from_secs(10);

fn keys(data: &Path, arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_ventricle")).arg("keys").args(arguments).arg("--data-dir").arg(data).output().unwrap()
}

/// Makes a key: its text and its id.
fn add(data: &Path, arguments: &[&str]) -> (String, String) {
    let output = keys(data, &[&["add", "--json"], arguments].concat());
    assert!(output.status.success(), "{output:?}");
    let made: Value = serde_json::from_slice(&output.stdout).unwrap();
    (made["key"].as_str().unwrap().to_owned(), made["id"].as_str().unwrap().to_owned())
}

fn ask(service: &Served, method: &str, path: &str, key: &str) -> Answer {
    let config = ureq::Agent::config_builder().http_status_as_error(false).timeout_global(Some(Duration::from_mins(1)));
    let request = ureq::http::Request::builder().method(method).uri(format!("{}{path}", service.url));
    let request = request.header("authorization", format!("Bearer {key}")).header("prefer", "wait=20").body(()).unwrap();
    answer(config.build().new_agent().run(request).unwrap())
}

/// Waits until a key has an answer.
fn reaches(service: &Served, key: &str, status: u16) {
    let start = Instant::now();
    while ask(service, "GET", "/v1/reconstructions", key).status != status {
        assert!(start.elapsed() < SOON, "not {status} after {SOON:?}");
        std::thread::sleep(Duration::from_millis(100));
    }
}

#[test]
fn keys_are_made_listed_and_revoked_while_the_service_runs() {
    let directory = Directory::new("keys");
    let data = &directory.0;
    let (first, first_id) = add(data, &["--owner", "St Mary's", "--note", "PACS"]);
    let service = Served::start(data, &[]);
    assert_eq!(service.get("/v1/reconstructions").status, 401);
    assert_eq!(service.get("/healthz").status, 200);
    assert_eq!(service.get("/readyz").status, 200);
    assert_eq!(service.get("/metrics").status, 401);
    assert_eq!(ask(&service, "GET", "/v1/reconstructions", &first).status, 200);
    assert_eq!(ask(&service, "GET", "/metrics", &first).status, 403);
    let (second, _) = add(data, &["--owner", "operators", "--scope", "admin", "--expires-days", "1"]);
    reaches(&service, &second, 200);
    assert_eq!(ask(&service, "GET", "/metrics", &second).status, 200);
    let listed = String::from_utf8(keys(data, &["list"]).stdout).unwrap();
    assert!(
        listed.contains(&first_id) && listed.contains("St Mary's") && listed.contains("submit,read") && listed.contains("PACS"),
        "{listed}"
    );
    for secret in [&first, &second] {
        assert!(!listed.contains(secret.rsplit('_').next().unwrap()));
    }
    assert!(keys(data, &["revoke", &first_id]).status.success());
    reaches(&service, &first, 401);
    let again = keys(data, &["revoke", &first_id]);
    assert!(!again.status.success() && String::from_utf8_lossy(&again.stderr).contains("There is no key"), "{again:?}");
    // A file that somebody broke: keys stay as they were, and nobody else comes in.
    fs::write(data.join("keys.json"), "{").unwrap();
    std::thread::sleep(Duration::from_secs(3));
    assert_eq!(ask(&service, "GET", "/v1/reconstructions", &second).status, 200);
    service.kill();
    let refused =
        Command::new(env!("CARGO_BIN_EXE_ventricle")).args(["serve", "--listen", "127.0.0.1:0", "--data-dir"]).arg(data).output().unwrap();
    assert!(!refused.status.success() && String::from_utf8_lossy(&refused.stderr).contains("keys.json"), "{refused:?}");
}

#[test]
fn an_open_address_needs_keys_or_a_word() {
    let directory = Directory::new("exposed");
    let data = directory.0.to_str().unwrap();
    let run = |flags: &[&str]| {
        let command = [&["serve", "--listen", "0.0.0.0:0", "--data-dir", data], flags].concat();
        let output = Command::new(env!("CARGO_BIN_EXE_ventricle")).args(command).output().unwrap();
        assert!(!output.status.success());
        String::from_utf8(output.stderr).unwrap()
    };
    let said = run(&[]);
    assert!(said.contains("ventricle keys add") && said.contains("--insecure-no-auth"), "{said}");
    add(&directory.0, &["--owner", "ours"]);
    assert!(run(&["--insecure-no-auth"]).contains("one or the other"));
    assert!(run(&["--oidc-issuer", "http://login.example", "--oidc-audience", "v"]).contains("https://"));
    assert!(run(&["--oidc-issuer", "https://login.example"]).contains("--oidc-audience"));
}

#[test]
fn the_audit_log_tells_who_did_what_with_which_job_and_is_opened_anew_on_sighup() {
    let directory = Directory::new("audit");
    let (data, log) = (&directory.0, directory.0.join("audit.jsonl"));
    let (key, id) = add(data, &["--owner", "ours"]);
    let service = Served::start(data, &["--audit-log", log.to_str().unwrap(), "--workers", "1"]);
    let body = include_bytes!("../../fuzz/corpus/json/u2");
    let config = ureq::Agent::config_builder().http_status_as_error(false);
    let post = config.build().new_agent().post(format!("{}/v1/reconstructions?mesh.level=2", service.url));
    let accepted =
        answer(post.header("authorization", format!("Bearer {key}")).header("content-type", "application/json").send(&body[..]).unwrap());
    assert_eq!(accepted.status, 202, "{}", accepted.json());
    let job = accepted.json()["id"].as_str().unwrap().to_owned();
    let path = format!("/v1/reconstructions/{job}");
    ask(&service, "GET", &path, &key);
    assert_eq!(service.get(&format!("{path}/report")).status, 401);
    let told = audited(&log, 3);
    let of = |line: &Value, field: &str| line[field].as_str().unwrap_or_default().to_owned();
    assert_eq!((of(&told[0], "what"), told[0]["status"].as_u64()), ("POST /v1/reconstructions".to_owned(), Some(202)));
    assert_eq!((of(&told[0], "who"), of(&told[0], "owner"), &told[0]["jobs"]), (id, "ours".to_owned(), &json!([job])));
    assert_eq!((of(&told[1], "what"), &told[1]["jobs"]), ("GET /v1/reconstructions/{id}".to_owned(), &json!([job])));
    assert_eq!((told[2]["status"].as_u64(), of(&told[2], "refused")), (Some(401), "credentials_missing".to_owned()));
    assert!(told[2]["who"].is_null() && of(&told[2], "address") == "127.0.0.1" && !of(&told[2], "request_id").is_empty(), "{}", told[2]);
    assert!(told.iter().all(|line| of(line, "at").ends_with('Z')));
    let moved = directory.0.join("audit.1");
    fs::rename(&log, &moved).unwrap();
    service.signal("HUP");
    let start = Instant::now();
    while !log.exists() {
        assert!(start.elapsed() < SOON, "no new file");
        std::thread::sleep(Duration::from_millis(50));
    }
    ask(&service, "DELETE", &path, &key);
    let told = audited(&log, 1);
    assert_eq!((of(&told[0], "what"), &told[0]["jobs"]), ("DELETE /v1/reconstructions/{id}".to_owned(), &json!([job])));
    assert_eq!(fs::read_to_string(moved).unwrap().lines().count(), 3);
}

#[test]
fn the_audit_log_tells_which_keys_were_made_and_revoked_and_none_is_made_without_it() {
    let directory = Directory::new("keys-audit");
    let (data, log) = (&directory.0, directory.0.join("audit.jsonl"));
    let service = Served::start(data, &["--audit-log", log.to_str().unwrap()]);
    service.get("/v1/reconstructions");
    let told_to = ["--audit-log", log.to_str().unwrap()];
    let (key, id) = add(data, &[&["--owner", "ours"], &told_to[..]].concat());
    assert!(keys(data, &[&["revoke", &id], &told_to[..]].concat()).status.success());
    service.get("/v1/reconstructions");
    let told = audited(&log, 4);
    for (line, what) in told[1..3].iter().zip(["keys add", "keys revoke"]) {
        assert_eq!((&line["what"], &line["owner"], &line["key"]), (&json!(what), &json!("ours"), &json!(id)));
        assert!(line["who"].as_str().unwrap().starts_with("uid ") && line["status"].is_null(), "{line}");
    }
    assert_eq!((&told[0]["what"], &told[3]["what"]), (&json!("GET /v1/reconstructions"), &json!("GET /v1/reconstructions")));
    assert!(!fs::read_to_string(&log).unwrap().contains(key.rsplit('_').next().unwrap()));
    let nowhere = directory.0.join("absent/audit.jsonl");
    let refused = keys(data, &["add", "--owner", "others", "--audit-log", nowhere.to_str().unwrap()]);
    assert!(!refused.status.success() && refused.stdout.is_empty(), "{refused:?}");
    let said = String::from_utf8_lossy(&refused.stderr);
    assert!(said.contains("The audit log") && said.matches("No such file").count() == 1, "{said}");
    assert!(!String::from_utf8(keys(data, &["list"]).stdout).unwrap().contains("others"));
}

#[test]
fn what_is_done_for_a_client_that_goes_away_has_its_line_and_so_has_a_job_however_its_id_is_written() {
    let directory = Directory::new("gone");
    let log = directory.0.join("audit.jsonl");
    let service = Served::start(&directory.0, &["--audit-log", log.to_str().unwrap(), "--workers", "1"]);
    let body = include_bytes!("../../fuzz/corpus/json/u2");
    let submit = || service.post("application/json", body).json()["id"].as_str().unwrap().to_owned();
    let host = service.url.strip_prefix("http://").unwrap();
    let jobs: Vec<String> = (0..20).map(|_| submit()).collect();
    for (job, wait_us) in jobs.iter().zip((0..).step_by(100)) {
        service.finished(job, SOON);
        let mut stream = std::net::TcpStream::connect(host).unwrap();
        write!(stream, "DELETE /v1/reconstructions/{job} HTTP/1.1\r\nhost: {host}\r\n\r\n").unwrap();
        std::thread::sleep(Duration::from_micros(wait_us));
    }
    // Of some the request was not read before its client was gone.
    let gone: Vec<&String> = jobs.iter().filter(|job| service.get(&format!("/v1/reconstructions/{job}")).status == 404).collect();
    let written = gone.first().unwrap().replacen('0', "%30", 1);
    assert_eq!(service.get(&format!("/v1/reconstructions/{written}")).status, 404);
    let start = Instant::now();
    let told = |job: &str| {
        let of_it = |line: &Value| line["what"] == "DELETE /v1/reconstructions/{id}" && line["jobs"] == json!([job]);
        audited(&log, 1).iter().any(of_it)
    };
    while !gone.iter().all(|job| told(job)) {
        assert!(start.elapsed() < SOON, "{} jobs are gone, not all by a line", gone.len());
        std::thread::sleep(Duration::from_millis(50));
    }
    let looks = audited(&log, 1).iter().filter(|line| line["status"] == 404 && line["jobs"] == json!([gone[0]])).count();
    assert_eq!(looks, 2, "once by each form");
}

#[test]
fn whoever_may_only_submit_is_not_told_by_a_repeated_request_what_came_of_it() {
    let directory = Directory::new("submit-only");
    let (submits, _) = add(&directory.0, &["--owner", "ours", "--scope", "submit"]);
    let (reads, _) = add(&directory.0, &["--owner", "ours"]);
    let service = Served::start(&directory.0, &["--workers", "1"]);
    let study = parted::whole(9);
    let post = |key: &str| {
        let request =
            ureq::post(format!("{}/v1/reconstructions?mesh.level=2", service.url)).header("authorization", format!("Bearer {key}"));
        let request = request.header("content-type", "application/dicom").header("idempotency-key", "once");
        answer(request.send(&study[..]).unwrap()).json()
    };
    let job = post(&submits)["id"].as_str().unwrap().to_owned();
    let path = format!("/v1/reconstructions/{job}");
    let start = Instant::now();
    while !["succeeded", "failed"].contains(&ask(&service, "GET", &path, &reads).json()["state"].as_str().unwrap()) {
        assert!(start.elapsed() < Duration::from_mins(1));
    }
    assert_eq!(ask(&service, "GET", &path, &reads).json()["state"], "succeeded");
    assert!(post(&submits)["summary"].is_null());
    assert!(post(&reads)["summary"].is_object());
}
