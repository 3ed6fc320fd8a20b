//! DICOM associations: dcmtk's clients and its receiver, and peers that mean ill.

mod hostile;

use crate::{
    parted,
    served::{Directory, Served, audited},
    shared,
};
use dicom_core::VR;
use dicom_dictionary_std::tags;
use serde_json::{Value, json};
use std::{
    net::TcpListener,
    path::{Path, PathBuf},
    process::{Child, Command, Output, Stdio},
    time::{Duration, Instant},
};
use ventricle::{
    dimse::{self, Title},
    phantom::{self, Phantom, Shape, Ventricle},
};

/// As storescu is called where nothing else is said.
pub(crate) const CALLER: &str = "STORESCU";

/// Whether dcmtk is there.
pub(crate) fn has_dcmtk() -> bool {
    let found = Command::new("storescu").arg("--version").output().is_ok();
    if !found {
        shared::absent("dcmtk");
    }
    found
}

/// A service that takes associations, on a data directory of its own.
pub(crate) fn service(data: &Directory, flags: &[&str]) -> Served {
    Served::start(&data.0, &[&["--dimse-listen", "127.0.0.1:0"], flags].concat())
}

/// Runs one of dcmtk's clients against the service; returns whether it is content, and what it says.
pub(crate) fn dcmtk(program: &str, service: &Served, arguments: &[&str], files: &[PathBuf]) -> (bool, String) {
    let port = service.dimse_port.to_string();
    let output = Command::new(program).args(arguments).args(["127.0.0.1", &port]).args(files).output().unwrap();
    (output.status.success(), said(&output))
}

fn said(output: &Output) -> String {
    [output.stdout.as_slice(), &output.stderr].map(String::from_utf8_lossy).concat()
}

pub(crate) fn write(folder: &Path, name: &str, bytes: &[u8]) -> PathBuf {
    let path = folder.join(name);
    std::fs::write(&path, bytes).unwrap();
    path
}

/// All jobs of the service, newest first.
fn jobs(service: &Served) -> Vec<Value> {
    service.get("/v1/reconstructions").json()["reconstructions"].as_array().unwrap().clone()
}

fn succeeds(service: &Served, job: &Value) {
    let job = service.finished(job["id"].as_str().unwrap(), Duration::from_mins(2));
    assert_eq!(job["state"], "succeeded", "{job}");
}

/// The sum of the service's answers to objects with this status.
fn objects(service: &Served, status: &str) -> u64 {
    let text = String::from_utf8(service.get("/metrics").body).unwrap();
    let line = format!("ventricle_dimse_objects_total{{status=\"{status}\"}} ");
    text.lines().find_map(|row| row.strip_prefix(&line)).map_or(0, |value| value.parse().unwrap())
}

#[test]
fn an_echo_is_answered_and_a_stored_study_becomes_a_job() {
    if !has_dcmtk() {
        return;
    }
    let (data, files) = (Directory::new("dimse"), Directory::new("dimse-files"));
    let service = service(&data, &[]);
    let (content, said) = dcmtk("echoscu", &service, &["-v", "-aec", "WHOEVER"], &[]);
    assert!(content && said.contains("Received Echo Response (Success)"), "{said}");

    let file = write(&files.0, "study.dcm", &parted::ungated(1));
    // The same instance again is the same job.
    for _ in 0..2 {
        let (content, said) = dcmtk("storescu", &service, &["-v"], std::slice::from_ref(&file));
        assert!(content && said.contains("Received Store Response (Success)"), "{said}");
        assert_eq!(jobs(&service).len(), 1);
    }
    succeeds(&service, &jobs(&service)[0]);
    assert_eq!(objects(&service, "0000"), 2);
}

