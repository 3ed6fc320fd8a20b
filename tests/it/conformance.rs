//! That the DICOM conformance statement (`docs/conformance.md`), and what `docs/pacs.md` has of the same, is what the program does.

use dicom_core::Tag;
use dicom_dictionary_std::uids;
use dicom_object::InMemDicomObject;
use std::{collections::BTreeSet, fs, path::Path};
use ventricle::{
    codecs::Decoder,
    intake::{self, Limits},
};

fn read(path: &str) -> String {
    fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join(path)).unwrap()
}

/// The cells of the tables of a document, those rows that follow a heading up to the next one of any level.
fn rows(document: &str, heading: &str) -> Vec<Vec<String>> {
    let text = read(document);
    let section = text.split(&format!("\n{heading}\n")).nth(1).unwrap_or_else(|| panic!("{document} has no heading {heading:?}"));
    let section = section.split("\n##").next().unwrap();
    let cells = |line: &str| line.trim_matches('|').split('|').map(|cell| cell.trim().to_owned()).collect::<Vec<_>>();
    let rows: Vec<_> = section.lines().filter(|line| line.starts_with("| ")).map(cells).collect();
    assert!(rows.len() > 1, "{document} has no table below {heading:?}");
    rows
}

/// What a column has of a table that begins with this head.
fn column(document: &str, heading: &str, head: &str, column: usize) -> Vec<String> {
    let rows = rows(document, heading);
    let mut found = rows.iter().skip_while(|row| row[0] != head);
    let width = found.next().unwrap_or_else(|| panic!("{document}, {heading:?}: no table begins with {head:?}")).len();
    found.take_while(|row| row.len() == width).map(|row| row[column].clone()).collect()
}

fn set<T: Into<String>>(values: impl IntoIterator<Item = T>) -> BTreeSet<String> {
    values.into_iter().map(Into::into).collect()
}

/// What a constant of a source file is set to.
fn constant(file: &str, name: &str) -> String {
    let text = read(file);
    let code = text.split(&format!("const {name}: ")).nth(1).unwrap_or_else(|| panic!("{file} has no constant {name}"));
    code.split(" = ").nth(1).unwrap().split(';').next().unwrap().trim_matches('"').to_owned()
}

/// The value of a constant as a text has it: a number, s, KiB or MiB.
fn told(file: &str, name: &str) -> String {
    let value = constant(file, name);
    if let Some(seconds) = value.strip_prefix("Duration::from_secs(") {
        return format!("{} s", seconds.trim_end_matches(')'));
    }
    match value.split_once(" << ") {
        Some((number, "10")) => format!("{number} KiB"),
        Some((number, "20")) => format!("{number} MiB"),
        _ => value,
    }
}

/// Numbers of four hexadecimal digits after `0x` in a part of a source file.
fn statuses(file: &str, from: &str, to: &str) -> BTreeSet<String> {
    let text = read(file);
    let part = text.split(from).nth(1).unwrap_or_else(|| panic!("{file} has no {from:?}")).split(to).next().unwrap();
    part.split("0x").skip(1).map(|rest| rest[..4].to_owned()).collect()
}

#[test]
fn transfer_syntaxes_are_those_that_are_read() {
    let limits = Limits { decoder: Some(Decoder { program: env!("CARGO_BIN_EXE_ventricle").into() }), ..Limits::default() };
    let read = intake::transfer_syntaxes(&limits);
    let heading = "##### Presentation contexts";
    let table = rows("docs/conformance.md", heading).into_iter().skip(1).map(|row| (row[1].clone(), row[2].clone()));
    let expected: Vec<_> = read.iter().map(|syntax| (syntax.uid.to_owned(), if syntax.lossy { "yes" } else { "no" }.to_owned())).collect();
    assert_eq!(table.collect::<Vec<_>>(), expected);
    let guide = column("docs/pacs.md", "## Transfer syntaxes", "UID", 0);
    assert_eq!(guide, read.iter().map(|syntax| syntax.uid).collect::<Vec<_>>());
}

#[test]
fn sop_classes_are_those_that_are_taken_and_written() {
    let verification = constant("src/dimse/mod.rs", "VERIFICATION");
    let taken = set(intake::STORAGE_CLASSES.into_iter().chain([verification.as_str()]));
    assert_eq!(set(column("docs/conformance.md", "##### SOP classes", "SOP class", 1)), taken);
    let overview = rows("docs/conformance.md", "## 1. Overview");
    let overview: BTreeSet<_> = overview.iter().filter(|row| row.len() == 4 && row[3] == "yes").map(|row| row[1].clone()).collect();
    assert_eq!(overview, taken);
    assert_eq!(column("docs/conformance.md", "#### 4.2.2 STORAGE-SCU", "SOP class", 1), [uids::COMPREHENSIVE_SR_STORAGE]);
    let guide = read("docs/pacs.md");
    for uid in taken.iter().map(String::as_str).chain([uids::COMPREHENSIVE_SR_STORAGE, uids::ENCAPSULATED_STL_STORAGE]) {
        assert!(read("docs/conformance.md").contains(&format!(" {uid} ")), "{uid}");
        assert!(guide.contains(uid) || !taken.contains(uid), "docs/pacs.md does not name {uid}");
    }
}

