//! Results for PACS and health records: what other programs' validators and readers say of them, what they hold of the patient, and when there
//! are none.

use super::harness::{Answer, Service, failing, idle, with, working};
use crate::{conformance::assert_as_stated, shared::absent};
use dicom_core::{DataElement, PrimitiveValue, Tag, VR};
use dicom_object::{DefaultDicomObject, InMemDicomObject};
use serde_json::Value;
use std::{
    path::{Path, PathBuf},
    process::{Command, Output},
};
use ventricle::{
    archive::{self, Finished},
    jobs::{StoreSettings, WorkerSettings},
    phantom::{self, Phantom},
    report::Report,
    subject::{Attribute, Subject},
};

/// A service that reconstructs, and keeps whom studies are of if so wished.
pub(super) async fn reconstructing(keep_patient: bool) -> Service {
    with(StoreSettings::default(), Some(WorkerSettings::default().work), |state| state.with_patients_kept(keep_patient)).await
}

/// The demo's ventricle at four gates.
pub(super) fn beating() -> Phantom {
    let mut phantom = Phantom::demo();
    phantom.imaging.gates = 4;
    phantom
}

pub(super) fn dicom(phantom: &Phantom) -> Vec<u8> {
    phantom::dicom::write(&phantom::simulate(phantom).unwrap().study).unwrap()
}

/// Reconstructs a file and returns the path of its job.
pub(super) async fn reconstructed(service: &Service, file: Vec<u8>) -> String {
    let accepted = service.post("", &[], file).await;
    assert_eq!(accepted.status, 202, "{}", accepted.json());
    let path = accepted.header("location").to_owned();
    for _ in 0..20 {
        let job = service.call("GET", &path, &[("prefer", "wait=30")]).await.json();
        if job["state"] == "succeeded" {
            return path;
        }
        assert_ne!(job["state"], "failed", "{job}");
    }
    panic!("{path} did not end");
}

/// A result that is there.
pub(super) async fn result(service: &Service, path: &str, media_type: &str) -> Answer {
    let answer = service.get(path).await;
    assert_eq!(answer.status, 200, "{path}: {}", String::from_utf8_lossy(&answer.bytes));
    assert_eq!(answer.header("content-type"), media_type);
    answer
}

fn scratch(name: &str, bytes: &[u8]) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("archived");
    std::fs::create_dir_all(&folder).unwrap();
    let path = folder.join(name);
    std::fs::write(&path, bytes).unwrap();
    path
}

fn run(program: &str, arguments: &[&str], path: &Path) -> Option<Output> {
    Command::new(program).args(arguments).arg(path).output().ok()
}

fn said(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned() + &String::from_utf8_lossy(&output.stdout)
}

/// That `dciodvfy` takes a file for an object of this kind and finds nothing wrong with it.
pub(crate) fn assert_dciodvfy(path: &Path, kind: &str) {
    let Some(output) = run("dciodvfy", &[], path) else { return absent("dicom3tools") };
    let said = said(&output);
    assert!(said.lines().any(|line| line == kind), "{}: {said}", path.display());
    // It cannot know our own codes, and wishes for what is empty where no patient is kept.
    let expected =
        ["<99VENTRICLE> for value 1 of attribute <Coding Scheme Designator>", "of attribute <Coding Scheme UID>", "to build DICOMDIR"];
    let others: Vec<&str> = said.lines().filter(|line| *line != kind && !expected.iter().any(|known| line.contains(known))).collect();
    assert!(others.is_empty(), "{}: {others:#?}", path.display());
}

/// That `dsrdump` prints the document without complaint; what it prints.
pub(crate) fn dsrdump(path: &Path) -> Option<String> {
    let Some(output) = run("dsrdump", &["--print-all-codes"], path) else {
        absent("dcmtk");
        return None;
    };
    let said = said(&output);
    // Its checks of single values do not know UTF-8.
    let complaint =
        |line: &&str| line.starts_with("E: ") || line.starts_with("W: ") && !line.contains("Specific Character Set: ISO_IR 192");
    assert!(output.status.success() && said.lines().find(complaint).is_none(), "{said}");
    Some(said)
}

/// What highdicom reads from a structured report.
pub(crate) fn highdicom(path: &Path) -> Option<Value> {
    let tools = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/tools");
    let python = tools.join(".venv/bin/python");
    if !python.exists() {
        absent("python3-venv");
        return None;
    }
    let output = Command::new(python).arg(tools.join("read-sr.py")).arg(path).output().unwrap();
    assert!(output.status.success(), "{}", said(&output));
    Some(serde_json::from_slice(&output.stdout).unwrap())
}

