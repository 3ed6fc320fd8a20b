//! STOW-RS against a running service: what PACS send, in one request or many, and what they are told.

use crate::{
    parted::{self, GATES, SLICES},
    served::{Answer, Directory, Served, audited},
};
use dicom_core::VR;
use dicom_dictionary_std::tags;
use serde_json::{Value, json};
use std::{
    collections::BTreeSet,
    path::Path,
    time::{Duration, Instant},
};

/// What every service here gets: the time for a series to go quiet is short.
const FLAGS: [&str; 2] = ["--quiet-seconds", "1"];
const SOON: Duration = Duration::from_mins(1);

/// Posts files as PACS do: unquoted boundary of 73 characters, nothing before the first and nothing after the last.
fn store(service: &Served, files: &[impl AsRef<[u8]>]) -> Answer {
    store_at(service, "/dicom-web/studies", files)
}

fn store_at(service: &Served, path: &str, files: &[impl AsRef<[u8]>]) -> Answer {
    let boundary = "-".repeat(20) + &"b".repeat(53);
    let mut body = Vec::new();
    for file in files {
        let head = format!("--{boundary}\r\nContent-Type: application/dicom\r\nContent-Length: {}\r\n\r\n", file.as_ref().len());
        body.extend_from_slice(head.as_bytes());
        body.extend_from_slice(file.as_ref());
        body.extend_from_slice(b"\r\n");
    }
    body.extend_from_slice(format!("--{boundary}--").as_bytes());
    service.post_to(path, &format!("multipart/related; type=\"application/dicom\"; boundary={boundary}"), &body)
}

/// The instances of a sequence of the answer.
fn instances(answer: &Answer, sequence: &str) -> Vec<String> {
    let json = answer.json();
    let items = json[sequence]["Value"].as_array().cloned().unwrap_or_default();
    items.iter().map(|item| item["00081155"]["Value"][0].as_str().unwrap_or("?").to_owned()).collect()
}

fn reasons(answer: &Answer, sequence: &str) -> Vec<u64> {
    let json = answer.json();
    let items = json[sequence]["Value"].as_array().cloned().unwrap_or_default();
    items.iter().map(|item| item["00081197"]["Value"][0].as_u64().unwrap()).collect()
}

fn jobs(service: &Served, study_uid: &str) -> Vec<Value> {
    let list = service.get(&format!("/v1/reconstructions?study_instance_uid={study_uid}")).json();
    list["reconstructions"].as_array().unwrap().clone()
}

/// The line of the audit log about the one series that was put together when it was quiet.
fn of_assembly(log: &Path) -> Value {
    let start = Instant::now();
    loop {
        let mut lines = audited(log, 1).into_iter().filter(|line| line["what"] == "assembly");
        if let Some(line) = lines.next() {
            assert_eq!(lines.next(), None);
            return line;
        }
        assert!(start.elapsed() < SOON, "no series was put together");
        std::thread::sleep(Duration::from_millis(50));
    }
}

/// The jobs of a study once there are so many and all are finished.
fn finished(service: &Served, study_uid: &str, count: usize) -> Vec<Value> {
    let deadline = Instant::now() + SOON;
    loop {
        let jobs = jobs(service, study_uid);
        assert!(jobs.len() <= count, "{jobs:?}");
        if jobs.len() == count && jobs.iter().all(|job| ["succeeded", "failed"].contains(&job["state"].as_str().unwrap())) {
            return jobs;
        }
        assert!(Instant::now() < deadline, "{jobs:?}");
        std::thread::sleep(Duration::from_millis(50));
    }
}

/// What a report measured, without what names the job, its files and its time.
fn measured(service: &Served, job: &Value) -> Value {
    assert_eq!(job["state"], "succeeded", "{job}");
    let mut report = service.get(&format!("/v1/reconstructions/{}/report", job["id"].as_str().unwrap())).json();
    for gate in report["gates"].as_array_mut().unwrap() {
        // The lid has flat tetrahedra, whose sign is that of rounding.
        gate["wall"]["inverted_before"].take();
    }
    json!([report["function"], report["gates"], report["myocardium"]])
}

