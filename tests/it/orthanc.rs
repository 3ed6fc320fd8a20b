//! Orthanc as it is installed from Debian, as a client and as an archive: what it sends by STOW-RS and C-STORE, what it makes of the answers, and the
//! structured reports that it gets back. It runs with the configuration of `deploy/orthanc`.

mod archive;

use crate::{
    dimse::write,
    http::archived::{assert_dciodvfy, dsrdump, highdicom},
    parted::{self, GATES},
    served::{Directory, Served},
};
use archive::{Orthanc, Ports, is_installed};
use dicom_core::VR;
use dicom_dictionary_std::tags;
use serde_json::{Value, json};
use std::{
    io::{Read, Write},
    net::{Shutdown, TcpListener, TcpStream},
    path::PathBuf,
    process::Command,
    sync::{Arc, Mutex},
    time::{Duration, Instant},
};

const SOON: Duration = Duration::from_mins(1);

fn all(files: &Directory, name: &str, contents: &[Vec<u8>]) -> Vec<PathBuf> {
    contents.iter().enumerate().map(|(index, bytes)| write(&files.0, &format!("{name}-{index}.dcm"), bytes)).collect()
}

/// All jobs of the service, newest first, once so many are there and finished.
fn finished(service: &Served, count: usize) -> Vec<Value> {
    let start = Instant::now();
    loop {
        let jobs = service.get("/v1/reconstructions").json()["reconstructions"].as_array().unwrap().clone();
        assert!(jobs.len() <= count, "{jobs:#?}");
        if jobs.len() == count && jobs.iter().all(|job| job["finished_at"].is_string()) {
            return jobs;
        }
        assert!(start.elapsed() < SOON, "{jobs:#?}");
        std::thread::sleep(Duration::from_millis(50));
    }
}

/// That the service has these many jobs, all of which succeed.
fn assert_succeeded(service: &Served, count: usize) {
    for job in finished(service, count) {
        assert_eq!(job["state"], "succeeded", "{job}");
    }
}

/// What belongs to a study and is no gated reconstruction: a CT, projections, and a reconstruction that contradicts itself.
fn others_of(good: &[u8]) -> [Vec<u8>; 3] {
    let ct = [
        (tags::SOP_CLASS_UID, VR::UI, "1.2.840.10008.5.1.4.1.1.2"),
        (tags::MODALITY, VR::CS, "CT"),
        (tags::SOP_INSTANCE_UID, VR::UI, "1.2.3.1"),
        (tags::SERIES_INSTANCE_UID, VR::UI, "1.2.3.1.1"),
    ];
    let projections = [
        (tags::IMAGE_TYPE, VR::CS, "ORIGINAL\\PRIMARY\\TOMO\\EMISSION"),
        (tags::SOP_INSTANCE_UID, VR::UI, "1.2.3.2"),
        (tags::SERIES_INSTANCE_UID, VR::UI, "1.2.3.2.1"),
    ];
    let contradictory = [
        (tags::NUMBER_OF_FRAMES, VR::IS, "7"),
        (tags::SOP_INSTANCE_UID, VR::UI, "1.2.3.3"),
        (tags::SERIES_INSTANCE_UID, VR::UI, "1.2.3.3.1"),
    ];
    let projections = parted::without(&parted::with(good, &projections), &[tags::SLICE_VECTOR, tags::FRAME_INCREMENT_POINTER]);
    [parted::with(good, &ct), projections, parted::with(good, &contradictory)]
}

#[test]
fn a_study_is_forwarded_chunked_and_with_its_length_and_is_one_job() {
    if !is_installed() {
        return;
    }
    let (data, files) = (Directory::new("forward"), Directory::new("forward-files"));
    let service = Served::start(&data.0, &["--quiet-seconds", "3600"]);
    let relay = Relay::to(&service.url);
    let orthanc = Orthanc::start(Ports::free(), &relay.url, 1);
    orthanc.put("/dicom-web/servers/plain", &json!({ "Url": format!("{}/dicom-web/", relay.url), "ChunkedTransfers": false }));
    // One file, and a file a gate.
    let (whole, gates) = (parted::whole(40), parted::gates(&parted::whole(41)));
    orthanc.receive(&all(&files, "whole", std::slice::from_ref(&whole)));
    orthanc.receive(&all(&files, "gate", &gates));
    let studies = [&whole, &gates[0]].map(|file| orthanc.study(&parted::text_of(file, tags::STUDY_INSTANCE_UID)));
    orthanc.assert_succeeds(&orthanc.forward("ventricle", &[&studies[0]]));
    orthanc.assert_succeeds(&orthanc.forward("plain", &[&studies[1]]));
    assert_succeeded(&service, 2);
    // The other way round, everything again, both in one request.
    orthanc.assert_succeeds(&orthanc.forward("plain", &[&studies[0]]));
    orthanc.assert_succeeds(&orthanc.forward("ventricle", &[&studies[1]]));
    orthanc.assert_succeeds(&orthanc.forward("ventricle", &[&studies[0], &studies[1]]));
    assert_succeeded(&service, 2);

    let heads = relay.heads();
    let sent: Vec<bool> = heads.iter().map(|head| head.contains("transfer-encoding: chunked")).collect();
    assert_eq!(sent, [true, false, false, true, true], "{heads:#?}");
    for (head, chunked) in heads.iter().zip(sent) {
        assert!(head.starts_with("post /dicom-web/studies http/1.1") && head.contains("content-length: ") != chunked, "{head}");
        let boundary = head.split("boundary=").nth(1).and_then(|rest| rest.lines().next()).unwrap();
        assert!(boundary.len() == 73 && !boundary.contains('"'), "{head}");
    }
}