#[test]
fn the_files_of_the_gates_make_one_job_once_all_are_there() {
    if !has_dcmtk() {
        return;
    }
    let (data, files) = (Directory::new("dimse-gates"), Directory::new("dimse-gates-files"));
    // Nothing is taken because nothing more comes: the parts say how many they are.
    let service = service(&data, &["--quiet-seconds", "3600"]);
    let gates = parted::gates(&parted::whole(1));
    let paths: Vec<PathBuf> = gates.iter().enumerate().map(|(gate, bytes)| write(&files.0, &format!("{gate}.dcm"), bytes)).collect();
    let (content, said) = dcmtk("storescu", &service, &["-v"], &paths[..1]);
    assert!(content, "{said}");
    assert_eq!(jobs(&service), Vec::<Value>::new());
    let parts = || service.metric("ventricle_instances_received_total{way=\"dimse\",outcome=\"part\"}");
    assert_eq!((parts(), service.metric("ventricle_series_waiting")), (1.0, 1.0));
    let (bytes, quiet_s) = (service.metric("ventricle_series_waiting_bytes"), service.metric("ventricle_series_quiet_seconds"));
    let file_bytes = gates[0].len() as f64;
    assert!((0.5 * file_bytes..file_bytes).contains(&bytes), "{bytes} of {file_bytes}");
    assert!((0.0..60.0).contains(&quiet_s), "{quiet_s}");
    let (content, said) = dcmtk("storescu", &service, &["-v"], &paths[1..]);
    assert!(content, "{said}");
    assert_eq!((parts(), service.metric("ventricle_series_waiting")), (parted::GATES as f64, 0.0));
    assert!(service.metric("ventricle_series_waiting_bytes") == 0.0 && service.metric("ventricle_series_quiet_seconds") == 0.0);
    let [job] = jobs(&service).try_into().unwrap();
    succeeds(&service, &job);
    let report = service.get(&format!("/v1/reconstructions/{}/report", job["id"].as_str().unwrap())).json();
    assert_eq!(report["study"]["gates"], parted::GATES);
}

#[test]
fn every_transfer_syntax_that_is_read_is_taken_as_it_is() {
    if !has_dcmtk() {
        return;
    }
    let (data, files) = (Directory::new("dimse-syntaxes"), Directory::new("dimse-syntaxes-files"));
    let service = service(&data, &["--workers", "1"]);
    let plain = write(&files.0, "plain.dcm", &parted::ungated(1));
    for (index, (program, encoding, proposing)) in
        [("dcmconv", "+ti", "-xi"), ("dcmconv", "+te", "-xe"), ("dcmconv", "+tb", "-xb"), ("dcmconv", "+td", "-xd"), ("dcmcrle", "", "-xr")]
            .into_iter()
            .enumerate()
    {
        let path = files.0.join(format!("{index}.dcm"));
        let converted = Command::new(program).args(Some(encoding).filter(|flag| !flag.is_empty())).arg(&plain).arg(&path).output().unwrap();
        assert!(converted.status.success(), "{}", said(&converted));
        // Another object, of another study: the same one in another encoding is a conflict.
        let renamed = Command::new("dcmodify").args(["-nb", "-gst", "-gse", "-gin"]).arg(&path).output().unwrap();
        assert!(renamed.status.success(), "{}", said(&renamed));
        let (content, said) = dcmtk("storescu", &service, &["-v", "-R", proposing], std::slice::from_ref(&path));
        assert!(content && said.contains("Received Store Response (Success)"), "{program} {encoding}: {said}");
        assert_eq!(jobs(&service).len(), index + 1, "{program} {encoding}");
    }
}

#[test]
fn what_is_no_reconstruction_is_refused_and_told_why() {
    if !has_dcmtk() {
        return;
    }
    let (Some(negatives), Some(projections)) = (shared::folder("negatives"), shared::folder("projections")) else { return };
    let data = Directory::new("dimse-refused");
    let service = service(&data, &[]);
    // Another class is not taken at all.
    let (content, said) = dcmtk("storescu", &service, &["-v"], &[negatives.join("CT_small.dcm")]);
    assert!(!content && said.contains("No presentation context for: (CT)"), "{said}");
    // Of the right class, and still nothing to be reconstructed.
    let (_, said) = dcmtk("storescu", &service, &["-d"], &[projections.join("tomo-stress.dcm")]);
    assert!(said.contains("0xa900") && said.to_lowercase().contains("projection"), "{said}");
    assert_eq!(jobs(&service), Vec::<Value>::new());
    assert_eq!(objects(&service, "A900"), 1);
    // The association that has an object refused goes on with the next.
    let files = Directory::new("dimse-refused-files");
    let good = write(&files.0, "good.dcm", &parted::ungated(1));
    let (_, said) = dcmtk("storescu", &service, &["-v", "-nh"], &[projections.join("tomo-stress.dcm"), good]);
    assert!(said.contains("Received Store Response (Success)"), "{said}");
    assert_eq!(jobs(&service).len(), 1);
}

