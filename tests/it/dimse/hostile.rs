//! Peers that say nothing, too much, or nonsense: each is ended, in bounded memory, and nobody else notices.

use super::{CALLER, dcmtk, has_dcmtk, service, write};
use crate::{
    parted,
    served::{Directory, Served},
};
use dicom_ul::pdu::{
    AssociationRJResult, AssociationRQ, PDataValue, PDataValueType, Pdu, PresentationContextProposed, UserVariableItem, read_pdu, write_pdu,
};
use std::{
    io::{self, Read as _, Write as _},
    net::TcpStream,
    time::{Duration, Instant},
};

const NM: &str = "1.2.840.10008.5.1.4.1.1.20";
const VERIFICATION: &str = "1.2.840.10008.1.1";
const IMPLICIT: &str = "1.2.840.10008.1.2";
/// What refusing may add to the peak of the service's memory.
const MOST_GROWTH_MIB: f64 = 120.0;

/// A peer made by hand.
struct Peer(TcpStream);

impl Peer {
    fn connect(service: &Served) -> Self {
        let stream = TcpStream::connect(("127.0.0.1", service.dimse_port)).unwrap();
        stream.set_read_timeout(Some(Duration::from_secs(40))).unwrap();
        Self(stream)
    }

    /// With an association for images and echoes.
    fn associated(service: &Served) -> Self {
        let mut peer = Self::connect(service);
        match peer.ask() {
            Some(Pdu::AssociationAC(_)) => peer,
            other => panic!("{other:?}"),
        }
    }

    fn ask(&mut self) -> Option<Pdu> {
        let context = |id, class: &str| PresentationContextProposed {
            id,
            abstract_syntax: class.to_owned(),
            transfer_syntaxes: vec![IMPLICIT.to_owned()],
        };
        self.send(&Pdu::AssociationRQ(AssociationRQ {
            protocol_version: 1,
            calling_ae_title: CALLER.to_owned(),
            called_ae_title: "ANY".to_owned(),
            application_context_name: "1.2.840.10008.3.1.1.1".to_owned(),
            presentation_contexts: vec![context(1, NM), context(3, VERIFICATION)],
            user_variables: vec![UserVariableItem::MaxLength(16384)],
        }))
        .unwrap();
        self.receive()
    }

    fn send(&mut self, pdu: &Pdu) -> io::Result<()> {
        let mut bytes = Vec::new();
        write_pdu(&mut bytes, pdu).unwrap();
        self.0.write_all(&bytes)
    }

    fn value(&mut self, context: u8, value_type: PDataValueType, is_last: bool, data: Vec<u8>) -> io::Result<()> {
        self.send(&Pdu::PData { data: vec![PDataValue { presentation_context_id: context, value_type, is_last, data }] })
    }

    /// `None` where the connection is over.
    fn receive(&mut self) -> Option<Pdu> {
        let mut bytes = vec![0; 6];
        self.0.read_exact(&mut bytes).ok()?;
        let length = u32::from_be_bytes(bytes[2..6].try_into().unwrap());
        bytes.resize(6 + length as usize, 0);
        self.0.read_exact(&mut bytes[6..]).ok()?;
        read_pdu(bytes.as_slice(), 1 << 20, true).unwrap()
    }

    /// The other side aborts, or just closes: in either case it is over.
    fn is_ended(&mut self, what: &str) {
        let answer = self.receive();
        assert!(matches!(answer, Some(Pdu::AbortRQ { .. }) | None), "{what}: {answer:?}");
    }
}

/// A command set as it is on the wire.
fn command(elements: &[(u16, &[u8])]) -> Vec<u8> {
    let mut bytes = Vec::new();
    for (number, value) in elements {
        bytes.extend_from_slice(&[0, 0]);
        bytes.extend_from_slice(&number.to_le_bytes());
        bytes.extend_from_slice(&u32::try_from(value.len()).unwrap().to_le_bytes());
        bytes.extend_from_slice(value);
    }
    bytes
}

