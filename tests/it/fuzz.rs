//! The fuzz targets on their corpus and on what a seeded generator makes of it: a word in every run about what the fuzzer does for longer.

use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use std::path::PathBuf;

#[path = "../../fuzz/targets.rs"]
mod targets;

/// A target by name.
type Target = (&'static str, fn(&[u8]));

const TARGETS: [Target; 7] = [
    ("prescan", targets::prescan),
    ("dicom", targets::dicom),
    ("nifti", targets::nifti),
    ("npy", targets::npy),
    ("json", targets::json),
    ("multipart", targets::multipart),
    ("frame_header", targets::frame_header),
];
/// Changed inputs of each target.
const CHANGED: usize = 400;
/// Bytes that all inputs may take in the repository.
const MOST_CORPUS_BYTES: usize = 200_000;

fn corpus(target: &str) -> Vec<Vec<u8>> {
    let folder = PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/fuzz/corpus")).join(target);
    let mut paths: Vec<PathBuf> = std::fs::read_dir(&folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    paths.sort();
    assert!(!paths.is_empty(), "{} is empty", folder.display());
    paths.into_iter().map(|path| std::fs::read(path).unwrap()).collect()
}

/// Bytes changed, cut, doubled or set to the values at which lengths turn.
fn change(bytes: &mut Vec<u8>, random: &mut ChaCha8Rng) {
    for _ in 0..random.random_range(1..6) {
        if bytes.is_empty() {
            return;
        }
        let place = random.random_range(0..bytes.len());
        match random.random_range(0..5) {
            0 => bytes[place] ^= 1 << random.random_range(0..8),
            1 => bytes[place] = [0, 1, 0x7F, 0x80, 0xFE, 0xFF][random.random_range(0..6)],
            2 => bytes.truncate(place),
            3 => {
                let end = bytes.len().min(place + 4);
                bytes[place..end].fill(0xFF);
            }
            _ => {
                let end = bytes.len().min(place + random.random_range(1..64));
                let piece = bytes[place..end].to_vec();
                bytes.splice(place..place, piece);
            }
        }
    }
}

#[test]
fn no_target_panics_on_its_corpus_or_near_it() {
    for (name, target) in TARGETS {
        let inputs = corpus(name);
        for input in &inputs {
            target(input);
        }
        let mut random = ChaCha8Rng::seed_from_u64(7);
        for round in 0..CHANGED {
            let mut input = inputs[round % inputs.len()].clone();
            change(&mut input, &mut random);
            target(&input);
        }
    }
}

#[test]
fn the_corpus_is_small() {
    let bytes: usize = TARGETS.iter().flat_map(|(name, _)| corpus(name)).map(|input| input.len()).sum();
    assert!(bytes < MOST_CORPUS_BYTES, "{bytes} bytes");
}
