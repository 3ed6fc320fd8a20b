//! UIDs that depend on the parameters alone: the same phantom is the same study wherever it is made.

use super::Phantom;
use sha2::{Digest, Sha256};

/// Study, series and instance UID of a phantom.
pub(super) fn uids_of(phantom: &Phantom) -> (String, String, String) {
    let described = format!("{phantom:?}");
    (uid("study", described.as_bytes()), uid("series", described.as_bytes()), uid("instance", described.as_bytes()))
}

/// A UID under 2.25 (ISO/IEC 9834-8: a UUID as one number) from the hash of a purpose and a description.
pub(super) fn uid(purpose: &str, described: &[u8]) -> String {
    let hash = Sha256::new().chain_update(purpose).chain_update([0]).chain_update(described).finalize();
    let mut number = [0; 16];
    number.copy_from_slice(&hash[..16]);
    // Version 8 (custom) and the RFC 9562 variant, so that the number is a valid UUID.
    number[6] = (number[6] & 0x0f) | 0x80;
    number[8] = (number[8] & 0x3f) | 0x80;
    format!("2.25.{}", u128::from_be_bytes(number))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn uids_are_valid_and_depend_on_the_parameters() {
        let (study, series, instance) = uids_of(&Phantom::demo());
        for uid in [&study, &series, &instance] {
            assert!(uid.len() <= 64 && uid.starts_with("2.25."), "{uid}");
            assert!(uid[5..].parse::<u128>().is_ok());
        }
        assert!(study != series && series != instance);
        assert_eq!(study, uids_of(&Phantom::demo()).0);
        let mut other = Phantom::demo();
        other.imaging.noise_seed = Some(2);
        assert_ne!(study, uids_of(&other).0);
    }
}
