//! Command sets (PS3.7 E): a flat list of elements of group 0000, in implicit VR little endian whatever was negotiated. Read by a loop of our
//! own, as general parsers believe declared lengths.

/// C-STORE-RQ (PS3.7 table E.1-1); its response has the highest bit too, as every one.
pub(super) const C_STORE: u16 = 0x0001;
/// C-ECHO-RQ.
pub(super) const C_ECHO: u16 = 0x0030;
/// C-CANCEL-RQ, which is not answered.
pub(super) const C_CANCEL: u16 = 0x0FFF;
/// The bit of a response.
pub(super) const RESPONSE: u16 = 0x8000;

/// Success (PS3.7 annex C).
pub(super) const SUCCESS: u16 = 0x0000;
/// Invalid SOP Instance.
pub(super) const INVALID_INSTANCE: u16 = 0x0117;
/// SOP Class not supported.
pub(super) const CLASS_NOT_SUPPORTED: u16 = 0x0122;
/// Unrecognized operation.
pub(super) const UNRECOGNIZED: u16 = 0x0211;
/// Out of resources (PS3.4 table B.2-1).
pub(super) const OUT_OF_RESOURCES: u16 = 0xA700;

/// Command Data Set Type of a message without a data set.
const NO_DATA_SET: u16 = 0x0101;
/// Longest Error Comment (0000,0902), an LO.
const LONGEST_COMMENT: usize = 64;

const GROUP_LENGTH: u16 = 0x0000;
const AFFECTED_CLASS: u16 = 0x0002;
const FIELD: u16 = 0x0100;
const MESSAGE_ID: u16 = 0x0110;
const RESPONDS_TO: u16 = 0x0120;
const PRIORITY: u16 = 0x0700;
const DATA_SET_TYPE: u16 = 0x0800;
const STATUS: u16 = 0x0900;
const ERROR_COMMENT: u16 = 0x0902;
const AFFECTED_INSTANCE: u16 = 0x1000;

/// What is asked or answered.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(super) struct Command {
    /// What it is.
    pub(super) field: u16,
    /// Message ID of a request, or Message ID Being Responded To.
    pub(super) message_id: u16,
    /// Affected SOP Class UID.
    pub(super) class_uid: String,
    /// Affected SOP Instance UID.
    pub(super) instance_uid: String,
    /// Whether a data set follows.
    pub(super) has_data: bool,
    /// Status of a response.
    pub(super) status: u16,
}

impl Command {
    /// Reads a command set; `None` if it is none.
    pub(super) fn parse(mut bytes: &[u8]) -> Option<Self> {
        let mut command = Self::default();
        let (mut field, mut data_set) = (None, None);
        while !bytes.is_empty() {
            let (head, rest) = bytes.split_first_chunk::<8>()?;
            let (group, element) = (u16::from_le_bytes([head[0], head[1]]), u16::from_le_bytes([head[2], head[3]]));
            let length = u32::from_le_bytes([head[4], head[5], head[6], head[7]]);
            let (value, rest) = rest.split_at_checked(usize::try_from(length).ok()?)?;
            bytes = rest;
            if group != 0 {
                return None;
            }
            match element {
                FIELD => field = Some(number(value)?),
                DATA_SET_TYPE => data_set = Some(number(value)?),
                MESSAGE_ID | RESPONDS_TO => command.message_id = number(value)?,
                STATUS => command.status = number(value)?,
                AFFECTED_CLASS => command.class_uid = uid(value),
                AFFECTED_INSTANCE => command.instance_uid = uid(value),
                _ => {}
            }
        }
        command.field = field?;
        command.has_data = data_set? != NO_DATA_SET;
        Some(command)
    }

    /// C-STORE-RQ of medium priority.
    pub(super) fn store(message_id: u16, class_uid: &str, instance_uid: &str) -> Vec<u8> {
        let mut elements = Vec::new();
        text(&mut elements, AFFECTED_CLASS, class_uid, 0);
        element(&mut elements, FIELD, &C_STORE.to_le_bytes());
        element(&mut elements, MESSAGE_ID, &message_id.to_le_bytes());
        element(&mut elements, PRIORITY, &0_u16.to_le_bytes());
        element(&mut elements, DATA_SET_TYPE, &1_u16.to_le_bytes());
        text(&mut elements, AFFECTED_INSTANCE, instance_uid, 0);
        with_length(&elements)
    }