#[test]
fn what_is_refused_fails_orthanc_s_job_and_one_without_it_succeeds() {
    if !is_installed() {
        return;
    }
    let (data, files) = (Directory::new("refusing"), Directory::new("refusing-files"));
    let service = Served::start(&data.0, &[]);
    let orthanc = Orthanc::start(Ports::free(), &service.url, 1);
    let good = parted::whole(42);
    orthanc.receive(&all(&files, "study", &[[good.clone()].as_slice(), &others_of(&good)].concat()));
    let study = orthanc.study(&parted::text_of(&good, tags::STUDY_INSTANCE_UID));
    let first = orthanc.forward("ventricle", &[&study]);
    let job = orthanc.ended(&first);
    assert_eq!(job["State"], "Failure", "{job:#}");
    let details = job["Content"]["FunctionErrorDetails"].as_str().unwrap_or_default();
    assert!(details.contains("only able to receive 1 instances out of 4"), "{job:#}");
    assert_succeeded(&service, 1);

    for uid in ["1.2.3.1", "1.2.3.2", "1.2.3.3"] {
        let [instance] = orthanc.find("Instance", &json!({ "SOPInstanceUID": uid })).try_into().unwrap();
        // By itself it is refused altogether.
        assert_eq!(orthanc.ended(&orthanc.forward("ventricle", &[&instance]))["State"], "Failure", "{uid}");
        orthanc.delete(&format!("/instances/{instance}"));
    }
    // A resubmitted job names what it named before, which is not there any more: a new one is needed.
    orthanc.resubmit(&first);
    assert_eq!(orthanc.ended(&first)["State"], "Failure");
    orthanc.assert_succeeds(&orthanc.forward("ventricle", &[&study]));
    assert_succeeded(&service, 1);
}

#[test]
fn a_job_that_found_nobody_succeeds_when_it_is_submitted_again() {
    if !is_installed() {
        return;
    }
    let (data, files) = (Directory::new("resubmit"), Directory::new("resubmit-files"));
    let service = Served::start(&data.0, &[]);
    let (url, listen) = (service.url.clone(), service.url.trim_start_matches("http://").to_owned());
    let orthanc = Orthanc::start(Ports::free(), &url, 1);
    let good = parted::whole(43);
    orthanc.receive(&all(&files, "study", std::slice::from_ref(&good)));
    let study = orthanc.study(&parted::text_of(&good, tags::STUDY_INSTANCE_UID));
    service.kill();
    let job = orthanc.forward("ventricle", &[&study]);
    assert_eq!(orthanc.ended(&job)["State"], "Failure");
    let service = Served::start_at(&data.0, &listen, &[]);
    assert_succeeded(&service, 0);
    orthanc.resubmit(&job);
    orthanc.assert_succeeds(&job);
    assert_succeeded(&service, 1);
}

/// The structured report that Orthanc has of a study, filed with its images, once it is there.
fn report_in(orthanc: &Orthanc, uid: &str) -> Vec<u8> {
    let start = Instant::now();
    let instance = loop {
        if let [instance] = orthanc.find("Instance", &json!({ "StudyInstanceUID": uid, "Modality": "SR" })).as_slice() {
            break instance.clone();
        }
        assert!(start.elapsed() < SOON, "no report came:\n{}", orthanc.log());
        std::thread::sleep(Duration::from_millis(100));
    };
    assert_eq!(orthanc.get(&format!("/instances/{instance}/study")).json()["ID"], orthanc.study(uid).as_str());
    orthanc.get(&format!("/instances/{instance}/file")).body
}

/// The data set of a file, without its head.
fn data_set(file: &[u8]) -> &[u8] {
    let meta = dicom_object::FileMetaTable::from_reader(&file[128..]).unwrap();
    &file[128 + 4 + 12 + meta.information_group_length as usize..]
}

