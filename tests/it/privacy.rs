//! That nothing by which a patient, or those who treat one, could be known leaves the intake: a study full of it is sent in every way, right and
//! wrong, and then all that the service says, logs and stores is searched. Besides, that `docs/privacy.md` lists what does leave.

use crate::{
    collector::{Collector, Manner},
    parted,
    served::{Answer, Directory, Served},
};
use dicom_core::{DataElement, PrimitiveValue, Tag, VR, value::DataSetSequence};
use dicom_dictionary_std::tags;
use dicom_object::{InMemDicomObject, from_reader};
use serde_json::Value;
use std::{collections::BTreeSet, fs, path::Path, time::Duration};
use ventricle::{
    intake::ALLOWED,
    jobs::input,
    study::{Acquisition, Format},
};

/// What every value begins with that is searched for, and no other text has: with a hyphen, which base64 does not have.
const MARK: &str = "QX7-";
/// A name as names are written.
const NAME: &str = "QX7-DOE^JANE";
/// A date of birth, marked by being nobody's. Searched for in texts.
const BIRTH: &str = "18370219";

/// Attributes that name somebody or something, with values that are found again.
fn identifying() -> Vec<(Tag, VR, &'static str)> {
    vec![
        (tags::PATIENT_NAME, VR::PN, NAME),
        (tags::PATIENT_ID, VR::LO, "QX7--0001"),
        (tags::ISSUER_OF_PATIENT_ID, VR::LO, "QX7- ISSUER"),
        (tags::PATIENT_BIRTH_DATE, VR::DA, BIRTH),
        (tags::OTHER_PATIENT_NAMES, VR::PN, "QX7-MAIDEN^NAME"),
        (tags::PATIENT_ADDRESS, VR::LO, "QX7- STREET 7"),
        (tags::PATIENT_TELEPHONE_NUMBERS, VR::SH, "QX7- 555-0100"),
        (tags::PATIENT_COMMENTS, VR::LT, "QX7- comments of the patient"),
        (tags::ACCESSION_NUMBER, VR::SH, "QX7-ACC"),
        (tags::STUDY_ID, VR::SH, "QX7-STUDY"),
        (tags::STUDY_DESCRIPTION, VR::LO, "QX7- study description"),
        (tags::SERIES_DESCRIPTION, VR::LO, "QX7- series description"),
        (tags::PROTOCOL_NAME, VR::LO, "QX7- protocol"),
        (tags::IMAGE_COMMENTS, VR::LT, "QX7- comments of the image"),
        (tags::INSTITUTION_NAME, VR::LO, "QX7- HOSPITAL"),
        (tags::INSTITUTION_ADDRESS, VR::ST, "QX7- HOSPITAL STREET"),
        (tags::STATION_NAME, VR::SH, "QX7-STATION"),
        (tags::DEVICE_SERIAL_NUMBER, VR::LO, "QX7-SERIAL"),
        (tags::REFERRING_PHYSICIAN_NAME, VR::PN, "QX7-REFERRER^A"),
        (tags::PERFORMING_PHYSICIAN_NAME, VR::PN, "QX7-PERFORMER^B"),
        (tags::OPERATORS_NAME, VR::PN, "QX7-OPERATOR^C"),
        // Private groups, before and after the attributes that are read.
        (Tag(0x0011, 0x0010), VR::LO, "QX7- PRIVATE CREATOR"),
        (Tag(0x0011, 0x1001), VR::PN, "QX7-PRIVATE^NAME"),
        (Tag(0x0055, 0x0010), VR::LO, "QX7- PRIVATE CREATOR"),
        (Tag(0x0055, 0x1001), VR::UN, "QX7-PRIVATE^NAME"),
        // Read, and not repeated: whether it speaks of long-axis slices.
        (tags::IMAGE_ID, VR::SH, "QX7-IMAGE"),
    ]
}

/// A study with all of it, also inside of a sequence that is read.
fn marked() -> Vec<u8> {
    let bytes = parted::with(&parted::whole(7), &identifying());
    let mut object = from_reader(bytes.as_slice()).unwrap();
    let mut items = object.element(tags::GATED_INFORMATION_SEQUENCE).unwrap().items().unwrap().to_vec();
    for (tag, vr, value) in [(tags::PATIENT_NAME, VR::PN, NAME), (Tag(0x0055, 0x1002), VR::LO, "QX7-NESTED")] {
        items[0].put(DataElement::new(tag, vr, PrimitiveValue::from(value)));
    }
    object.put(DataElement::<InMemDicomObject>::new(tags::GATED_INFORMATION_SEQUENCE, VR::SQ, DataSetSequence::from(items)));
    let mut bytes = Vec::new();
    object.write_all(&mut bytes).unwrap();
    assert!(finds(&bytes, MARK));
    bytes
}