/// What the FHIR validator finds in a bundle; `None` where it is not installed.
fn fhir_findings(path: &Path) -> Option<(bool, Value)> {
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/tools/validate-fhir.mjs");
    match run("node", &[script], path) {
        Some(output) if output.status.code() != Some(2) => {
            let found: Value = serde_json::from_slice(&output.stdout).unwrap_or_else(|_| panic!("{}", said(&output)));
            Some((output.status.success(), found["messages"].clone()))
        }
        _ => {
            absent("nodejs");
            None
        }
    }
}

fn assert_fhir(path: &Path) {
    let Some((valid, messages)) = fhir_findings(path) else { return };
    let serious = messages.as_array().unwrap().iter().filter(|message| message["severity"] != "info" && message["severity"] != "warning");
    assert!(valid && serious.count() == 0, "{messages:#}");
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or_else(|| panic!("{value} is no number"))
}

/// Measurements of a group, by code: as a decimal string rounds them, and exactly.
fn assert_measured(group: &Value, code: &str, unit: &str, expected: &Value) {
    let measured = &group["measurements"][code];
    let expected = number(expected);
    assert!((number(&measured["value"]) - expected).abs() <= 1e-9 * expected.abs().max(1.0), "{code}: {measured} is not {expected}");
    assert_eq!(number(&measured["exact"]).to_bits(), expected.to_bits(), "{code}");
    assert_eq!(measured["unit"], unit, "{code}");
}

