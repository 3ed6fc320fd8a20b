//! Files that are broken, lie about their size or are no study: refused precisely, in bounded time and memory, with the service alive.

use crate::{
    encapsulated::{phantom_file, with_fragments},
    served::{Directory, Served},
    shared,
};
use std::time::{Duration, Instant};
use ventricle::phantom::{self, Imaging, Phantom, Shape, Ventricle};

/// What a refusal may add to the peak of the service's memory, over all files.
const MOST_GROWTH_MIB: f64 = 300.0;
/// All that the process may hold, in MiB.
const MOST_MIB: f64 = 500.0;
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

#[test]
fn compressed_images_that_lie_are_refused() {
    let data = Directory::new("liars");
    let mut service = Served::start(&data.0, &[]);
    for (what, body) in liars() {
        assert_refused(&mut service, &what, "application/dicom", &body);
    }
    assert!(service.peak_mib() < MOST_MIB, "{:.0} MiB", service.peak_mib());
    assert_still_works(&service);
}

#[test]
fn multipart_without_end_is_refused() {
    let data = Directory::new("endless");
    let mut service = Served::start(&data.0, &[]);
    let header = b"X-Header: of no use to anybody\r\n";
    let part = b"--b\r\nContent-Disposition: form-data; name=\"file\"\r\n\r\nx\r\n";
    let begun = b"--b\r\n".as_slice();
    for (what, body) in [
        ("headers without end", [begun, &header.repeat(1_000_000)].concat()),
        ("one header without end", [begun, b"X: ", &vec![b'x'; 40 << 20]].concat()),
        ("parts without end", part.repeat(600_000)),
        ("a part without end", [&part[..part.len() - 2], &vec![0; 40 << 20]].concat()),
        ("boundaries only", b"--b\r\n".repeat(5_000_000)),
        ("no boundary at all", vec![b'-'; 40 << 20]),
    ] {
        assert!(body.len() < 64 << 20, "{what}: {}", body.len());
        for kind in ["multipart/form-data; boundary=b", "multipart/related; type=\"application/dicom\"; boundary=b"] {
            assert_refused(&mut service, what, kind, &body);
        }
    }
    assert!(service.peak_mib() < MOST_MIB, "{:.0} MiB", service.peak_mib());
    assert_still_works(&service);
}

