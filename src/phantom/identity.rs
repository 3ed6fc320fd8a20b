//! UIDs that depend on the parameters alone: the same phantom is the same study wherever it is made.

use super::Phantom;
use crate::elements::uid;

/// Study, series and instance UID of a phantom.
pub(super) fn uids_of(phantom: &Phantom) -> (String, String, String) {
    // What was written before there was regional function keeps its UIDs.
    let described = format!("{phantom:?}").replace(", regional: []", "");
    (uid("study", described.as_bytes()), uid("series", described.as_bytes()), uid("instance", described.as_bytes()))
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