fn store() -> Vec<u8> {
    let class = format!("{NM}\0");
    command(&[(2, class.as_bytes()), (0x100, &[1, 0]), (0x110, &[1, 0]), (0x700, &[0, 0]), (0x800, &[1, 0]), (0x1000, b"1.2.3\0")])
}

fn echo() -> Vec<u8> {
    command(&[(2, b"1.2.840.10008.1.1\0"), (0x100, &[0x30, 0]), (0x110, &[1, 0]), (0x800, &[1, 1])])
}

/// The status of a response.
fn status(pdu: Option<Pdu>) -> u16 {
    let Some(Pdu::PData { data }) = pdu else { panic!("{pdu:?}") };
    let bytes = &data[0].data;
    let at = bytes.windows(8).position(|window| window == [0, 0, 0, 9, 2, 0, 0, 0]).unwrap();
    u16::from_le_bytes([bytes[at + 8], bytes[at + 9]])
}

fn is_answered(service: &Served, meanwhile: &str) {
    let start = Instant::now();
    let (content, said) = dcmtk("echoscu", service, &["-to", "20"], &[]);
    assert!(content, "{meanwhile}: {said}");
    assert!(start.elapsed() < Duration::from_secs(10), "{meanwhile}: {:?}", start.elapsed());
}

#[test]
fn silent_peers_hold_nobody_up_and_are_ended() {
    if !has_dcmtk() {
        return;
    }
    let data = Directory::new("dimse-silent");
    let mut service = service(&data, &["--dimse-max-associations", "4"]);
    let start = Instant::now();
    let mut silent: Vec<Peer> = (0..30).map(|_| Peer::connect(&service)).collect();
    silent[0].0.write_all(&[1, 0, 0]).unwrap();
    let mut associated: Vec<Peer> = (0..3).map(|_| Peer::associated(&service)).collect();
    associated[0].value(1, PDataValueType::Command, true, store()).unwrap();
    associated[0].value(1, PDataValueType::Data, false, vec![0; 1000]).unwrap();
    associated[1].0.write_all(&[4, 0, 0, 0, 1, 0, 0]).unwrap();
    is_answered(&service, "silent peers");
    let files = Directory::new("dimse-silent-files");
    let study = write(&files.0, "study.dcm", &parted::ungated(1));
    let (content, said) = dcmtk("storescu", &service, &[], &[study]);
    assert!(content, "{said}");
    // One too many is told to come again.
    let last = Peer::associated(&service);
    let rejected = Peer::connect(&service).ask();
    assert!(matches!(&rejected, Some(Pdu::AssociationRJ(rejection)) if rejection.result == AssociationRJResult::Transient), "{rejected:?}");
    drop(last);
    for peer in &mut silent {
        peer.is_ended("no request");
    }
    assert!(start.elapsed() < Duration::from_secs(30), "{:?}", start.elapsed());
    for peer in &mut associated {
        peer.is_ended("an idle association");
    }
    assert!(start.elapsed() < Duration::from_mins(1), "{:?}", start.elapsed());
    assert!(service.is_alive());
}

