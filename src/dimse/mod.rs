//! DICOM's own network protocol (PS3.8, PS3.7): who sends images here (C-STORE, C-ECHO), and how a result is sent (C-STORE).
//!
//! The bytes of the protocol's messages are read and written by `dicom-ul`; who may say what when, for how long and how much, is decided here.
//! Every association has a task of its own, a limit on everything that it sends, and an end to every wait.
//!
//! | file | what it is |
//! |---|---|
//! | `peer.rs` | a connection that carries protocol data units, each within its limit and time |
//! | `command.rs` | command sets: what is asked and answered |
//! | `negotiate.rs` | what of a request for an association is accepted |
//! | `association.rs` | one association that was accepted: echo, store, end |
//! | `object.rs` | an object as it arrives, and how much memory all of them may have |
//! | `listener.rs` | who is let in, and how it stops |
//! | `send.rs` | one object sent over a connection |

mod association;
mod command;
mod listener;
mod negotiate;
mod object;
mod peer;
mod send;

pub use listener::{Listener, Settings, start};
pub use send::{SendError, Title, send};

/// Application Context Name of DICOM (PS3.7 A.2.1).
const APPLICATION_CONTEXT: &str = "1.2.840.10008.3.1.1.1";
/// Verification SOP Class: C-ECHO (PS3.4 A.4).
const VERIFICATION: &str = "1.2.840.10008.1.1";
/// Implicit VR Little Endian, which everybody must take (PS3.5 10.1), and the encoding of every command set.
const IMPLICIT_LITTLE_ENDIAN: &str = "1.2.840.10008.1.2";
/// Explicit VR Little Endian.
const EXPLICIT_LITTLE_ENDIAN: &str = "1.2.840.10008.1.2.1";

/// Longest AE title.
const LONGEST_TITLE: usize = 16;

/// Whether a text can be the name of an application: 1 to 16 printable characters of ASCII, no backslash, no space at its ends (PS3.5 table
/// 6.2-1, AE).
pub fn is_ae_title(text: &str) -> bool {
    let printable = text.bytes().all(|byte| matches!(byte, b' '..=b'~') && byte != b'\\');
    (1..=LONGEST_TITLE).contains(&text.len()) && printable && text.trim_matches(' ') == text
}

/// A title that someone else chose, as the log may show it.
fn shown(title: &str) -> String {
    let plain = |letter: char| if letter.is_ascii_alphanumeric() || "-_. ".contains(letter) { letter } else { '?' };
    title.chars().take(LONGEST_TITLE).map(plain).collect()
}

/// Whether a text is a UID: digits and dots, at most 64.
fn is_uid(text: &str) -> bool {
    (1..=64).contains(&text.len()) && text.bytes().all(|byte| byte.is_ascii_digit() || byte == b'.')
}

/// What both sides say of themselves and of the longest protocol data unit they take.
fn own_variables() -> Vec<dicom_ul::pdu::UserVariableItem> {
    use dicom_ul::pdu::UserVariableItem;
    vec![
        UserVariableItem::MaxLength(peer::MOST_PDU_BYTES),
        UserVariableItem::ImplementationClassUID(crate::elements::IMPLEMENTATION_UID.to_owned()),
        UserVariableItem::ImplementationVersionName("VENTRICLE".to_owned()),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn titles_are_those_of_the_standard_and_shown_without_what_could_break_a_line() {
        for right in ["A", "ORTHANC", "VENTRICLE_2", "a b", "ABCDEFGHIJKLMNOP"] {
            assert!(is_ae_title(right), "{right}");
        }
        for wrong in ["", " A", "A ", "ABCDEFGHIJKLMNOPQ", "A\\B", "Ä", "A\n"] {
            assert!(!is_ae_title(wrong), "{wrong:?}");
        }
        assert_eq!(shown("PACS-1\n\u{1b}[31m"), "PACS-1???31m");
        assert!(is_uid("1.2.840") && !is_uid("") && !is_uid("1.2/..") && !is_uid(&"1".repeat(65)));
    }
}