#[test]
fn who_is_not_on_the_list_is_rejected() {
    if !has_dcmtk() {
        return;
    }
    let data = Directory::new("dimse-callers");
    let service = service(&data, &["--dimse-calling-ae", "CAMERA,PACS 2"]);
    let (content, said) = dcmtk("echoscu", &service, &["-v"], &[]);
    assert!(!content && said.contains("Calling AE Title Not Recognized"), "{said}");
    let (content, said) = dcmtk("echoscu", &service, &["-aet", "PACS 2"], &[]);
    assert!(content, "{said}");
    let metrics = String::from_utf8(service.get("/metrics").body).unwrap();
    assert!(metrics.contains("ventricle_dimse_associations_total{outcome=\"rejected\"} 1"), "{metrics}");
}

#[test]
fn the_audit_log_tells_who_stored_what_from_where_and_who_was_rejected() {
    if !has_dcmtk() {
        return;
    }
    let (data, files) = (Directory::new("dimse-audit"), Directory::new("dimse-audit-files"));
    let (audit, log) = (data.0.join("audit.jsonl"), data.0.join("log"));
    let flags = ["--dimse-listen", "127.0.0.1:0", "--dimse-calling-ae", "CAMERA", "--dimse-owner", "ours"];
    let service = Served::start_logging(&data.0, &log, &[&flags[..], &["--audit-log", audit.to_str().unwrap()]].concat());
    let part = write(&files.0, "part.dcm", &parted::gates(&parted::whole(1))[0]);
    let study = write(&files.0, "study.dcm", &parted::ungated(2));
    let projections = parted::with(&parted::whole(3), &[(tags::IMAGE_TYPE, VR::CS, "ORIGINAL\\PRIMARY\\TOMO\\EMISSION")]);
    let none = parted::without(&projections, &[tags::SLICE_VECTOR, tags::FRAME_INCREMENT_POINTER]);
    dcmtk("storescu", &service, &["-nh", "-aet", "CAMERA"], &[part, study, write(&files.0, "none.dcm", &none)]);
    dcmtk("echoscu", &service, &["-aet", "ELSEWHERE"], &[]);
    let [job] = jobs(&service).try_into().unwrap();
    // The last is the look at the jobs.
    let told = audited(&audit, 5);
    let of = |field: &str| told[..4].iter().map(|line| line[field].clone()).collect::<Vec<Value>>();
    assert_eq!(of("what"), ["C-STORE", "C-STORE", "C-STORE", "A-ASSOCIATE"]);
    assert_eq!(of("who"), ["CAMERA", "CAMERA", "CAMERA", "ELSEWHERE"]);
    assert_eq!(of("owner"), [json!("ours"), json!("ours"), json!("ours"), Value::Null]);
    assert_eq!(of("address"), vec!["127.0.0.1"; 4]);
    assert_eq!(of("status"), [0, 0, 0xA900, 1]);
    assert_eq!(of("refused"), [Value::Null, Value::Null, json!("A900"), json!("calling AE title not recognized")]);
    assert_eq!(of("jobs"), [Value::Null, json!([job["id"]]), Value::Null, Value::Null], "a part makes none");
    let ids = of("request_id");
    assert!(ids[0] == ids[1] && ids[1] == ids[2] && ids[2] != ids[3], "one an association: {ids:?}");
    assert!(std::fs::read_to_string(&log).unwrap().contains(ids[0].as_str().unwrap()), "the other log has it too");
}