fn finds(bytes: &[u8], text: &str) -> bool {
    bytes.windows(text.len()).any(|window| window.eq_ignore_ascii_case(text.as_bytes()))
}

fn assert_clean(what: &str, bytes: &[u8]) {
    for mark in [MARK, "18370219", "1837-02-19"] {
        // Eight digits may stand in pictures and surfaces by chance.
        if mark == MARK || std::str::from_utf8(bytes).is_ok() {
            assert!(!finds(bytes, mark), "{what} holds {mark}: {}", String::from_utf8_lossy(bytes).chars().take(3000).collect::<String>());
        }
    }
}

fn assert_clean_answer(what: &str, answer: &Answer) {
    assert_clean(&format!("{what} ({})", answer.status), &answer.body);
}

/// All results of a job: whatever the contract lists below its path.
fn results(service: &Served, id: &str) -> Vec<(String, Answer)> {
    let contract = service.get("/openapi.json").json();
    let below = contract["paths"].as_object().unwrap().iter().filter(|(path, item)| path.contains("/{id}") && item["get"].is_object());
    let paths = below.flat_map(|(path, _)| {
        let path = path.replace("{id}", id).replace("{gate}", "1");
        let images = ["perfusion.png", "perfusion.svg", "thickness.svg"];
        if path.contains("{image}") { images.map(|image| path.replace("{image}", image)).to_vec() } else { vec![path] }
    });
    // A job compared with itself is refused; that answer is looked at too.
    let with = |path: String| if path.ends_with("/comparison") { format!("{path}?with={id}") } else { path };
    paths.map(with).map(|path| (path.clone(), service.get(&path))).collect()
}

/// Bodies of several parts whose names, file names and headers are marked.
fn in_parts(file: &[u8]) -> (String, Vec<u8>) {
    let mut body = b"--QX7-boundary\r\nContent-Disposition: form-data; name=\"QX7-part\"; filename=\"QX7-DOE JANE.dcm\"\r\n".to_vec();
    body.extend_from_slice(b"Content-Description: QX7- description\r\nContent-Type: application/dicom\r\n\r\n");
    body.extend_from_slice(file);
    body.extend_from_slice(b"\r\n--QX7-boundary--\r\n");
    ("multipart/form-data; boundary=QX7-boundary".to_owned(), body)
}

/// The files of a directory, all in one.
fn stored(directory: &Path) -> Vec<u8> {
    let files = fs::read_dir(directory).unwrap().map(|entry| entry.unwrap().path()).filter(|path| path.is_file());
    files.flat_map(|path| fs::read(path).unwrap()).collect()
}

#[test]
fn nothing_that_names_anybody_leaves_the_intake() {
    let (data, logs) = (Directory::new("private"), Directory::new("private-log"));
    let log = logs.0.join("log");
    let collector = Collector::start(Manner::Takes);
    let flags = ["--quiet-seconds", "1", "--keep-input", "--node", "the-node", "--otlp-endpoint", &collector.url];
    let service = Served::start_logging(&data.0, &log, &flags);
    let file = marked();
    let accepted = service.post("application/dicom", &file);
    assert_eq!(accepted.status, 202, "{}", accepted.json());
    let id = accepted.json()["id"].as_str().unwrap().to_owned();
    let job = service.finished(&id, Duration::from_mins(2));
    assert_eq!(job["state"], "succeeded", "{job}");
    assert_clean("the job", job.to_string().as_bytes());
    let results = results(&service, &id);
    assert!(results.iter().filter(|(_, answer)| answer.status == 200).count() >= 18, "{}", results.len());
    for (path, answer) in &results {
        assert_clean_answer(path, answer);
    }
    // The same in parts, from a PACS, as a part of a study that waits, and by a key; then what is refused.
    let (media_type, body) = in_parts(&parted::with(&parted::whole(8), &identifying()));
    assert_clean_answer("parts", &service.post(&media_type, &body));
    assert_clean_answer("a key", &service.post_keyed("QX7- key", "application/dicom", &file));
    let part = parted::with(&parted::gates(&parted::whole(9))[0], &identifying());
    // Without what is nested: sequences of parts that wait are on the disk as they came (docs/privacy.md).
    let whole = parted::with(&parted::whole(10), &identifying());
    for part in [whole, part] {
        let body = [b"--b\r\nContent-Type: application/dicom\r\n\r\n".as_slice(), &part, b"\r\n--b--"].concat();
        assert_clean_answer(
            "STOW",
            &service.post_to("/dicom-web/studies", "multipart/related; type=\"application/dicom\"; boundary=b", &body),
        );
    }
    for (what, answer) in wrong(&service, &file) {
        assert_clean_answer(&what, &answer);
        if let Some(id) = answer.json()["id"].as_str().filter(|_| answer.status == 202) {
            // It was taken although something is wrong with it, and is told of in the warnings.
            assert_clean_answer(&what, &service.get(&format!("/v1/reconstructions/{id}")));
            service.delete(&format!("/v1/reconstructions/{id}"));
        }
    }
    assert_clean_answer("the list", &service.get("/v1/reconstructions"));
    // What a client writes into an address or a query of its own is told to it alone.
    for path in ["/QX7-", "/v1/reconstructions/QX7-DOE", "/v1/reconstructions?QX7-=QX7-", "/v1/reconstructions?study_instance_uid=QX7-"] {
        service.get(path);
    }
    service.post("application/json", b"{\"QX7-\": \"QX7-\"}");
    assert_clean_answer("metrics", &service.get("/metrics"));
    let lines = fs::read_to_string(&log).unwrap();
    assert!(lines.lines().count() > 100, "{lines}");
    assert_clean("the log", lines.as_bytes());
    assert!(!lines.contains(&parted::text_of(&file, tags::STUDY_INSTANCE_UID)), "UIDs are not logged");
    assert_untold(&service, &collector, &file);
    drop(service);
    let stored = stored(&data.0);
    assert!(finds(&stored, "SQLite format 3"));
    for (tag, _, value) in identifying().into_iter().filter(|(tag, ..)| *tag != tags::IMAGE_ID) {
        assert!(!finds(&stored, value), "{tag} is on the disk");
    }
}