    /// The response to this request.
    pub(super) fn response(&self, status: u16, comment: Option<&str>) -> Vec<u8> {
        let mut elements = Vec::new();
        if super::is_uid(&self.class_uid) {
            text(&mut elements, AFFECTED_CLASS, &self.class_uid, 0);
        }
        element(&mut elements, FIELD, &(self.field | RESPONSE).to_le_bytes());
        element(&mut elements, RESPONDS_TO, &self.message_id.to_le_bytes());
        element(&mut elements, DATA_SET_TYPE, &NO_DATA_SET.to_le_bytes());
        element(&mut elements, STATUS, &status.to_le_bytes());
        if let Some(comment) = comment {
            text(&mut elements, ERROR_COMMENT, &short(comment), b' ');
        }
        if super::is_uid(&self.instance_uid) {
            text(&mut elements, AFFECTED_INSTANCE, &self.instance_uid, 0);
        }
        with_length(&elements)
    }
}

fn number(value: &[u8]) -> Option<u16> {
    Some(u16::from_le_bytes(*value.first_chunk()?))
}

/// A UID without its padding; what is none becomes empty.
fn uid(value: &[u8]) -> String {
    let text = String::from_utf8_lossy(value);
    let text = text.trim_matches([' ', '\0']);
    if super::is_uid(text) { text.to_owned() } else { String::new() }
}

/// A sentence as an LO has it: 64 characters of ASCII without backslash.
fn short(comment: &str) -> String {
    let plain = |letter: char| if matches!(letter, ' '..='~') && letter != '\\' { letter } else { '?' };
    let comment: String = comment.chars().map(plain).collect();
    if comment.len() <= LONGEST_COMMENT { comment } else { format!("{}...", &comment[..LONGEST_COMMENT - 3]) }
}

fn text(elements: &mut Vec<u8>, number: u16, value: &str, padding: u8) {
    let mut value = value.as_bytes().to_vec();
    if !value.len().is_multiple_of(2) {
        value.push(padding);
    }
    element(elements, number, &value);
}

fn element(elements: &mut Vec<u8>, number: u16, value: &[u8]) {
    elements.extend_from_slice(&[0, 0]);
    elements.extend_from_slice(&number.to_le_bytes());
    elements.extend_from_slice(&(value.len() as u32).to_le_bytes());
    elements.extend_from_slice(value);
}

/// With the length of all of it before it, which must be there.
fn with_length(elements: &[u8]) -> Vec<u8> {
    let mut all = Vec::with_capacity(elements.len() + 12);
    element(&mut all, GROUP_LENGTH, &(elements.len() as u32).to_le_bytes());
    all.extend_from_slice(elements);
    all
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_written_is_read_again() {
        let bytes = Command::store(7, "1.2.840.10008.5.1.4.1.1.20", "1.2.3");
        let request = Command::parse(&bytes).unwrap();
        let expected = Command {
            field: C_STORE,
            message_id: 7,
            class_uid: "1.2.840.10008.5.1.4.1.1.20".to_owned(),
            instance_uid: "1.2.3".to_owned(),
            has_data: true,
            status: 0,
        };
        assert_eq!(request, expected);
        // Group length: all that follows it.
        assert_eq!(u32::from_le_bytes(bytes[8..12].try_into().unwrap()) as usize, bytes.len() - 12);
        let response = Command::parse(&request.response(0xA700, Some("The queue is full."))).unwrap();
        assert_eq!(response, Command { field: 0x8001, has_data: false, status: 0xA700, ..expected });
    }

    #[test]
    fn what_is_no_command_set_is_refused() {
        let good = Command::store(1, "1.2", "1.2.3");
        assert!(Command::parse(&[]).is_none());
        for cut in 1..good.len() {
            // Cut between elements it may lack what every command has; cut elsewhere it is none.
            let parsed = Command::parse(&good[..cut]);
            assert!(parsed.is_none_or(|command| command.field == C_STORE && command.has_data), "{cut}");
        }
        let claims_4_gib = [&[0, 0, 0, 1], &u32::MAX.to_le_bytes()[..], &[1, 0]].concat();
        assert!(Command::parse(&claims_4_gib).is_none());
        let other_group = [&[8, 0, 0, 1, 2, 0, 0, 0, 1, 0][..], &good].concat();
        assert!(Command::parse(&other_group).is_none());
    }

    #[test]
    fn comments_fit_into_their_element() {
        let command = Command { field: C_STORE, ..Command::default() };
        let bytes = command.response(0xC000, Some(&format!("a\\b\u{e4}{}", "c".repeat(100))));
        let comment = bytes.windows(4).position(|window| window == [0, 0, 2, 9]).unwrap();
        assert_eq!(&bytes[comment + 4..comment + 8], &[64, 0, 0, 0]);
        let text = &bytes[comment + 8..comment + 72];
        assert!(text.starts_with(b"a?b?ccc") && text.ends_with(b"ccc..."), "{}", String::from_utf8_lossy(text));
    }
}