/// Equal, numbers to a millionth.
fn assert_close(one: &Value, other: &Value) {
    match (one, other) {
        (Value::Number(a), Value::Number(b)) => {
            let (a, b) = (a.as_f64().unwrap(), b.as_f64().unwrap());
            assert!((a - b).abs() <= 1e-6 * a.abs().max(1.0), "{a} and {b}");
        }
        (Value::Array(a), Value::Array(b)) if a.len() == b.len() => a.iter().zip(b).for_each(|(a, b)| assert_close(a, b)),
        (Value::Object(a), Value::Object(b)) if a.keys().eq(b.keys()) => a.values().zip(b.values()).for_each(|(a, b)| assert_close(a, b)),
        (one, other) => assert_eq!(one, other),
    }
}

#[test]
fn a_study_gives_the_same_report_whole_by_gates_and_by_slices() {
    let data = Directory::new("stow");
    let service = Served::start(&data.0, &FLAGS);
    let whole = parted::whole(1);
    let uid = parted::text_of(&whole, tags::STUDY_INSTANCE_UID);
    let of_study = |bytes: &[u8], number: usize| parted::with(bytes, &[(tags::STUDY_INSTANCE_UID, VR::UI, &format!("{uid}.{number}"))]);
    let answer = store(&service, &[of_study(&whole, 0)]);
    assert_eq!((answer.status, answer.media_type.as_str()), (200, "application/dicom+json"));
    assert_eq!(instances(&answer, "00081199"), [parted::text_of(&whole, tags::SOP_INSTANCE_UID)]);
    let expected = measured(&service, &finished(&service, &format!("{uid}.0"), 1)[0]);

    // A file a gate, each in a request of its own and the last one first.
    for (sent, file) in parted::gates(&whole).iter().rev().enumerate() {
        assert_eq!(jobs(&service, &format!("{uid}.1")).len(), 0, "{sent} of {GATES} gates are no study yet");
        assert_eq!(store(&service, &[of_study(file, 1)]).status, 200);
    }
    assert_eq!(jobs(&service, &format!("{uid}.1")).len(), 1, "complete by its own numbers: it does not wait to be quiet");
    assert_eq!(measured(&service, &finished(&service, &format!("{uid}.1"), 1)[0]), expected);

    // A file a slice, all in one request, to the study's own address.
    let files: Vec<_> = parted::slices(&whole).iter().map(|file| of_study(file, 2)).collect();
    let answer = store_at(&service, &format!("/dicom-web/studies/{uid}.2"), &files);
    assert_eq!((answer.status, instances(&answer, "00081199").len()), (200, GATES * SLICES));
    // The distance between slices is now that of their positions, which are rounded to nanometres.
    assert_close(&measured(&service, &finished(&service, &format!("{uid}.2"), 1)[0]), &expected);

    // The same again, whole or in part, is the same job; nothing waits.
    for (number, files) in [(0, vec![whole.clone()]), (1, parted::gates(&whole)), (2, parted::slices(&whole)[3..5].to_vec())] {
        let files: Vec<_> = files.iter().map(|file| of_study(file, number)).collect();
        // UIDs of instances are unique: those of the gates are known with their own study.
        assert_eq!(store(&service, &files).status, 200);
        assert_eq!(jobs(&service, &format!("{uid}.{number}")).len(), 1);
    }
    std::thread::sleep(Duration::from_millis(1500));
    assert_eq!(service.get("/v1/reconstructions").json()["reconstructions"].as_array().unwrap().len(), 3);
    service.kill();
    // Nothing that names the patient is on disk.
    for entry in std::fs::read_dir(&data.0).unwrap() {
        let bytes = std::fs::read(entry.unwrap().path()).unwrap();
        for name in ["PHANTOM", "Phantom^", "Myocardial perfusion"] {
            assert!(!bytes.windows(name.len()).any(|window| window == name.as_bytes()), "{name}");
        }
    }
}