/// What the service has told its collector so far, and tells it of a request that has names wherever a client can write any, holds none of them; nor
/// UIDs, paths, addresses of clients and owners.
fn assert_untold(service: &Served, collector: &Collector, file: &[u8]) {
    let config = ureq::Agent::config_builder().http_status_as_error(false).allow_non_standard_methods(true);
    let agent = config.timeout_global(Some(Duration::from_mins(1))).build().new_agent();
    // The last one says which it is: what ended before it was sent before it, or with it.
    for (method, traceparent) in [("QX7-DOE", "QX7-DOE^JANE"), ("GET", "00-000000000000000000000000000000aa-00000000000000bb-01")] {
        let path = "/v1/reconstructions/QX7-DOE/report?QX7-=QX7-DOE";
        let request = ureq::http::Request::builder().method(method).uri(format!("{}{path}", service.url));
        let request = request.header("traceparent", traceparent).header("tracestate", "qx7-a=QX7-DOE").header("baggage", "qx7-a=QX7-DOE");
        let request = request.header("x-request-id", "QX7-DOE").header("user-agent", "QX7-DOE").header("x-forwarded-for", "192.0.2.77");
        drop(agent.run(request.body(()).unwrap()).unwrap());
    }
    collector.wait_for(|collector| collector.spans().iter().any(|span| span.parent_span_id.last() == Some(&0xbb)));
    let told = collector.spans();
    assert!(told.len() > 100 && told.iter().any(|span| span.name == "job"), "{}", told.len());
    let uid = parted::text_of(file, tags::STUDY_INSTANCE_UID);
    for text in [MARK, BIRTH, "1837-02-19", "JANE", "127.0.0.1", "192.0.2.77", "anonymous", uid.as_str()] {
        for request in collector.received() {
            assert!(!finds(&request.body, text), "a span holds {text}: {told:#?}");
            assert!(!finds(request.head.as_bytes(), text) || text == "127.0.0.1", "{}", request.head);
        }
    }
}

/// Files that are wrong where an attribute is read: what is wrong about them is a name.
fn wrong(service: &Served, file: &[u8]) -> Vec<(String, Answer)> {
    let mut answers = Vec::new();
    for tag in ALLOWED.map(|allowed| allowed.tag) {
        for (vr, value) in [(VR::LO, NAME), (VR::UN, NAME), (VR::LO, "QX7- DOE JANE, BORN 18370219")] {
            let wrong = parted::with(file, &[(tag, vr, value)]);
            answers.push((format!("{tag} as {vr}"), service.post("application/dicom", &wrong)));
        }
    }
    let refused = answers.iter().filter(|(_, answer)| (400..500).contains(&answer.status)).count();
    assert!(refused > 40, "{refused}");
    for (what, media_type, body) in [
        ("no DICOM", "application/dicom", NAME.repeat(40)),
        ("no NIfTI", "application/x-nifti", NAME.repeat(40)),
        ("no format", "application/octet-stream", NAME.repeat(40)),
    ] {
        answers.push((what.to_owned(), service.post(media_type, body.as_bytes())));
    }
    let (media_type, mut body) = in_parts(NAME.as_bytes());
    answers.push(("parts of text".to_owned(), service.post(&media_type, &body)));
    body.truncate(body.len() / 2);
    answers.push(("half of parts".to_owned(), service.post(&media_type, &body)));
    let cut = &file[..file.len() / 3];
    answers.push(("a third of a file".to_owned(), service.post("application/dicom", cut)));
    answers
}

