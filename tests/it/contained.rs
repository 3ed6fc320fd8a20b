//! The service as the image runs it: a root directory that is read-only and has a C library and the program, no shell, nothing else.

use crate::{
    encapsulated::{converted, phantom_file},
    served::{Directory, Served},
};
use std::{path::Path, process::Command, time::Duration};

#[test]
fn it_works_on_a_read_only_root_without_a_shell() {
    let (root, data) = (Directory::new("root"), Directory::new("root-data"));
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/tools/contained.sh");
    let arguments = |command: &mut Command| {
        command.arg(env!("CARGO_BIN_EXE_ventricle")).arg(&root.0).arg(&data.0);
    };
    let mut trial = Command::new(&script);
    arguments(&mut trial);
    let output = trial.arg("--version").output().unwrap();
    if output.status.code() == Some(3) {
        eprintln!("skipped: a root of its own, as the system gives no user namespaces");
        return;
    }
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    assert!(!root.0.join("bin").exists() && !root.0.join("usr/bin").exists(), "a shell would be there");
    let mut command = Command::new(&script);
    arguments(&mut command);
    command.args(["serve", "--listen", "127.0.0.1:0", "--log", "warn", "--data-dir", "/data", "--keep-patient"]);
    let service = Served::start_by(command, &[]);
    assert_eq!(service.get("/readyz").status, 200);
    // Compressed, so that the child process that decodes is started too.
    let native = phantom_file(2);
    let tools = Directory::new("compress");
    let file = converted(&tools.0, "dcmtk", &["dcmcjpls"], &native).unwrap_or(native);
    let accepted = service.post("application/dicom", &file);
    assert_eq!(accepted.status, 202, "{}", accepted.json());
    let job = service.finished(accepted.json()["id"].as_str().unwrap(), Duration::from_mins(2));
    assert_eq!(job["state"], "succeeded", "{job}");
    let id = job["id"].as_str().unwrap();
    for result in ["report.html", "sr.dcm", "polar-maps/perfusion.png", "gates/1/endocardial.stl"] {
        assert_eq!(service.get(&format!("/v1/reconstructions/{id}/{result}")).status, 200, "{result}");
    }
    assert!(data.0.join("ventricle.sqlite").exists());
}