#[test]
fn an_object_beyond_the_limit_is_refused_and_the_association_goes_on() {
    if !has_dcmtk() {
        return;
    }
    let (data, files) = (Directory::new("dimse-large"), Directory::new("dimse-large-files"));
    let service = service(&data, &["--max-body-mb", "1", "--max-queued-mb", "1"]);
    let large = phantom::simulate(&Phantom::of(Shape::Ventricle(Ventricle::NORMAL))).unwrap().study;
    let file = write(&files.0, "large.dcm", &phantom::dicom::write(&large).unwrap());
    assert!(std::fs::metadata(&file).unwrap().len() > 1 << 20);
    let small = write(&files.0, "small.dcm", &parted::ungated(1));
    let (_, said) = dcmtk("storescu", &service, &["-d", "-nh"], &[file, small]);
    assert!(said.contains("0xa700") && said.contains("exceeds 1 MiB"), "{said}");
    assert_eq!((objects(&service, "A700"), objects(&service, "0000"), jobs(&service).len()), (1, 1, 1), "{said}");
}

#[test]
fn what_has_no_place_in_the_queue_is_to_come_again() {
    if !has_dcmtk() {
        return;
    }
    let (data, files) = (Directory::new("dimse-full"), Directory::new("dimse-full-files"));
    // One is worked on for a second or so, one waits.
    let service = service(&data, &["--max-queued-jobs", "1", "--workers", "1"]);
    let paths: Vec<PathBuf> = (1..=8).map(|seed| write(&files.0, &format!("{seed}.dcm"), &parted::ungated(seed))).collect();
    let (_, said) = dcmtk("storescu", &service, &["-d", "-nh"], &paths);
    assert!(said.contains("0xa700") && said.contains("The queue is full"), "{said}");
    let (stored, refused) = (objects(&service, "0000"), objects(&service, "A700"));
    assert!(stored >= 1 && refused >= 1 && stored + refused == 8, "{stored} stored, {refused} refused");
    assert_eq!(jobs(&service).len() as u64, stored);
}

#[test]
fn associations_are_encrypted_with_a_certificate_and_its_key() {
    if !has_dcmtk() {
        return;
    }
    let (data, files) = (Directory::new("dimse-tls"), Directory::new("dimse-tls-files"));
    let made = rcgen::generate_simple_self_signed(["127.0.0.1".to_owned(), "localhost".to_owned()]).unwrap();
    let certificate = write(&files.0, "cert.pem", made.cert.pem().as_bytes());
    let key = write(&files.0, "key.pem", made.signing_key.serialize_pem().as_bytes());
    let (certificate, key) = (certificate.to_str().unwrap(), key.to_str().unwrap());
    let service = service(&data, &["--dimse-tls-cert", certificate, "--dimse-tls-key", key]);
    let (content, said) = dcmtk("echoscu", &service, &["-v", "+tla", "+cf", certificate], &[]);
    assert!(content, "{said}");
    let (content, said) = dcmtk("echoscu", &service, &["-to", "5", "-ta", "5"], &[]);
    assert!(!content, "without TLS: {said}");
    let study = write(&files.0, "study.dcm", &parted::ungated(1));
    let (content, said) = dcmtk("storescu", &service, &["+tla", "+cf", certificate], &[study]);
    assert!(content, "{said}");
    assert_eq!(jobs(&service).len(), 1);
}

/// dcmtk's receiver on a free port, which puts what it gets into a folder; killed when dropped.
struct Receiver {
    child: Child,
    folder: Directory,
}

/// A port that was free a moment ago.
pub(crate) fn free_port() -> u16 {
    TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port()
}

impl Receiver {
    fn start(port: u16, flags: &[&str]) -> Self {
        let folder = Directory::new("storescp");
        let mut command = Command::new("storescp");
        command.args(flags).arg("-od").arg(&folder.0).arg(port.to_string()).stdout(Stdio::null()).stderr(Stdio::null());
        let child = command.spawn().unwrap();
        let start = Instant::now();
        while std::net::TcpStream::connect(("127.0.0.1", port)).is_err() {
            assert!(start.elapsed() < Duration::from_secs(10), "storescp does not listen");
            std::thread::sleep(Duration::from_millis(20));
        }
        Self { child, folder }
    }