/// Volume in ml and lowest and highest coordinates in mm of a binary STL whose triangles point outward.
fn stl_volume(bytes: &[u8]) -> (f64, [f64; 3], [f64; 3]) {
    assert!(!bytes.starts_with(b"solid"), "a text STL begins so");
    let count = u32::from_le_bytes(bytes[80..84].try_into().unwrap()) as usize;
    assert_eq!(bytes.len(), 84 + 50 * count);
    let (mut volume, mut low, mut high) = (0.0, [f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
    for triangle in bytes[84..].chunks(50) {
        let floats: Vec<f64> = triangle[..48].chunks(4).map(|four| f64::from(f32::from_le_bytes(four.try_into().unwrap()))).collect();
        let [a, b, c] = [1, 2, 3].map(|corner| [floats[3 * corner], floats[3 * corner + 1], floats[3 * corner + 2]]);
        let cross = [b[1] * c[2] - b[2] * c[1], b[2] * c[0] - b[0] * c[2], b[0] * c[1] - b[1] * c[0]];
        volume += (0..3).map(|axis| a[axis] * cross[axis]).sum::<f64>() / 6.0;
        for axis in 0..3 {
            low[axis] = [a, b, c].iter().fold(low[axis], |low, corner| low.min(corner[axis]));
            high[axis] = [a, b, c].iter().fold(high[axis], |high, corner| high.max(corner[axis]));
        }
    }
    (volume / 1000.0, low, high)
}

fn parsed(bytes: &[u8]) -> DefaultDicomObject {
    dicom_object::from_reader(std::io::Cursor::new(bytes)).unwrap()
}

/// A file with attributes of one's choice, byte for byte.
fn with_attributes(file: &[u8], attributes: &[(Attribute, &[u8])]) -> Vec<u8> {
    let mut object = parsed(file);
    for (attribute, value) in attributes {
        let (group, number) = attribute.tag();
        let vr = object.element(Tag(group, number)).map_or(VR::LO, |element| element.header().vr);
        let mut padded = value.to_vec();
        padded.resize(value.len().next_multiple_of(2), b' ');
        object.put(DataElement::<InMemDicomObject>::new(Tag(group, number), vr, PrimitiveValue::from(padded)));
    }
    let mut bytes = Vec::new();
    object.write_all(&mut bytes).unwrap();
    bytes
}

pub(super) fn contains(haystack: &[u8], needle: &[u8]) -> bool {
    haystack.windows(needle.len()).any(|window| window == needle)
}

/// All that the database has on disk.
fn on_disk(service: &Service) -> Vec<u8> {
    let files = std::fs::read_dir(&service.directory.0).unwrap();
    files.flat_map(|file| std::fs::read(file.unwrap().path()).unwrap()).collect()
}

/// The structured report of a gated study, by other programs.
fn assert_structured_report(sr: &[u8], job: &Value, report: &Value) {
    assert_as_stated(&parsed(sr), "##### Comprehensive SR");
    let file = scratch("gated-sr.dcm", sr);
    assert_dciodvfy(&file, "ComprehensiveSR");
    let printed = dsrdump(&file);
    assert!(printed.is_none_or(|printed| printed.contains("Imaging Measurement Report") && printed.contains("8821-1")));
    let Some(read) = highdicom(&file) else { return };
    assert_eq!(read["unknown_codes"], serde_json::json!([]), "{read:#}");
    assert_eq!(read["study_instance_uid"], report["study"]["study_instance_uid"]);
    assert_eq!(read["evidence"], report["study"]["sop_instance_uids"]);
    assert_eq!(read["algorithms"], serde_json::json!(["ventricle"]));
    assert_eq!(read["devices"], serde_json::json!(["ventricle"]));
    assert!(read["parameters"].as_array().unwrap().contains(&"mesh.level = 3".into()), "{read:#}");
    let finished_at = job["finished_at"].as_str().unwrap();
    let digits: String = finished_at.chars().filter(char::is_ascii_digit).take(14).collect();
    assert_eq!(read["content_date_time"], digits);
    let groups = read["groups"].as_array().unwrap();
    assert_eq!(groups.len(), 5);
    let function = &report["function"];
    for (code, unit, expected) in [
        ("8821-1/LN", "ml", &function["edv_ml"]),
        ("8823-7/LN", "ml", &function["esv_ml"]),
        ("90096001/SCT", "ml", &function["sv_ml"]),
        ("70822001/SCT", "%", &function["ef_percent"]),
        ("122446/DCM", "ml", &report["myocardium"]["mean_ml"]),
        ("122447/DCM", "g", &report["myocardium"]["mass_g"]),
        ("122182/DCM", "ms", &report["study"]["rr_interval_ms"]),
        ("8867-4/LN", "{H.B.}/min", &report["study"]["heart_rate_bpm"]),
        ("QUALITY_SCORE/99VENTRICLE", "1", &report["quality"]["score"]),
    ] {
        assert_measured(&groups[0], code, unit, expected);
    }
    assert_eq!(groups[0]["method"], "CAMERA_MODEL/99VENTRICLE");
    assert_eq!(groups[0]["sites"], serde_json::json!(["87878005/SCT"]));
    let error = &groups[0]["measurements"]["70822001/SCT"]["properties"];
    let told = &report["uncertainty"]["ef_percent"];
    assert!((number(&error["386136009/SCT"]) - number(&told["standard_error"])).abs() < 1e-9, "{error}");
    let above = number(&told["high_95"]) - number(&function["ef_percent"]);
    assert!((number(&error["371886008/SCT"]) - above).abs() < 1e-9, "{error}");
    for (gate, group) in report["gates"].as_array().unwrap().iter().zip(&groups[1..]) {
        assert_eq!(group["tracking_identifier"], format!("Gate {}", gate["gate"]));
        assert_eq!(group["time_points"], serde_json::json!([format!("Gate {} of 4", gate["gate"])]));
        assert_measured(group, "ENDO_VOLUME/99VENTRICLE", "ml", &gate["endocardial_ml"]);
        assert_measured(group, "EPI_VOLUME/99VENTRICLE", "ml", &gate["epicardial_ml"]);
        assert_measured(group, "122446/DCM", "ml", &gate["myocardial_ml"]);
        let phase = if gate["gate"] == function["end_diastolic_gate"] {
            "416190007/SCT".into()
        } else if gate["gate"] == function["end_systolic_gate"] {
            "416430001/SCT".into()
        } else {
            Value::Null
        };
        assert_eq!(group["finding"], phase);
    }
    assert_eq!(read["flags"], report["quality"]["flags"]);
    let comments = read["comments"].as_array().unwrap();
    assert_eq!(comments.len(), report["warnings"].as_array().unwrap().len() + 1, "{comments:?}");
}

/// Every surface as STL, plain and as DICOM.
async fn assert_surfaces(service: &Service, path: &str, report: &Value) {
    for (gate, told) in (1..).zip(report["gates"].as_array().unwrap()) {
        for surface in ["endocardial", "epicardial"] {
            let stl = result(service, &format!("{path}/gates/{gate}/{surface}.stl"), "model/stl").await;
            let (volume_ml, low, high) = stl_volume(&stl.bytes);
            let told_ml = number(&told[format!("{surface}_ml")]);
            // Single precision at some 100 mm from the origin: 1e-5 mm on some 100 cm².
            assert!((volume_ml - told_ml).abs() < 1e-3, "{surface} {gate}: {volume_ml} ml in the file, {told_ml} in the report");
            let apex = &report["pose"]["patient"]["apex_mm"];
            let within = |axis: usize| (low[axis] - 20.0..high[axis] + 20.0).contains(&number(&apex[axis]));
            assert!((0..3).all(within), "{surface} {gate} is not where the patient's heart is: {low:?} {high:?} {apex}");
            let encapsulated = result(service, &format!("{path}/gates/{gate}/{surface}.stl.dcm"), "application/dicom").await;
            let object = parsed(&encapsulated.bytes);
            assert_as_stated(&object, "##### Encapsulated STL");
            assert_eq!(object.element_by_name("EncapsulatedDocument").unwrap().to_bytes().unwrap(), stl.bytes);
            let title = object.element_by_name("DocumentTitle").unwrap().to_str().unwrap().to_lowercase();
            assert_eq!(title, format!("{surface} surface, gate {gate} of 4"));
            let frame = object.element_by_name("FrameOfReferenceUID").unwrap().to_str().unwrap().into_owned();
            assert_eq!(report["study"]["frame_of_reference_uid"], frame.as_str());
            assert_dciodvfy(&scratch(&format!("{surface}-{gate}.dcm"), &encapsulated.bytes), "EncapsulatedSTL");
        }
    }
    service.get(&format!("{path}/gates/5/endocardial.stl")).await.problem(404, "no_such_result");
    service.get(&format!("{path}/gates/0/epicardial.stl.dcm")).await.problem(404, "no_such_result");
}

/// The FHIR bundle of a gated study.
fn assert_bundle(fhir: &Answer, report: &Value) {
    assert_fhir(&scratch("gated-fhir.json", &fhir.bytes));
    let bundle = fhir.json();
    let entries = bundle["entry"].as_array().unwrap();
    let value = |named: &str| {
        let is = |resource: &&Value| resource["code"]["text"] == named;
        let resource = entries.iter().map(|entry| &entry["resource"]).find(is).unwrap_or_else(|| panic!("no {named} in {bundle:#}"));
        resource["valueQuantity"].clone()
    };
    assert_eq!(value("Left ventricular end-diastolic volume")["value"], report["function"]["edv_ml"]);
    assert_eq!(value("Left ventricular end-systolic volume")["value"], report["function"]["esv_ml"]);
    let ef = value("Cardiac ejection fraction");
    assert_eq!((&ef["value"], &ef["code"]), (&report["function"]["ef_percent"], &"%".into()));
    assert_eq!(ef["extension"][0]["valueDecimal"], report["uncertainty"]["ef_percent"]["standard_error"]);
    let study = format!("urn:oid:{}", report["study"]["study_instance_uid"].as_str().unwrap());
    assert_eq!(entries[0]["resource"]["imagingStudy"][0]["identifier"]["value"], study);
    let urns: Vec<&Value> = entries.iter().map(|entry| &entry["fullUrl"]).collect();
    let results = entries[0]["resource"]["result"].as_array().unwrap();
    assert_eq!(results.len(), 11, "seven values and four gates");
    assert!(results.iter().all(|result| urns.contains(&&result["reference"])), "a result leads nowhere");
    assert!(entries.iter().all(|entry| entry["resource"]["subject"].is_null()), "no patient");
}

/// Entity tags and media types.
async fn assert_conditions(service: &Service, path: &str, fhir: &[u8]) {
    for (name, other) in [("sr.dcm", "application/json"), ("fhir", "text/html"), ("gates/1/endocardial.stl", "model/gltf-binary")] {
        let first = service.get(&format!("{path}/{name}")).await;
        let again = service.get(&format!("{path}/{name}")).await;
        assert!(first.bytes == again.bytes && first.header("etag") == again.header("etag"), "{name} differs from itself");
        let unchanged = service.call("GET", &format!("{path}/{name}"), &[("if-none-match", first.header("etag"))]).await;
        assert_eq!((unchanged.status.as_u16(), unchanged.bytes.len()), (304, 0));
        service.call("GET", &format!("{path}/{name}"), &[("accept", other)]).await.problem(406, "not_acceptable");
    }
    let plain = service.call("GET", &format!("{path}/fhir"), &[("accept", "application/json")]).await;
    assert_eq!(plain.header("vary"), "accept");
    assert_eq!((plain.header("content-type"), plain.bytes.as_slice()), ("application/json", fhir));
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn what_a_gated_study_gives_passes_validators_and_readers() {
    let service = reconstructing(false).await;
    let path = reconstructed(&service, dicom(&beating())).await;
    let job = service.get(&path).await.json();
    assert_eq!(job["links"]["sr"], format!("{path}/sr.dcm"));
    assert_eq!(job["links"]["fhir"], format!("{path}/fhir"));
    let report = service.get(&format!("{path}/report")).await.json();

    let sr = result(&service, &format!("{path}/sr.dcm"), "application/dicom").await;
    assert_structured_report(&sr.bytes, &job, &report);
    assert_surfaces(&service, &path, &report).await;
    let fhir = result(&service, &format!("{path}/fhir"), "application/fhir+json").await;
    assert_bundle(&fhir, &report);
    assert_conditions(&service, &path, &fhir.bytes).await;

    // Nothing of the patient came in, however it was stored.
    assert!(contains(&dicom(&beating()), phantom::dicom::PATIENT_NAME.as_bytes()), "or else the next lines show nothing");
    let stored = on_disk(&service);
    assert!(!contains(&stored, phantom::dicom::PATIENT_NAME.as_bytes()) && !contains(&stored, b"UEhBTlRPTV5WRU5UUklDTEU"), "nor in base64");
    assert!(contains(&stored, report["study"]["study_instance_uid"].as_str().unwrap().as_bytes()), "or else this looks at nothing");
    assert!(!contains(&sr.bytes, b"PHANTOM"));
    for (tag, name) in [(Tag(0x10, 0x10), "name"), (Tag(0x10, 0x20), "id"), (Tag(0x8, 0x20), "study date")] {
        let object = parsed(&sr.bytes);
        assert!(object.element(tag).unwrap().value().primitive().unwrap().calculate_byte_len() == 0, "{name} is empty, and there");
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_kept_patient_is_in_dicom_results_alone_and_goes_with_the_job() {
    const NAME: &str = "Müller^Jörg=山田^太郎";
    let service = reconstructing(true).await;
    let attributes: [(Attribute, &[u8]); 6] = [
        (Attribute::SpecificCharacterSet, b"ISO_IR 192"),
        (Attribute::PatientName, NAME.as_bytes()),
        (Attribute::PatientId, b"ID-0815-4711"),
        (Attribute::PatientBirthDate, b"19610412"),
        (Attribute::AccessionNumber, b"ACC-99"),
        (Attribute::PatientSex, b"O"),
    ];
    let path = reconstructed(&service, with_attributes(&dicom(&beating()), &attributes)).await;
    let sr = result(&service, &format!("{path}/sr.dcm"), "application/dicom").await;
    let stl = result(&service, &format!("{path}/gates/2/epicardial.stl.dcm"), "application/dicom").await;
    assert_as_stated(&parsed(&sr.bytes), "##### Comprehensive SR");
    assert_as_stated(&parsed(&stl.bytes), "##### Encapsulated STL");
    for (attribute, value) in attributes {
        let (group, number) = attribute.tag();
        for document in [&sr, &stl] {
            let object = parsed(&document.bytes);
            let written = object.element(Tag(group, number)).unwrap().to_bytes().unwrap();
            let trimmed = written.strip_suffix(b" ").unwrap_or(&written);
            // The parser gives names decoded; both are UTF-8.
            assert_eq!(trimmed, value, "{attribute:?}");
        }
        assert!(contains(&sr.bytes, value) && contains(&stl.bytes, value), "{attribute:?} is not as it was received");
    }
    assert_dciodvfy(&scratch("kept-stl.dcm", &stl.bytes), "EncapsulatedSTL");
    let file = scratch("kept-sr.dcm", &sr.bytes);
    assert_dciodvfy(&file, "ComprehensiveSR");
    dsrdump(&file);
    if let Some(read) = highdicom(&file) {
        assert_eq!(read["patient_name"], NAME);
        assert_eq!(read["patient_id"], "ID-0815-4711");
        assert_eq!(read["accession_number"], "ACC-99");
    }

    // Everything else is as if it had not been kept.
    for name in ["", "/report", "/surfaces.glb", "/fhir", "/gates/1/wall.vtu", "/gates/1/endocardial.stl", "/gates/1/endocardial.glb"] {
        let bytes = service.get(&format!("{path}{name}")).await.bytes;
        for secret in ["Müller", "山田", "ID-0815", "19610412", "ACC-99"] {
            assert!(!contains(&bytes, secret.as_bytes()), "{name} has {secret}");
        }
    }
    let listed = service.get("/v1/reconstructions").await.bytes;
    assert!(!contains(&listed, b"ID-0815"));
    service.get(&format!("{path}/subject")).await.problem(404, "not_found");

    // Names by escapes between character sets, as PS3.5 H.3.2 has them.
    let report: Report = serde_json::from_slice(&service.get(&format!("{path}/report")).await.bytes).unwrap();
    let mut subject = Subject::default();
    let kanji = b"Yamada^Tarou=\x1b$B;3ED\x1b(B^\x1b$BB@O:\x1b(B=\x1b$B$d$^$@\x1b(B^\x1b$B$?$m$&\x1b(B";
    assert!(subject.put(Attribute::SpecificCharacterSet, b"\\ISO 2022 IR 87") && subject.put(Attribute::PatientName, kanji));
    let id = path.rsplit('/').next().unwrap().parse().unwrap();
    let mut finished = Finished { id, finished_at: "2026-01-02T03:04:05Z".parse().unwrap(), report, subject: Some(subject) };
    // And one gate without a cycle, whose uncertainty is its volume's.
    finished.report.function = None;
    finished.report.gates.truncate(1);
    let error = finished.report.uncertainty.unwrap().edv_ml.standard_error;
    let file = scratch("escaped-sr.dcm", &archive::sr::write(&finished).unwrap());
    assert_dciodvfy(&file, "ComprehensiveSR");
    if let Some(read) = highdicom(&file) {
        assert_eq!(read["patient_name"], "Yamada^Tarou=山田^太郎=やまだ^たろう");
        assert_eq!(read["content_date_time"], "20260102030405");
        let told = &read["groups"][1]["measurements"]["ENDO_VOLUME/99VENTRICLE"]["properties"]["386136009/SCT"];
        assert!((number(told) - error).abs() < 1e-9, "{told}");
        assert!(read["groups"][0]["measurements"]["8821-1/LN"].is_null());
    }
    // Reports from before the classes and the frame of reference were kept.
    let mut old = serde_json::to_value(&finished.report).unwrap();
    for member in ["sop_class_uids", "frame_of_reference_uid"] {
        assert!(old["study"].as_object_mut().unwrap().remove(member).is_some());
    }
    let old = Finished { report: serde_json::from_value(old).unwrap(), ..finished.clone() };
    assert!(contains(&archive::sr::write(&old).unwrap(), b"1.2.840.10008.5.1.4.1.1.20"), "refers to images of the one class there was");

    // It goes with the job.
    let id: uuid::Uuid = id;
    assert!(service.store.subject(id).await.unwrap().is_some());
    assert_eq!(service.call("DELETE", &path, &[]).await.status, 204);
    assert!(service.store.subject(id).await.unwrap().is_none());
    service.get(&format!("{path}/sr.dcm")).await.problem(404, "not_found");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn an_ungated_study_and_one_without_uids_give_what_they_have() {
    let service = reconstructing(true).await;
    let mut still = Phantom::demo();
    still.imaging.gates = 1;
    let mut nowhere = beating();
    nowhere.imaging.oriented = false;
    let studies = [("still", dicom(&still)), ("nifti", phantom::nifti::write(&phantom::simulate(&nowhere).unwrap().study))];
    for (name, file) in studies {
        let path = reconstructed(&service, file).await;
        let report = service.get(&format!("{path}/report")).await.json();
        let sr = result(&service, &format!("{path}/sr.dcm"), "application/dicom").await;
        let file = scratch(&format!("{name}-sr.dcm"), &sr.bytes);
        assert_dciodvfy(&file, "ComprehensiveSR");
        dsrdump(&file);
        assert_as_stated(&parsed(&sr.bytes), "##### Comprehensive SR");
        let fhir = result(&service, &format!("{path}/fhir"), "application/fhir+json").await;
        assert_fhir(&scratch(&format!("{name}-fhir.json"), &fhir.bytes));
        let stl = result(&service, &format!("{path}/gates/1/endocardial.stl.dcm"), "application/dicom").await;
        assert_dciodvfy(&scratch(&format!("{name}-stl.dcm"), &stl.bytes), "EncapsulatedSTL");
        let plain = result(&service, &format!("{path}/gates/1/endocardial.stl"), "model/stl").await;
        assert!((stl_volume(&plain.bytes).0 - number(&report["gates"][0]["endocardial_ml"])).abs() < 1e-3);
        let Some(read) = highdicom(&file) else { continue };
        let groups = read["groups"].as_array().unwrap();
        assert_eq!(groups.len(), report["gates"].as_array().unwrap().len() + 1);
        assert_measured(&groups[1], "ENDO_VOLUME/99VENTRICLE", "ml", &report["gates"][0]["endocardial_ml"]);
        let ef = &groups[0]["measurements"]["70822001/SCT"];
        let comments = read["comments"].to_string();
        if name == "still" {
            assert!(report["function"].is_null() && ef.is_null(), "{read:#}");
            assert_eq!(read["evidence"], report["study"]["sop_instance_uids"]);
            assert!(!comments.contains("refers to no images"), "{comments}");
        } else {
            assert_measured(&groups[0], "70822001/SCT", "%", &report["function"]["ef_percent"]);
            assert_eq!(read["evidence"], serde_json::json!([]));
            assert!(report["study"]["study_instance_uid"].is_null());
            assert!(read["study_instance_uid"].as_str().unwrap().starts_with("2.25."), "{read:#}");
            assert!(comments.contains("was made for it") && comments.contains("refers to no images"), "{comments}");
            assert!(!contains(&fhir.bytes, b"ImagingStudy"));
            let study = parsed(&stl.bytes).element_by_name("StudyInstanceUID").unwrap().to_str().unwrap().into_owned();
            assert_eq!(read["study_instance_uid"], study.as_str(), "all results are of one study");
        }
    }
}

#[test]
fn the_fhir_validator_would_find_a_fault() {
    let wrong = br#"{"resourceType":"Bundle","type":"gathering","entry":[{"resource":{"resourceType":"Observation","value_ml":1}}]}"#;
    let Some((valid, messages)) = fhir_findings(&scratch("wrong-fhir.json", wrong)) else { return };
    let messages = messages.to_string();
    assert!(!valid && messages.contains("gathering") && messages.contains("value_ml") && messages.contains("status"), "{messages}");
}

#[tokio::test]
async fn what_is_not_finished_or_has_failed_has_no_such_results() {
    let names = [
        "sr.dcm",
        "fhir",
        "gates/1/endocardial.stl",
        "gates/1/epicardial.stl",
        "gates/1/endocardial.stl.dcm",
        "gates/1/epicardial.stl.dcm",
    ];
    let waiting = idle().await;
    let path = waiting.submit(1).await;
    let broken = working(failing()).await;
    let failed = broken.finish(1).await;
    for name in names {
        waiting.get(&format!("{path}/{name}")).await.problem(409, "not_finished");
        let problem = broken.get(&format!("{failed}/{name}")).await.problem(409, "reconstruction_failed");
        assert_eq!(problem["cause"]["code"], "no_left_ventricle");
        let nobody = format!("/v1/reconstructions/{}/{name}", uuid::Uuid::now_v7());
        waiting.get(&nobody).await.problem(404, "not_found");
    }
}

#[tokio::test]
async fn of_a_failed_job_nobody_is_kept() {
    let service = with(StoreSettings::default(), Some(failing()), |state| state.with_patients_kept(true)).await;
    let accepted = service.post("", &[], dicom(&Phantom::small())).await;
    let path = accepted.header("location").to_owned();
    service.reach(&path, "failed").await;
    let id = path.rsplit('/').next().unwrap().parse().unwrap();
    assert!(service.store.subject(id).await.unwrap().is_none());
    let waiting = with(StoreSettings::default(), None, |state| state.with_patients_kept(true)).await;
    let accepted = waiting.post("", &[], dicom(&Phantom::small())).await;
    let id = accepted.header("location").rsplit('/').next().unwrap().parse().unwrap();
    let subject = waiting.store.subject(id).await.unwrap().expect("a job that waits has its subject");
    assert_eq!(subject.get(Attribute::PatientName), Some(phantom::dicom::PATIENT_NAME.as_bytes()));
}