#[test]
fn a_kept_patient_is_in_dicom_results_and_on_the_disk_alone_and_goes_with_the_job() {
    let (data, logs) = (Directory::new("kept"), Directory::new("kept-log"));
    let log = logs.0.join("log");
    let service = Served::start_logging(&data.0, &log, &["--keep-patient"]);
    let accepted = service.post("application/dicom", &marked());
    assert_eq!(accepted.status, 202, "{}", accepted.json());
    let id = accepted.json()["id"].as_str().unwrap().to_owned();
    assert_eq!(service.finished(&id, Duration::from_mins(2))["state"], "succeeded");
    let results = results(&service, &id);
    let (dicom, others): (Vec<_>, Vec<_>) =
        results.iter().partition(|(path, _)| Path::new(path).extension().is_some_and(|end| end == "dcm"));
    assert!(dicom.len() >= 3 && others.len() > 15, "{} {}", dicom.len(), others.len());
    for (path, answer) in dicom {
        assert!(finds(&answer.body, NAME) && finds(&answer.body, BIRTH), "{path}");
        assert!(!finds(&answer.body, "QX7- HOSPITAL") && !finds(&answer.body, "QX7-PERFORMER"), "{path}");
    }
    for (path, answer) in others {
        assert_clean_answer(path, answer);
    }
    assert_clean_answer("metrics", &service.get("/metrics"));
    assert_clean("the log", &fs::read(&log).unwrap());
    // Deleted: overwritten in the file, not only marked as free. The values are stored in base64.
    let kept = {
        use base64::Engine as _;
        base64::engine::general_purpose::STANDARD.encode(NAME)
    };
    assert!(finds(&stored(&data.0), &kept));
    assert!(service.delete(&format!("/v1/reconstructions/{id}")).status < 300);
    service.signal("TERM");
    assert!(service.ended(Duration::from_mins(1)).success());
    assert!(!finds(&stored(&data.0), &kept), "a deleted name is in the file");
}

/// The rows of the table of `docs/privacy.md` that begins with this head, without the head.
fn table(head: &str) -> Vec<Vec<String>> {
    let text = fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/privacy.md")).unwrap();
    let rows = text.lines().skip_while(|line| !line.starts_with(&format!("| {head} |"))).skip(2).take_while(|line| line.starts_with('|'));
    let rows: Vec<Vec<String>> = rows.map(|line| line.trim_matches('|').split('|').map(|cell| cell.trim().to_owned()).collect()).collect();
    assert!(!rows.is_empty(), "docs/privacy.md has no table that begins with {head}");
    rows
}

#[test]
fn what_leaves_the_intake_is_what_the_table_says() {
    let told: Vec<(String, String)> = table("attribute").into_iter().map(|row| (row[1].clone(), row[2].clone())).collect();
    let shown = |leaves: Option<&str>| leaves.map_or_else(|| "—".to_owned(), |field| format!("`{field}`"));
    let expected = ALLOWED.map(|allowed| (allowed.tag.to_string(), shown(allowed.leaves_as)));
    assert_eq!(told, expected);
    // As what they leave is what a stored study has, and it has nothing else of the file's attributes.
    let body = crate::place::study();
    let header = input::encode(&body).unwrap();
    let length = u32::from_le_bytes(header[8..12].try_into().unwrap()) as usize;
    let header: Value = serde_json::from_slice(&header[12..12 + length]).unwrap();
    let members = |value: &Value| value.as_object().unwrap().keys().cloned().collect::<BTreeSet<_>>();
    let acquisition = serde_json::to_value(Acquisition::unknown(Format::Dicom)).unwrap();
    assert_eq!(members(&header["acquisition"]), members(&acquisition));
    let has: BTreeSet<String> = members(&header).into_iter().chain(members(&acquisition)).collect();
    let fields: BTreeSet<String> = ALLOWED.iter().filter_map(|allowed| allowed.leaves_as.map(str::to_owned)).collect();
    let of_the_service = ["acquisition", "format", "warnings"].map(str::to_owned);
    assert_eq!(fields.into_iter().chain(of_the_service).collect::<BTreeSet<_>>(), has);
}

#[test]
fn what_is_said_of_a_span_is_what_the_table_says() {
    let told: Vec<String> = table("span attribute").into_iter().map(|row| row[0].trim_matches('`').to_owned()).collect();
    assert_eq!(told, ventricle::traces::Attribute::NAMES);
}

#[test]
fn what_is_kept_of_a_patient_is_what_the_table_says() {
    let told: Vec<String> = table("kept attribute").into_iter().map(|row| row[1].clone()).collect();
    let kept = ventricle::subject::Attribute::ALL.map(|attribute| format!("({:04X},{:04X})", attribute.tag().0, attribute.tag().1));
    assert_eq!(told, kept);
}