    /// The one file that came, once it is there.
    fn received(&self, within: Duration) -> PathBuf {
        let start = Instant::now();
        loop {
            let files: Vec<PathBuf> = std::fs::read_dir(&self.folder.0).unwrap().map(|entry| entry.unwrap().path()).collect();
            if let [file] = files.as_slice() {
                // It is there before it is whole.
                std::thread::sleep(Duration::from_millis(300));
                return file.clone();
            }
            assert!(files.is_empty() && start.elapsed() < within, "after {within:?}: {files:?}");
            std::thread::sleep(Duration::from_millis(50));
        }
    }
}

impl Drop for Receiver {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

#[test]
fn the_structured_report_goes_to_a_receiver_also_if_that_comes_later() {
    if !has_dcmtk() {
        return;
    }
    let (data, port) = (Directory::new("dimse-send"), free_port());
    let destination = format!("dicom://ARCHIVE@127.0.0.1:{port}");
    let service = service(&data, &["--results-to", &destination, "--callback-allow", "127.0.0.1"]);
    let accepted = service.post("application/dicom", &parted::ungated(1));
    assert_eq!(accepted.status, 202);
    let job = accepted.json();
    succeeds(&service, &job);
    let start = Instant::now();
    while !String::from_utf8_lossy(&service.get("/metrics").body).contains("ventricle_results_sent_total{outcome=\"failed\"} 1") {
        assert!(start.elapsed() < Duration::from_secs(10), "no attempt failed while nobody was there");
        std::thread::sleep(Duration::from_millis(100));
    }
    // The second attempt comes after some ten seconds. Every byte of the data set is written as it came.
    let receiver = Receiver::start(port, &["-aet", "ARCHIVE", "+B"]);
    let received = receiver.received(Duration::from_secs(40));
    let sr = service.get(&format!("/v1/reconstructions/{}/sr.dcm", job["id"].as_str().unwrap()));
    let own = dicom_object::from_reader(sr.body.as_slice()).unwrap();
    assert_eq!(own.meta().media_storage_sop_class_uid.trim_end_matches('\0'), "1.2.840.10008.5.1.4.1.1.88.33");
    let data_set = &sr.body[128 + 4 + 12 + own.meta().information_group_length as usize..];
    assert!(data_set.len() > 10_000 && std::fs::read(&received).unwrap().ends_with(data_set));
    assert!(String::from_utf8_lossy(&service.get("/metrics").body).contains("ventricle_results_sent_total{outcome=\"delivered\"} 1"));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_receiver_of_the_default_encoding_alone_gets_it_in_that() {
    if !has_dcmtk() {
        return;
    }
    let file = parted::ungated(1);
    let title = |text| Title::parse(text).unwrap();
    for (flags, syntax) in [(&["+xi"][..], "1.2.840.10008.1.2"), (&["--max-pdu", "4096"], "1.2.840.10008.1.2.1")] {
        let port = free_port();
        let receiver = Receiver::start(port, flags);
        let stream = tokio::net::TcpStream::connect(("127.0.0.1", port)).await.unwrap();
        dimse::send(stream, &title("VENTRICLE"), &title("ANY"), &file).await.unwrap();
        let received = receiver.received(Duration::from_secs(5));
        let stored = dicom_object::open_file(&received).unwrap();
        assert_eq!(stored.meta().transfer_syntax.trim_end_matches('\0'), syntax);
        let sent = dicom_object::from_reader(file.as_slice()).unwrap();
        for tag in [tags::SOP_INSTANCE_UID, tags::ROWS, tags::IMAGE_TYPE, tags::PIXEL_DATA, tags::NUMBER_OF_FRAMES] {
            let bytes = |object: &dicom_object::DefaultDicomObject| object.element(tag).unwrap().to_bytes().unwrap().into_owned();
            assert_eq!(bytes(&stored), bytes(&sent), "{tag} {flags:?}");
        }
    }
    let port = free_port();
    let _refusing = Receiver::start(port, &["--refuse"]);
    let stream = tokio::net::TcpStream::connect(("127.0.0.1", port)).await.unwrap();
    let error = dimse::send(stream, &title("VENTRICLE"), &title("ANY"), &file).await.unwrap_err();
    assert!(matches!(error, dimse::SendError::Rejected(_)), "{error}");
}