/// The data set of a file, every sequence in one and the same encoding: what Orthanc receives by association it writes with lengths of its own.
fn encoded(file: &[u8], folder: &Directory, name: &str) -> Vec<u8> {
    let (from, to) = (write(&folder.0, name, file), folder.0.join(format!("{name}.converted")));
    let converted = Command::new("dcmconv").args(["+te", "+e"]).args([&from, &to]).output().unwrap();
    assert!(converted.status.success(), "{}", String::from_utf8_lossy(&converted.stderr));
    data_set(&std::fs::read(to).unwrap()).to_vec()
}

#[test]
fn a_study_comes_by_association_and_its_report_goes_back_into_the_study() {
    if !is_installed() {
        return;
    }
    let (data, files, ports) = (Directory::new("home"), Directory::new("home-files"), Ports::free());
    let destination = format!("dicom://ORTHANC@127.0.0.1:{}", ports.dicom);
    let flags = [
        "--keep-patient",
        "--dimse-listen",
        "127.0.0.1:0",
        "--dimse-calling-ae",
        "ORTHANC",
        "--callback-allow",
        "127.0.0.1",
        "--results-to",
    ];
    let service = Served::start(&data.0, &[flags.as_slice(), &[&destination]].concat());
    let orthanc = Orthanc::start(ports, &service.url, service.dimse_port);
    let gates = parted::gates(&parted::whole(44));
    orthanc.receive(&all(&files, "gate", &gates));
    let uid = parted::text_of(&gates[0], tags::STUDY_INSTANCE_UID);
    orthanc.assert_succeeds(&orthanc.associate("ventricle", &[&orthanc.study(&uid)]));
    assert_succeeded(&service, 1);
    let received = report_in(&orthanc, &uid);

    let job = finished(&service, 1)[0]["id"].as_str().unwrap().to_owned();
    let sr = service.get(&format!("/v1/reconstructions/{job}/sr.dcm")).body;
    assert!(sr.len() > 10_000 && encoded(&sr, &files, "sent") == encoded(&received, &files, "received"));
    let file = write(&files.0, "sr.dcm", &received);
    assert_dciodvfy(&file, "ComprehensiveSR");
    dsrdump(&file);
    let Some(read) = highdicom(&file) else { return };
    let function = service.get(&format!("/v1/reconstructions/{job}/report")).json()["function"].clone();
    let left_ventricle = &read["groups"][0]["measurements"];
    for (code, name) in [("8821-1/LN", "edv_ml"), ("8823-7/LN", "esv_ml"), ("70822001/SCT", "ef_percent")] {
        assert!(function[name].is_number() && left_ventricle[code]["exact"] == function[name], "{name}: {left_ventricle:#} {function}");
    }
    assert_eq!(read["evidence"].as_array().unwrap().len(), GATES);
}

#[test]
fn a_report_comes_to_orthanc_by_stow_rs() {
    if !is_installed() {
        return;
    }
    let (data, files, ports) = (Directory::new("stowed"), Directory::new("stowed-files"), Ports::free());
    let destination = format!("http://127.0.0.1:{}/dicom-web/studies", ports.http);
    // One line end more than the value: as an editor leaves it.
    let authorization = write(&files.0, "authorization", format!("{}\n", ports.authorization()).as_bytes());
    let flags = ["--keep-patient", "--callback-allow", "127.0.0.1", "--results-to", &destination];
    let service = Served::start(&data.0, &[&flags[..], &["--results-authorization-file", authorization.to_str().unwrap()]].concat());
    let orthanc = Orthanc::start(ports, &service.url, 1);
    let good = parted::whole(45);
    orthanc.receive(&all(&files, "study", std::slice::from_ref(&good)));
    let uid = parted::text_of(&good, tags::STUDY_INSTANCE_UID);
    orthanc.assert_succeeds(&orthanc.forward("ventricle", &[&orthanc.study(&uid)]));
    let received = report_in(&orthanc, &uid);
    let job = finished(&service, 1)[0]["id"].as_str().unwrap().to_owned();
    let sr = service.get(&format!("/v1/reconstructions/{job}/sr.dcm")).body;
    assert!(sr.len() > 10_000 && data_set(&sr) == data_set(&received), "{} and {} bytes", sr.len(), received.len());
    let start = Instant::now();
    while !String::from_utf8_lossy(&service.get("/metrics").body).contains("ventricle_results_sent_total{outcome=\"delivered\"} 1") {
        assert!(start.elapsed() < SOON, "Orthanc's answer did not count as received");
        std::thread::sleep(Duration::from_millis(50));
    }
}