#[test]
fn statuses_are_those_that_are_answered() {
    let refusals = statuses("src/assembly/reception.rs", "pub fn status(&self) -> u16 {", "\n    }\n");
    assert_eq!(refusals.len(), 6, "{refusals:?}");
    assert_eq!(set(column("docs/conformance.md", "#### 4.3.1 STOW-RS origin server", "Failure Reason (0008,1197)", 0)), refusals);
    let reasons = column("docs/pacs.md", "## Sending studies: STOW-RS", "Failure Reason", 0);
    assert_eq!(set(reasons.iter().map(|reason| &reason[..4])), refusals);
    for reason in reasons {
        let (hexadecimal, decimal) = (u16::from_str_radix(&reason[..4], 16).unwrap(), reason[6..].trim_end_matches(')'));
        assert_eq!(hexadecimal.to_string(), decimal, "{reason}");
    }
    let dimse = statuses("src/dimse/command.rs", "const RESPONSE: ", "/// Command Data Set Type");
    let dimse: BTreeSet<String> = dimse.into_iter().filter(|status| status != "8000").chain(refusals).collect();
    assert_eq!(set(column("docs/conformance.md", "##### SOP-specific conformance: Storage", "status", 0)), dimse);
    // The guide has those that an object can be answered with.
    let guide = set(column("docs/pacs.md", "## C-STORE", "status", 0));
    assert_eq!(guide, dimse.into_iter().filter(|status| status != "0211").collect());
}

#[test]
fn policies_are_those_of_the_program() {
    const SCP: &str = "##### Association policies";
    const SCU: &str = "#### 4.2.2 STORAGE-SCU";
    for (heading, policy, file, name) in [
        (SCP, "application context name", "src/dimse/mod.rs", "APPLICATION_CONTEXT"),
        (SCP, "connections beside them, that have not asked yet or are told no", "src/dimse/listener.rs", "OTHER_CONNECTIONS"),
        (SCP, "longest PDU received", "src/dimse/peer.rs", "MOST_PDU_BYTES"),
        (SCP, "longest PDU sent, where the other side takes more", "src/dimse/peer.rs", "OWN_PDU_BYTES"),
        (SCP, "longest command set", "src/dimse/association.rs", "MOST_COMMAND_BYTES"),
        (SCP, "implementation class UID", "src/elements.rs", "IMPLEMENTATION_UID"),
        (SCP, "time for the request of an association, and for TLS before it", "src/dimse/listener.rs", "REQUEST_TIME"),
        (SCP, "longest silence within an association", "src/dimse/association.rs", "IDLE_TIME"),
        (SCP, "longest silence once the service stops", "src/dimse/association.rs", "STOPPING_TIME"),
        (SCP, "time for an answer to be taken", "src/dimse/peer.rs", "WRITE_TIME"),
        (SCU, "application context name", "src/dimse/mod.rs", "APPLICATION_CONTEXT"),
        (SCU, "longest PDU received", "src/dimse/peer.rs", "MOST_PDU_BYTES"),
        (SCU, "longest PDU sent, where the other side takes more", "src/dimse/peer.rs", "OWN_PDU_BYTES"),
        (SCU, "implementation class UID", "src/elements.rs", "IMPLEMENTATION_UID"),
        (SCU, "time to connect", "src/callbacks/send.rs", "CONNECT_TIME"),
        (SCU, "longest silence of the other side", "src/dimse/send.rs", "ANSWER_TIME"),
        (SCU, "time for the release", "src/dimse/send.rs", "RELEASE_TIME"),
        (SCU, "time for all of it", "src/callbacks/send.rs", "WHOLE_TIME"),
    ] {
        let rows = rows("docs/conformance.md", heading);
        let row = rows.iter().find(|row| row[0] == policy).unwrap_or_else(|| panic!("{heading}: no {policy:?}"));
        assert_eq!(row[1], told(file, name), "{heading}: {policy}; {name} in {file}");
    }
    let object = rows("docs/conformance.md", SCP);
    let held = format!("larger objects than {} received at once", told("src/dimse/object.rs", "SMALL_BYTES"));
    let row = object.iter().find(|row| row[0] == held).unwrap_or_else(|| panic!("no {held:?}"));
    let expected =
        format!("{}; others wait up to {}", told("src/dimse/object.rs", "LARGE_AT_ONCE"), told("src/dimse/object.rs", "LARGE_TIME"));
    assert_eq!(row[1], expected);
}

#[test]
fn attributes_of_received_objects_are_those_that_are_read() {
    let told: Vec<Tag> = tags("#### 8.1.2 Attributes of received objects").into_iter().map(|(tag, _)| tag).collect();
    assert_eq!(told, intake::ALLOWED.map(|allowed| allowed.tag));
}

/// The tags of a table, with the cell after each.
fn tags(heading: &str) -> Vec<(Tag, String)> {
    let rows = rows("docs/conformance.md", heading);
    rows.iter().skip(1).map(|row| (row[1].parse().unwrap_or_else(|_| panic!("{row:?}")), row.get(2).cloned().unwrap_or_default())).collect()
}

/// That an object that was written has the attributes that the statement lists under this heading and for every object, as it says.
pub(crate) fn assert_as_stated(object: &InMemDicomObject, heading: &str) {
    let mut stated = tags("##### Every created object");
    stated.extend(tags(heading));
    for element in object {
        let tag = element.header().tag;
        let (_, presence) = stated.iter().find(|(stated, _)| *stated == tag).unwrap_or_else(|| panic!("{heading}: {tag} is not listed"));
        let items = element.value().items().map(<[_]>::len);
        let is_empty = items.map_or_else(|| element.to_bytes().is_ok_and(|bytes| bytes.is_empty()), |items| items == 0);
        match presence.as_str() {
            "EMPTY" => assert!(is_empty, "{heading}: {tag} has a value"),
            "ALWAYS" => assert!(!is_empty, "{heading}: {tag} has no value"),
            "VNAP" | "ANAP" => {}
            other => panic!("{heading}: {tag} is said to be {other:?}"),
        }
    }
    for (tag, presence) in stated {
        assert!(presence == "ANAP" || object.element(tag).is_ok(), "{heading}: {tag} is listed as {presence} and absent");
    }
}
