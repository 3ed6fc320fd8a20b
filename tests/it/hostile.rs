//! Files that are broken, lie about their size or are no study: refused precisely, in bounded time and memory, with the service alive.

use crate::{
    served::{Directory, Served},
    shared,
};
use std::time::{Duration, Instant};
use ventricle::phantom::{self, Imaging, Phantom, Shape, Ventricle};

/// What a refusal may add to the peak of the service's memory, over all files.
const MOST_GROWTH_MIB: f64 = 300.0;
/// A refusal is a matter of milliseconds; this is a hang.
const LONGEST: Duration = Duration::from_secs(2);

fn assert_refused(service: &mut Served, what: &str, media_type: &str, body: &[u8]) {
    let start = Instant::now();
    let answer = service.post(media_type, body);
    let problem = String::from_utf8_lossy(&answer.body).into_owned();
    assert!((400..500).contains(&answer.status), "{what}: {} {problem}", answer.status);
    assert_eq!(answer.media_type, "application/problem+json", "{what}");
    for member in ["code", "title", "detail"] {
        assert!(answer.json()[member].as_str().is_some_and(|text| text.len() > 3), "{what}: no {member} in {problem}");
    }
    assert!(start.elapsed() < LONGEST, "{what}: {:?}", start.elapsed());
    assert!(service.is_alive(), "{what} ended the service");
}

fn assert_still_works(service: &Served) {
    let imaging = Imaging { gates: 1, ..Imaging::default() };
    let phantom = Phantom { imaging, ..Phantom::of(Shape::Ventricle(Ventricle::NORMAL)) };
    let good = phantom::dicom::write(&phantom::simulate(&phantom).unwrap().study).unwrap();
    let accepted = service.post("application/dicom", &good);
    assert_eq!(accepted.status, 202, "{}", String::from_utf8_lossy(&accepted.body));
    let job = service.finished(accepted.json()["id"].as_str().unwrap(), Duration::from_mins(2));
    assert_eq!(job["state"], "succeeded", "{job}");
}

#[test]
fn every_broken_or_foreign_file_is_refused() {
    let mut files = Vec::new();
    for name in ["corrupt", "negatives", "other-nm", "projections"] {
        let Some(folder) = shared::folder(name) else { return };
        files.extend(std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()));
    }
    files.sort();
    assert!(files.len() > 40, "{}", files.len());
    let data = Directory::new("hostile");
    let mut service = Served::start(&data.0, &[]);
    let before = service.peak_mib();
    for file in &files {
        let body = std::fs::read(file).unwrap();
        assert_refused(&mut service, &file.display().to_string(), "application/dicom", &body);
    }
    let growth = service.peak_mib() - before;
    assert!(growth < MOST_GROWTH_MIB, "{growth:.0} MiB");
    assert_still_works(&service);
}

#[test]
fn generated_bombs_are_refused() {
    let data = Directory::new("bombs");
    let mut service = Served::start(&data.0, &[]);
    let before = service.peak_mib();
    for (what, media_type, body) in bombs() {
        assert_refused(&mut service, what, media_type, &body);
    }
    let growth = service.peak_mib() - before;
    assert!(growth < MOST_GROWTH_MIB, "{growth:.0} MiB");
    assert_still_works(&service);
}

fn bombs() -> Vec<(&'static str, &'static str, Vec<u8>)> {
    let claims_4_gib = part10("1.2.840.10008.1.2.1", &[b"\x08\x00\x05\x00UN\0\0\xfe\xff\xff\xff".as_slice(), b"tiny"].concat());
    let mut nested = Vec::new();
    for _ in 0..5000 {
        nested.extend_from_slice(b"\x08\x00\x15\x11SQ\0\0\xff\xff\xff\xff\xfe\xff\x00\xe0\xff\xff\xff\xff");
    }
    let nested = part10("1.2.840.10008.1.2.1", &nested);
    let zeros = vec![0_u8; 200 << 20];
    let mut deflate = flate2::write::DeflateEncoder::new(Vec::new(), flate2::Compression::fast());
    std::io::Write::write_all(&mut deflate, &zeros).unwrap();
    let deflated = part10("1.2.840.10008.1.2.1.99", &deflate.finish().unwrap());
    let mut gzip = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
    std::io::Write::write_all(&mut gzip, &zeros).unwrap();
    let gzipped = gzip.finish().unwrap();
    let header = "{'descr': '<f4', 'fortran_order': False, 'shape': (64, 30000, 10000), }";
    let npy = [b"\x93NUMPY\x01\x00".as_slice(), &u16::try_from(header.len()).unwrap().to_le_bytes(), header.as_bytes()].concat();
    let json = br#"{"grid":{"gates":8,"shape":[4000000000,4000000000,4000000000],"spacing_mm":[1,1,1]},"counts":"","dtype":"uint16"}"#;
    vec![
        ("a DICOM element that claims 4 GiB", "application/dicom", claims_4_gib),
        ("sequences nested 5000 deep", "application/dicom", nested),
        ("a deflate bomb", "application/dicom", deflated),
        ("a gzip bomb", "application/gzip", gzipped),
        ("an npy header that claims 77 GB", "application/x-npy", npy),
        ("a JSON grid that overflows", "application/json", json.to_vec()),
        ("nothing", "application/dicom", Vec::new()),
        ("noise", "application/octet-stream", (0..5000_u32).map(|i| (i.wrapping_mul(2_654_435_761) >> 13) as u8).collect()),
    ]
}

/// A Part-10 file with a transfer syntax and a data set.
fn part10(transfer_syntax: &str, data_set: &[u8]) -> Vec<u8> {
    let mut uid = transfer_syntax.as_bytes().to_vec();
    if uid.len() % 2 == 1 {
        uid.push(0);
    }
    let element = [b"\x02\x00\x10\x00UI".as_slice(), &u16::try_from(uid.len()).unwrap().to_le_bytes(), &uid].concat();
    let length = [b"\x02\x00\x00\x00UL\x04\x00".as_slice(), &u32::try_from(element.len()).unwrap().to_le_bytes()].concat();
    [vec![0; 128], b"DICM".to_vec(), length, element, data_set.to_vec()].concat()
}