#[test]
fn the_deployed_configuration_forwards_what_is_gated_by_itself_and_again_when_nobody_was_there() {
    if !is_installed() {
        return;
    }
    let (data, files, ports) = (Directory::new("deployed"), Directory::new("deployed-files"), Ports::free());
    let destination = format!("dicom://ORTHANC@127.0.0.1:{}", ports.dicom);
    let flags = ["--keep-patient", "--callback-allow", "127.0.0.1", "--results-to", &destination];
    let service = Served::start(&data.0, &flags);
    let listen = service.url.trim_start_matches("http://").to_owned();
    let hurried = [("ORTHANC_STABLE_AGE", "1"), ("FORWARD_PAUSE_SECONDS", "1")];
    let mut orthanc = Orthanc::start_with(ports, &service.url, 1, &hurried);
    let good = parted::whole(46);
    let others = others_of(&good);
    orthanc.receive(&all(&files, "study", &[[good.clone()].as_slice(), &others[..2]].concat()));
    assert_succeeded(&service, 1);
    let uid = parted::text_of(&good, tags::STUDY_INSTANCE_UID);
    let sr = report_in(&orthanc, &uid);
    // The report, too, is a series that becomes stable; it is not sent.
    let start = Instant::now();
    while stable_series(&orthanc) < 4 {
        assert!(start.elapsed() < SOON, "{}", orthanc.log());
        std::thread::sleep(Duration::from_millis(100));
    }
    assert_eq!(orthanc.forwarded(), ["Success"]);

    // Ventricle is away when the next one comes, and Orthanc is restarted before it is back, and before it calls a third one stable.
    service.kill();
    let next = parted::gates(&parted::whole(47));
    orthanc.receive(&all(&files, "next", &next));
    let start = Instant::now();
    while !orthanc.log().contains("was not taken, again in 1 s") {
        assert!(start.elapsed() < SOON, "{}", orthanc.log());
        std::thread::sleep(Duration::from_millis(100));
    }
    orthanc.receive(&all(&files, "last", &[parted::whole(48)]));
    orthanc.restart();
    let service = Served::start_at(&data.0, &listen, &flags);
    assert_succeeded(&service, 3);
    let other = report_in(&orthanc, &parted::text_of(&next[0], tags::STUDY_INSTANCE_UID));
    assert_ne!(data_set(&other), data_set(&sr));
    let log = orthanc.log();
    let [report] = orthanc.find("Series", &json!({ "StudyInstanceUID": uid, "Modality": "SR" })).try_into().unwrap();
    assert!(!log.contains(&format!("series {report}")), "{log}");
    assert!(!log.lines().any(|line| line.contains("Forward") && line.contains("PHANTOM")), "{log}");
}

/// How many series have become stable so far.
fn stable_series(orthanc: &Orthanc) -> usize {
    let changes = orthanc.get("/changes?limit=1000").json();
    changes["Changes"].as_array().unwrap().iter().filter(|change| change["ChangeType"] == "StableSeries").count()
}

/// Passes connections on and keeps the head of each request, in lower case. A connection carries one request, as Orthanc does it.
struct Relay {
    url: String,
    heads: Arc<Mutex<Vec<String>>>,
}

impl Relay {
    fn to(url: &str) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let relay = Self { url: format!("http://{}", listener.local_addr().unwrap()), heads: Arc::default() };
        let (target, heads) = (url.trim_start_matches("http://").to_owned(), Arc::clone(&relay.heads));
        // Ends with the tests' process, as it waits for connections.
        std::thread::spawn(move || {
            for client in listener.incoming() {
                let (target, heads) = (target.clone(), Arc::clone(&heads));
                std::thread::spawn(move || pass(client.unwrap(), &target, &heads));
            }
        });
        relay
    }

    fn heads(&self) -> Vec<String> {
        self.heads.lock().unwrap().clone()
    }
}

fn pass(mut client: TcpStream, target: &str, heads: &Mutex<Vec<String>>) {
    let mut server = TcpStream::connect(target).unwrap();
    let (mut back, mut answered) = (server.try_clone().unwrap(), client.try_clone().unwrap());
    let answers = std::thread::spawn(move || {
        let _ = std::io::copy(&mut back, &mut answered);
        let _ = answered.shutdown(Shutdown::Both);
    });
    let (mut head, mut buffer) = (Some(Vec::new()), vec![0; 64 << 10]);
    while let Ok(length @ 1..) = client.read(&mut buffer) {
        if let Some(mut bytes) = head.take() {
            bytes.extend_from_slice(&buffer[..length]);
            match bytes.windows(4).position(|end| end == b"\r\n\r\n") {
                Some(end) => heads.lock().unwrap().push(String::from_utf8_lossy(&bytes[..end]).to_lowercase()),
                None => head = Some(bytes),
            }
        }
        if server.write_all(&buffer[..length]).is_err() {
            break;
        }
    }
    let _ = server.shutdown(Shutdown::Write);
    let _ = answers.join();
}