#[test]
fn nonsense_ends_its_own_association_and_no_other() {
    if !has_dcmtk() {
        return;
    }
    let data = Directory::new("dimse-nonsense");
    let mut service = service(&data, &[]);
    let before = service.peak_mib();
    let mut bystander = Peer::associated(&service);
    let noise: Vec<u8> = (0..200_000_u32).map(|i| (i.wrapping_mul(2_654_435_761) >> 13) as u8).collect();
    for (what, bytes) in [
        ("noise", noise.as_slice()),
        ("HTTP", b"GET / HTTP/1.1\r\nHost: a\r\n\r\n"),
        ("a request of 4 GiB", &[1, 0, 0xff, 0xff, 0xff, 0xff, 0, 1]),
        ("data of 4 GiB before any association", &[4, 0, 0xff, 0xff, 0xff, 0xff]),
        ("a request with nothing in it", &[1, 0, 0, 0, 0, 0]),
        ("a release of nothing", &[5, 0, 0, 0, 0, 4, 0, 0, 0, 0]),
    ] {
        let mut peer = Peer::connect(&service);
        // Written as far as it is taken.
        let _ = peer.0.write_all(bytes);
        peer.is_ended(what);
    }
    let long_value = [&[4, 0][..], &20_u32.to_be_bytes(), &u32::MAX.to_be_bytes(), &[1, 3], &[0; 14]].concat();
    let short_value = [&[4, 0][..], &6_u32.to_be_bytes(), &1_u32.to_be_bytes(), &[1, 3]].concat();
    for (what, bytes) in [
        ("data of 4 GiB", [4, 0, 0xff, 0xff, 0xff, 0xff].as_slice()),
        ("data just over the limit", &[4, 0, 0, 4, 0, 1]),
        ("a value longer than its unit", &long_value),
        ("a value without its header", &short_value),
        ("no value", &[4, 0, 0, 0, 0, 0]),
        ("a unit of no kind", &[9, 0, 0, 0, 0, 0]),
        ("a second request", &[1, 0, 0, 0, 0, 2, 0, 0]),
        ("an acceptance", &[2, 0, 0, 0, 0, 2, 0, 0]),
    ] {
        let mut peer = Peer::associated(&service);
        let _ = peer.0.write_all(bytes);
        peer.is_ended(what);
    }
    let cases: [(&str, u8, PDataValueType, Vec<u8>); 7] = [
        ("a data set without a command", 1, PDataValueType::Data, vec![0; 100]),
        ("an empty command set", 1, PDataValueType::Command, Vec::new()),
        ("a command set of noise", 1, PDataValueType::Command, noise[..300].to_vec()),
        ("an element of 4 GiB", 1, PDataValueType::Command, [&[0, 0, 0, 1][..], &[0xff; 4], &[1, 0]].concat()),
        ("a context that was not agreed on", 99, PDataValueType::Command, echo()),
        ("a response", 1, PDataValueType::Command, command(&[(0x100, &[1, 0x80]), (0x120, &[1, 0]), (0x800, &[1, 1])])),
        ("C-STORE without a data set", 1, PDataValueType::Command, command(&[(0x100, &[1, 0]), (0x110, &[1, 0]), (0x800, &[1, 1])])),
    ];
    for (what, context, value_type, data) in cases {
        let mut peer = Peer::associated(&service);
        peer.value(context, value_type, true, data).unwrap();
        peer.is_ended(what);
    }
    // What is well formed and asks for something else is answered.
    let find = command(&[(0x100, &[0x20, 0]), (0x110, &[7, 0]), (0x800, &[1, 1])]);
    bystander.value(1, PDataValueType::Command, true, find).unwrap();
    assert_eq!(status(bystander.receive()), 0x0211);
    bystander.value(3, PDataValueType::Command, false, echo()[..9].to_vec()).unwrap();
    bystander.value(3, PDataValueType::Command, true, echo()[9..].to_vec()).unwrap();
    assert_eq!(status(bystander.receive()), 0);
    let nowhere =
        command(&[(2, b"1.2.840.10008.5.1.4.1.1.2\0"), (0x100, &[1, 0]), (0x110, &[1, 0]), (0x800, &[1, 0]), (0x1000, b"1.2.3\0")]);
    bystander.value(1, PDataValueType::Command, true, nowhere).unwrap();
    bystander.value(1, PDataValueType::Data, true, vec![0; 1000]).unwrap();
    assert_eq!(status(bystander.receive()), 0x0122);
    // A data set of noise, and one that claims 4 GiB.
    for data in [noise[..1000].to_vec(), [&[8, 0, 5, 0][..], &[0xfe, 0xff, 0xff, 0xff], b"tiny"].concat()] {
        bystander.value(1, PDataValueType::Command, true, store()).unwrap();
        bystander.value(1, PDataValueType::Data, true, data).unwrap();
        assert_eq!(status(bystander.receive()), 0xC000);
    }
    bystander.send(&Pdu::ReleaseRQ).unwrap();
    assert!(matches!(bystander.receive(), Some(Pdu::ReleaseRP)));
    assert!(service.is_alive());
    let growth = service.peak_mib() - before;
    assert!(growth < MOST_GROWTH_MIB, "{growth:.0} MiB");
    is_answered(&service, "nonsense");
}