#[test]
fn parts_that_do_not_say_how_many_they_are_wait_until_it_is_quiet() {
    let data = Directory::new("stow");
    let log = data.0.join("audit.jsonl");
    let service = Served::start(&data.0, &[&FLAGS[..], &["--audit-log", log.to_str().unwrap()]].concat());
    let whole = parted::whole(2);
    let uid = parted::text_of(&whole, tags::STUDY_INSTANCE_UID);
    let files: Vec<_> = parted::gates(&whole).iter().map(|file| parted::without(file, &[tags::NUMBER_OF_TIME_SLOTS])).collect();
    // All but one; then that one, late: the study is put together again.
    assert_eq!(store(&service, &files[1..]).status, 200);
    assert_eq!(jobs(&service, &uid).len(), 0);
    let first = finished(&service, &uid, 1);
    assert_eq!((&first[0]["state"], &first[0]["progress"]["gates_total"]), (&"succeeded".into(), &(GATES - 1).into()));
    let made = of_assembly(&log);
    assert_eq!((&made["jobs"], &made["owner"]), (&json!([first[0]["id"]]), &json!("anonymous")), "{made}");
    assert!(made["refused"].is_null() && made["address"].is_null(), "{made}");
    assert_eq!(store(&service, &files[..1]).status, 200);
    let both = finished(&service, &uid, 2);
    let gates: BTreeSet<u64> = both.iter().map(|job| job["progress"]["gates_total"].as_u64().unwrap()).collect();
    assert_eq!(gates, BTreeSet::from([GATES as u64 - 1, GATES as u64]));
    assert!(both.iter().all(|job| job["state"] == "succeeded"), "{both:?}");
}

#[test]
fn parts_that_make_no_study_are_a_failed_job_until_the_rest_comes() {
    let data = Directory::new("stow");
    let log = data.0.join("audit.jsonl");
    let flags = [&FLAGS[..], &["--audit-log", log.to_str().unwrap()]].concat();
    let mut service = Served::start(&data.0, &flags);
    let whole = parted::whole(3);
    let uid = parted::text_of(&whole, tags::STUDY_INSTANCE_UID);
    let mut files = parted::slices(&whole);
    let missing = files.remove(30);
    assert_eq!(store(&service, &files).status, 200);
    // What was answered for outlives the process.
    service.kill();
    service = Served::start(&data.0, &flags);
    let failed = finished(&service, &uid, 1);
    // No request made it; who looks for it in the audit log finds it all the same.
    let made = of_assembly(&log);
    assert_eq!((&made["jobs"], &made["refused"]), (&json!([failed[0]["id"]]), &json!("inconsistent_frames")), "{made}");
    assert_eq!((&failed[0]["state"], &failed[0]["error"]["code"]), (&"failed".into(), &"inconsistent_frames".into()), "{failed:?}");
    assert!(failed[0]["error"]["detail"].as_str().unwrap().contains("missing"), "{failed:?}");
    assert!(failed[0]["expires_at"].is_string());
    assert_eq!(store(&service, &[missing]).status, 200);
    let jobs = finished(&service, &uid, 2);
    let states: BTreeSet<&str> = jobs.iter().map(|job| job["state"].as_str().unwrap()).collect();
    assert_eq!(states, BTreeSet::from(["failed", "succeeded"]));
}

#[test]
fn rest_and_stress_and_ungated_beside_gated_are_jobs_of_their_own() {
    let data = Directory::new("stow");
    let log = data.0.join("audit.jsonl");
    let service = Served::start(&data.0, &[&FLAGS[..], &["--audit-log", log.to_str().unwrap()]].concat());
    let rest = parted::whole(4);
    let uid = parted::text_of(&rest, tags::STUDY_INSTANCE_UID);
    let of_study = |bytes: Vec<u8>| parted::with(&bytes, &[(tags::STUDY_INSTANCE_UID, VR::UI, &uid)]);
    let (stress, ungated) = (of_study(parted::whole(5)), of_study(parted::ungated(4)));
    let answer = store(&service, &[rest, ungated, stress]);
    assert_eq!((answer.status, instances(&answer, "00081199").len()), (200, 3));
    let jobs = finished(&service, &uid, 3);
    let told = audited(&log, 1)[0]["jobs"].clone();
    let told: BTreeSet<&str> = told.as_array().unwrap().iter().map(|id| id.as_str().unwrap()).collect();
    assert_eq!(told, jobs.iter().map(|job| job["id"].as_str().unwrap()).collect(), "the line of the request has all that it made");
    let mut gates: Vec<u64> = jobs.iter().map(|job| job["progress"]["gates_total"].as_u64().unwrap()).collect();
    gates.sort_unstable();
    assert_eq!(gates, [1, GATES as u64, GATES as u64]);
    assert!(jobs.iter().all(|job| job["state"] == "succeeded"), "{jobs:?}");
}

