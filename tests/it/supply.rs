//! What a release is made of and runs in: that findings of `npm audit` are judged as said, and that the image and its manifests ask for no more
//! than the service needs.

use crate::{served::Directory, shared::absent};
use serde_json::{Value, json};
use std::{
    fs,
    io::Write as _,
    path::Path,
    process::{Command, Stdio},
};

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// What is said of an answer of `npm audit` under these exceptions, on a day; `None` where there is no Node.js.
fn judged(answer: &str, exceptions: &Value) -> Option<(i32, String)> {
    let folder = Directory::new("audit");
    let file = folder.0.join("exceptions.json");
    fs::write(&file, exceptions.to_string()).unwrap();
    let mut command = Command::new("node");
    command.arg(root().join("tests/tools/audit.mjs")).arg(&file).args(["web", "2026-06-15"]);
    let Ok(mut child) = command.stdin(Stdio::piped()).stdout(Stdio::piped()).spawn() else {
        absent("nodejs");
        return None;
    };
    child.stdin.take().unwrap().write_all(answer.as_bytes()).unwrap();
    let output = child.wait_with_output().unwrap();
    Some((output.status.code().unwrap(), String::from_utf8(output.stdout).unwrap()))
}

#[test]
fn a_finding_stands_unless_it_is_excepted_with_a_reason_until_a_day() {
    let advisory = json!({"source": 1, "name": "three", "title": "It runs what a file says", "severity": "high", "range": "<1",
        "url": "https://github.com/advisories/GHSA-aaaa-bbbb-cccc"});
    let found = json!({"vulnerabilities": {"three": {"via": [advisory]}, "viewer": {"via": ["three"]}}}).to_string();
    let exception = |until: &str| json!([{"advisory": "GHSA-aaaa-bbbb-cccc", "reason": "no such file is read", "until": until}]);
    let Some((status, said)) = judged(&found, &json!([])) else { return };
    assert!(status == 1 && said.contains("GHSA-aaaa-bbbb-cccc (high) three <1: It runs what a file says"), "{said}");
    assert_eq!(said.lines().count(), 1, "told once, under the package that has it: {said}");
    let judged = |answer: &str, exceptions: &Value| judged(answer, exceptions).unwrap();
    assert_eq!(judged(&found, &exception("2026-06-15")), (0, "advisories of web ok, 1 excepted\n".to_owned()));
    let (status, said) = judged(&found, &exception("2026-06-14"));
    assert!(status == 1 && said.contains("its exception ended on 2026-06-14"), "{said}");
    let (status, said) = judged(&found, &json!([{"advisory": "GHSA-aaaa-bbbb-cccc", "until": "2026-12-31"}]));
    assert!(status == 1 && said.contains("needs"), "{said}");
    assert_eq!(judged(&json!({"vulnerabilities": {}}).to_string(), &json!([])), (0, "advisories of web ok\n".to_owned()));
    for answer in ["", "<html>", "{\"message\": \"405 Method Not Allowed\"}"] {
        let (status, said) = judged(answer, &json!([]));
        assert!(status == 3 && said.starts_with("not checked: "), "{answer:?}: {said}");
    }
}

#[test]
fn the_exceptions_are_whole() {
    let exceptions = fs::read_to_string(root().join("tests/tools/audit-exceptions.json")).unwrap();
    if let Some((status, said)) = judged("{\"vulnerabilities\": {}}", &serde_json::from_str(&exceptions).unwrap()) {
        assert_eq!(status, 0, "{said}");
    }
}

#[test]
fn the_image_has_no_shell_and_needs_none() {
    let dockerfile = fs::read_to_string(root().join("Dockerfile")).unwrap();
    let last = dockerfile.rsplit("\nFROM ").next().unwrap();
    assert!(last.starts_with("gcr.io/distroless/"), "{last}");
    let instructions: Vec<&str> = last.lines().filter(|line| line.starts_with(|letter: char| letter.is_ascii_uppercase())).collect();
    assert!(!instructions.iter().any(|line| line.starts_with("RUN ") || line.starts_with("SHELL ")), "{instructions:?}");
    for name in ["HEALTHCHECK", "ENTRYPOINT", "CMD"] {
        let line = instructions.iter().find(|line| line.starts_with(name)).unwrap_or_else(|| panic!("no {name}"));
        assert!(line.contains("[\""), "{line} would need a shell");
    }
    assert!(instructions.contains(&"USER 10001:10001"), "{instructions:?}");
}

#[test]
fn manifests_ask_for_a_read_only_root_and_no_rights() {
    for (file, wanted) in [
        ("deploy/compose.yaml", ["read_only: true", "cap_drop: [ALL]", "no-new-privileges:true", "mem_limit: ", "pids_limit: "].as_slice()),
        (
            "deploy/kubernetes.yaml",
            &[
                "readOnlyRootFilesystem: true",
                "capabilities: { drop: [ALL] }",
                "allowPrivilegeEscalation: false",
                "runAsNonRoot: true",
                "seccompProfile: { type: RuntimeDefault }",
                "limits: {",
                "automountServiceAccountToken: false",
            ],
        ),
        (
            "deploy/ventricle.service",
            &["ProtectSystem=strict", "CapabilityBoundingSet=\n", "NoNewPrivileges=yes", "LimitCORE=0", "SystemCallFilter=@system-service"],
        ),
    ] {
        let text = fs::read_to_string(root().join(file)).unwrap();
        for setting in wanted {
            assert!(text.contains(setting), "{file} has no {setting}");
        }
        assert!(!text.contains("unconfined") && !text.contains("privileged: true"), "{file}");
    }
}