#[test]
fn objects_and_command_sets_without_end_are_ended_in_bounded_memory() {
    if !has_dcmtk() {
        return;
    }
    let data = Directory::new("dimse-endless");
    let mut service = service(&data, &["--max-body-mb", "16"]);
    let before = service.peak_mib();
    let start = Instant::now();
    std::thread::scope(|scope| {
        for _ in 0..4 {
            scope.spawn(|| {
                let mut peer = Peer::associated(&service);
                peer.value(1, PDataValueType::Command, true, store()).unwrap();
                let mut sent = 0_u64;
                while sent < 1 << 30 && peer.value(1, PDataValueType::Data, false, vec![7; 200_000]).is_ok() {
                    sent += 200_000;
                }
                assert!(sent < 256 << 20, "{sent} bytes were taken");
                peer.is_ended("an object without end");
            });
        }
        is_answered(&service, "objects without end");
    });
    let mut peer = Peer::associated(&service);
    for _ in 0..200 {
        let _ = peer.value(1, PDataValueType::Command, false, vec![0; 1000]);
    }
    peer.is_ended("a command set without end");
    // What is too large and has an end is answered for, and the association goes on.
    let mut peer = Peer::associated(&service);
    peer.value(1, PDataValueType::Command, true, store()).unwrap();
    for part in 0..100 {
        peer.value(1, PDataValueType::Data, part == 99, vec![7; 200_000]).unwrap();
    }
    assert_eq!(status(peer.receive()), 0xA700);
    peer.value(3, PDataValueType::Command, true, echo()).unwrap();
    assert_eq!(status(peer.receive()), 0);
    let growth = service.peak_mib() - before;
    assert!(growth < MOST_GROWTH_MIB, "{growth:.0} MiB");
    assert!(start.elapsed() < Duration::from_mins(1), "{:?}", start.elapsed());
    assert!(service.is_alive());
}

#[test]
fn a_stop_ends_associations_and_lets_an_object_under_way_arrive() {
    if !has_dcmtk() {
        return;
    }
    let data = Directory::new("dimse-stop");
    let file = parted::ungated(1);
    let object = dicom_object::from_reader(file.as_slice()).unwrap();
    let uid = object.meta().media_storage_sop_instance_uid.trim_end_matches('\0').to_owned();
    let mut data_set = Vec::new();
    object
        .into_inner()
        .write_dataset_with_ts(&mut data_set, &dicom_transfer_syntax_registry::entries::IMPLICIT_VR_LITTLE_ENDIAN.erased())
        .unwrap();
    let mut padded = uid.into_bytes();
    if padded.len() % 2 == 1 {
        padded.push(0);
    }
    let class = format!("{NM}\0");
    let store =
        command(&[(2, class.as_bytes()), (0x100, &[1, 0]), (0x110, &[1, 0]), (0x700, &[0, 0]), (0x800, &[1, 0]), (0x1000, &padded)]);

    let running = service(&data, &[]);
    let (mut idle, mut busy) = (Peer::associated(&running), Peer::associated(&running));
    busy.value(1, PDataValueType::Command, true, store).unwrap();
    let (first, rest) = data_set.split_at(data_set.len() / 2);
    busy.value(1, PDataValueType::Data, false, first.to_vec()).unwrap();
    std::thread::sleep(Duration::from_millis(300));
    running.signal("TERM");
    idle.is_ended("an idle association of a service that stops");
    busy.value(1, PDataValueType::Data, true, rest.to_vec()).unwrap();
    assert_eq!(status(busy.receive()), 0, "the object was under way before");
    busy.is_ended("the association of a service that stops");
    assert!(running.ended(Duration::from_secs(30)).success());
    // It is there after the next start.
    let again = service(&data, &[]);
    let jobs = again.get("/v1/reconstructions").json();
    let id = jobs["reconstructions"][0]["id"].as_str().unwrap().to_owned();
    assert_eq!(again.finished(&id, Duration::from_mins(2))["state"], "succeeded");
}