#[test]
fn what_is_refused_is_named_with_its_reason_and_stored_nowhere() {
    let data = Directory::new("stow");
    let service = Served::start(&data.0, &FLAGS);
    let good = parted::whole(6);
    let uid = parted::text_of(&good, tags::STUDY_INSTANCE_UID);
    let ct = parted::with(
        &good,
        &[
            (tags::SOP_CLASS_UID, VR::UI, "1.2.840.10008.5.1.4.1.1.2"),
            (tags::MODALITY, VR::CS, "CT"),
            (tags::SOP_INSTANCE_UID, VR::UI, "1.2.3.1"),
        ],
    );
    let projections = parted::with(
        &good,
        &[(tags::IMAGE_TYPE, VR::CS, "ORIGINAL\\PRIMARY\\TOMO\\EMISSION"), (tags::SOP_INSTANCE_UID, VR::UI, "1.2.3.2")],
    );
    let projections = parted::without(&projections, &[tags::SLICE_VECTOR, tags::FRAME_INCREMENT_POINTER]);
    let cut = &good[..good.len() - 100];
    let answer = store(&service, &[&ct, &good, &projections, cut, b"no DICOM at all"]);
    assert_eq!((answer.status, instances(&answer, "00081199").len()), (202, 1));
    assert_eq!(instances(&answer, "00081198"), ["1.2.3.1", "1.2.3.2"]);
    assert_eq!(reasons(&answer, "00081198"), [0x0122, 0xA900]);
    assert_eq!(reasons(&answer, "0008119A"), [0xC000, 0xC000]);
    let comment = &answer.json()["00081198"]["Value"][0]["00000902"]["Value"][0];
    assert!(comment.as_str().unwrap().contains("CT Image Storage"), "{comment}");

    let answer = store(&service, &[ct]);
    assert_eq!((answer.status, answer.media_type.as_str()), (409, "application/dicom+json"));
    // Another study than the address says; another image under the same UID.
    assert_eq!(reasons(&store_at(&service, "/dicom-web/studies/1.2.3", &[&good]), "00081198"), [0xA900]);
    let changed = parted::with(&good, &[(tags::HEART_RATE, VR::IS, "61")]);
    let answer = store(&service, &[changed]);
    assert_eq!((answer.status, reasons(&answer, "00081198")), (409, vec![0x0110]));
    assert_eq!(store(&service, &[&good]).status, 200);
    let series = |outcome: &str| format!("ventricle_instances_received_total{{way=\"stow\",outcome=\"{outcome}\"}}");
    let counted = ["study", "known", "conflict", "refused", "part"].map(|outcome| service.metric(&series(outcome)) as u64);
    assert_eq!(counted, [1, 1, 1, 6, 0]);
    finished(&service, &uid, 1);
    assert_eq!(service.get("/v1/reconstructions").json()["reconstructions"].as_array().unwrap().len(), 1);

    // With its job deleted the instance is as new.
    let job = jobs(&service, &uid)[0]["id"].as_str().unwrap().to_owned();
    service.delete(&format!("/v1/reconstructions/{job}"));
    assert_eq!(store(&service, &[good]).status, 200);
    assert_ne!(finished(&service, &uid, 1)[0]["id"], job.as_str());
}