/// Valid headers of a study, and pixel data that is not what it says.
fn liars() -> Vec<(String, Vec<u8>)> {
    const FRAMES: usize = 24;
    let native = phantom_file(1);
    let mut files = Vec::new();
    let mut add = |what: &str, uid: &str, frame: &[u8]| {
        let pieces = [vec![Vec::new()], vec![frame.to_vec(); FRAMES]].concat();
        files.push((what.to_owned(), with_fragments(&native, Some(uid), &pieces)));
    };
    let jpeg = |marker: u8, size: u16, precision: u8, scan: &[u8]| {
        let size = size.to_be_bytes();
        let frame = [[0xFF, marker, 0, 11, precision].as_slice(), &size, &size, &[1, 1, 0x11, 0]].concat();
        [[0xFF, 0xD8].as_slice(), &frame, &[0xFF, 0xDA, 0, 8, 1, 1, 0], scan, &[0x55; 200], &[0xFF, 0xD9]].concat()
    };
    let j2k = |size: u32, tile: u32, components: u16, rest: &[u8]| {
        let of_components = [15, 1, 1].repeat(usize::from(components));
        let sizes: Vec<u8> = [size, size, 0, 0, tile, tile, 0, 0].iter().flat_map(|value| value.to_be_bytes()).collect();
        let length = (38 + of_components.len() as u16).to_be_bytes();
        let start = [[0xFF, 0x4F, 0xFF, 0x51].as_slice(), &length, &[0, 0], &sizes, &components.to_be_bytes(), &of_components].concat();
        [start.as_slice(), rest, &[0xFF, 0xD9]].concat()
    };
    // 32 decomposition levels and 65 535 layers of precincts as small as there are.
    let style = [[0xFF, 0x52, 0, 45, 1, 2, 0xFF, 0xFF, 0, 32, 0, 0, 0, 1].as_slice(), &[0x11; 33]].concat();
    let deep = [style.as_slice(), &[0xFF, 0x5C, 0, 100, 0x40], &[0x40; 97]].concat();
    for (codec, uid, marker, scan) in [
        ("JPEG", "1.2.840.10008.1.2.4.50", 0xC0, [0, 63, 0]),
        ("JPEG Lossless", "1.2.840.10008.1.2.4.70", 0xC3, [1, 0, 0]),
        ("JPEG-LS", "1.2.840.10008.1.2.4.80", 0xF7, [0, 0, 0]),
    ] {
        let precision = if marker == 0xC0 { 8 } else { 16 };
        add(&format!("{codec} that claims 65535 × 65535"), uid, &jpeg(marker, 65_535, precision, &scan));
        add(&format!("{codec} that claims no rows"), uid, &jpeg(marker, 0, precision, &scan));
        add(&format!("{codec} with noise for samples"), uid, &jpeg(marker, 64, precision, &scan));
    }
    let uid = "1.2.840.10008.1.2.4.90";
    add("JPEG 2000 that claims 65535 × 65535", uid, &j2k(65_535, 65_535, 1, &[]));
    add("JPEG 2000 that claims 4 billion × 4 billion", uid, &j2k(u32::MAX, 1, 1, &[]));
    add("JPEG 2000 of 4096 tiles", uid, &j2k(64, 1, 1, &[]));
    add("JPEG 2000 of 16384 components", uid, &j2k(64, 64, 16_384, &[]));
    add("JPEG 2000 without tiles", uid, &j2k(64, 64, 1, &deep));
    let tile = [deep.as_slice(), &[0xFF, 0x90, 0, 10, 0, 0, 0, 0, 0, 0, 0, 1, 0xFF, 0x93], &[0x80; 4000]].concat();
    add("JPEG 2000 with layers without end", uid, &j2k(64, 64, 1, &tile));
    add(
        "RLE whose header points everywhere",
        "1.2.840.10008.1.2.5",
        &[[2_u32, 64, u32::MAX].map(u32::to_le_bytes).concat(), vec![0xFF; 60]].concat(),
    );
    add("RLE of 4 billion segments", "1.2.840.10008.1.2.5", &[0xFF; 64]);
    add("RLE cut in its header", "1.2.840.10008.1.2.5", &[2, 0, 0, 0]);
    let lossless = "1.2.840.10008.1.2.4.70";
    files.push(("190 000 fragments".to_owned(), with_fragments(&native, Some(lossless), &vec![Vec::new(); 190_000])));
    files.push(("a million fragments".to_owned(), with_fragments(&native, Some(lossless), &vec![Vec::new(); 1_000_000])));
    let mut beyond = with_fragments(&native, Some(lossless), &[Vec::new(), vec![0; 50]]);
    let at = beyond.len() - 8 - 50 - 4;
    beyond[at..at + 4].copy_from_slice(&0x7FFF_FFF0_u32.to_le_bytes());
    files.push(("a fragment longer than the file".to_owned(), beyond));
    files
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
    let mut nifti = vec![0; 352];
    nifti[..4].copy_from_slice(&348_i32.to_le_bytes());
    for (index, size) in [4_i16, 32_767, 32_767, 32_767, 64].into_iter().enumerate() {
        nifti[40 + 2 * index..42 + 2 * index].copy_from_slice(&size.to_le_bytes());
    }
    nifti[70..72].copy_from_slice(&16_i16.to_le_bytes());
    nifti[72..74].copy_from_slice(&32_i16.to_le_bytes());
    nifti[108..112].copy_from_slice(&352_f32.to_le_bytes());
    nifti[344..348].copy_from_slice(b"n+1\0");
    let header = "{'descr': '<f4', 'fortran_order': False, 'shape': (64, 30000, 10000), }";
    let npy = [b"\x93NUMPY\x01\x00".as_slice(), &u16::try_from(header.len()).unwrap().to_le_bytes(), header.as_bytes()].concat();
    let json = br#"{"grid":{"gates":8,"shape":[4000000000,4000000000,4000000000],"spacing_mm":[1,1,1]},"counts":"","dtype":"uint16"}"#;
    vec![
        ("a DICOM element that claims 4 GiB", "application/dicom", claims_4_gib),
        // Found by the fuzzer: it made the library take 1.2 GB.
        ("a value that is no whole number of its units", "application/dicom", include_bytes!("../../fuzz/corpus/dicom/misfit").to_vec()),
        ("sequences nested 5000 deep", "application/dicom", nested),
        ("a deflate bomb", "application/dicom", deflated),
        ("a gzip bomb", "application/gzip", gzipped),
        ("a NIfTI header that claims 9 PB", "application/x-nifti", nifti),
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