#[test]
fn bodies_are_taken_as_clients_send_them_and_bounded() {
    let data = Directory::new("stow");
    let flags = [FLAGS.as_slice(), &["--max-body-mb", "1", "--max-study-mb", "3"]].concat();
    let service = Served::start(&data.0, &flags);
    let good = parted::whole(7);
    // One file as a body, whatever it is called.
    for media_type in ["application/dicom", "application/x-www-form-urlencoded", "application/octet-stream"] {
        assert_eq!(service.post_to("/dicom-web/studies", media_type, &good).status, 200, "{media_type}");
    }
    let refused = |media_type: &str, body: &[u8]| {
        let answer = service.post_to("/dicom-web/studies", media_type, body);
        (answer.status, answer.json()["code"].as_str().unwrap_or_default().to_owned())
    };
    let problem = |status: u16, code: &str| (status, code.to_owned());
    assert_eq!(refused("multipart/related", b"--x--"), problem(400, "malformed_multipart"));
    assert_eq!(refused("multipart/related; boundary=x", b"--x--"), problem(400, "empty_body"));
    assert_eq!(
        refused("multipart/related; boundary=x", b"--x\r\nContent-Type: application/dicom\r\n\r\ncut"),
        problem(400, "malformed_multipart")
    );
    assert_eq!(refused("application/dicom", &vec![0; 2 << 20]), problem(413, "too_large"));
    let large = [b"--x\r\nContent-Type: application/dicom\r\n\r\n".as_slice(), &vec![0; 2 << 20], b"\r\n--x--"].concat();
    assert_eq!(refused("multipart/related; boundary=x", &large), problem(413, "too_large"));
    let parts = [b"--x\r\nContent-Type: application/dicom\r\n\r\n".as_slice(), &vec![0; 900 << 10], b"\r\n"].concat().repeat(4);
    assert_eq!(refused("multipart/related; boundary=x", &[parts.as_slice(), b"--x--"].concat()), problem(413, "too_large"));
    assert_eq!(refused("multipart/related; boundary=x", &vec![b'x'; 2 << 20]), problem(400, "malformed_multipart"));
    for endless in [b"X-Header: value\r\n".as_slice(), b"no header at all "] {
        let body = [b"--x\r\n".as_slice(), &endless.repeat((2 << 20) / endless.len())].concat();
        assert_eq!(refused("multipart/related; boundary=x", &body), problem(400, "malformed_multipart"));
    }
    let before = [b"preamble ".repeat(200_000), b"\r\n--x--".to_vec()].concat();
    assert_eq!(refused("multipart/related; boundary=x", &before).0, 400);
    assert!(service.peak_mib() < 200.0, "{}", service.peak_mib());
    assert_eq!(service.get("/dicom-web/studies").status, 405);
    // Who sends much to nowhere may find the connection closed before the answer is read.
    let nowhere = |path: &str| service.post_to(path, "multipart/related; type=\"application/dicom\"; boundary=x", b"--x--").status;
    assert_eq!(nowhere("/dicom-web/studies/no-uid"), 404);
    let xml = service.post_accepting("/dicom-web/studies", "application/dicom", &good, "application/dicom+xml");
    assert_eq!((xml.status, xml.json()["code"].as_str().unwrap()), (406, "not_acceptable"));
    assert_eq!(service.post_accepting("/dicom-web/studies", "application/dicom", &good, "*/*").status, 200);
    // A slash at the end changes nothing, and leads nobody elsewhere.
    let uid = parted::text_of(&good, tags::STUDY_INSTANCE_UID);
    for path in ["/dicom-web/studies/".to_owned(), format!("/dicom-web/studies/{uid}"), format!("/dicom-web/studies/{uid}/")] {
        let answer = store_at(&service, &path, &[&good]);
        assert_eq!((answer.status, instances(&answer, "00081199").len()), (200, 1), "{path}");
    }
    assert_eq!(reasons(&store_at(&service, "/dicom-web/studies/1.2.3/", &[&good]), "00081198"), [0xA900]);
    assert_eq!((service.get("/dicom-web/studies/").status, nowhere("/dicom-web/studies//")), (405, 404));
    assert_eq!(service.get("/v1/reconstructions").json()["reconstructions"].as_array().unwrap().len(), 1);
}

#[test]
fn a_full_queue_is_told_so_that_a_pacs_sends_again() {
    let data = Directory::new("stow");
    let service = Served::start(&data.0, &["--max-queued-jobs", "1", "--workers", "1"]);
    let mut refused = 0;
    let mut stored = 0;
    for seed in 10..14 {
        let file = parted::whole(seed);
        let deadline = Instant::now() + SOON;
        loop {
            let answer = store(&service, &[&file]);
            if answer.status == 200 {
                stored += 1;
                break;
            }
            assert_eq!((answer.status, answer.json()["code"].as_str().unwrap()), (503, "queue_full"));
            refused += 1;
            assert!(Instant::now() < deadline);
            std::thread::sleep(Duration::from_millis(100));
        }
    }
    assert!(refused > 0 && stored == 4, "{refused} refused, {stored} stored");
}
