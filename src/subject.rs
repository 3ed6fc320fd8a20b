//! Whom a study is of, as far as a result must say it to be filed with the study: the patient and study attributes of the DICOM file, byte
//! for byte. Kept only where the operator asks for it, apart from everything else, and written into DICOM results only.
//!
//! Values stay as they were received, in the file's own character set: converting a name could lose letters, and whoever files the result
//! compares names with those it has.

use base64::{Engine as _, engine::general_purpose::STANDARD};
use serde::{Deserialize, Serialize};
use std::{collections::BTreeMap, fmt};

/// An attribute of the patient or the study that results repeat (DICOM PS3.3 C.7.1.1, C.7.2.1, C.12.1).
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Attribute {
    /// Specific Character Set (0008,0005), in which the others are written.
    SpecificCharacterSet,
    /// Study Date (0008,0020).
    StudyDate,
    /// Study Time (0008,0030).
    StudyTime,
    /// Accession Number (0008,0050).
    AccessionNumber,
    /// Referring Physician's Name (0008,0090).
    ReferringPhysicianName,
    /// Patient's Name (0010,0010).
    PatientName,
    /// Patient ID (0010,0020).
    PatientId,
    /// Issuer of Patient ID (0010,0021).
    IssuerOfPatientId,
    /// Patient's Birth Date (0010,0030).
    PatientBirthDate,
    /// Patient's Sex (0010,0040).
    PatientSex,
    /// Study ID (0020,0010).
    StudyId,
}

/// What a value may consist of.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Form {
    /// Digits and these.
    Digits(&'static [u8]),
    /// Capital letters, digits, space, underscore and these.
    Code(&'static [u8]),
    /// Anything that can be printed, and the escapes between character sets.
    Text,
}

impl Attribute {
    /// All of them, by tag.
    pub const ALL: [Self; 11] = [
        Self::SpecificCharacterSet,
        Self::StudyDate,
        Self::StudyTime,
        Self::AccessionNumber,
        Self::ReferringPhysicianName,
        Self::PatientName,
        Self::PatientId,
        Self::IssuerOfPatientId,
        Self::PatientBirthDate,
        Self::PatientSex,
        Self::StudyId,
    ];

    /// Group and element.
    pub fn tag(self) -> (u16, u16) {
        match self {
            Self::SpecificCharacterSet => (0x0008, 0x0005),
            Self::StudyDate => (0x0008, 0x0020),
            Self::StudyTime => (0x0008, 0x0030),
            Self::AccessionNumber => (0x0008, 0x0050),
            Self::ReferringPhysicianName => (0x0008, 0x0090),
            Self::PatientName => (0x0010, 0x0010),
            Self::PatientId => (0x0010, 0x0020),
            Self::IssuerOfPatientId => (0x0010, 0x0021),
            Self::PatientBirthDate => (0x0010, 0x0030),
            Self::PatientSex => (0x0010, 0x0040),
            Self::StudyId => (0x0020, 0x0010),
        }
    }

    /// Most bytes of a value and what it may consist of (PS3.5 6.2). Lengths there are in characters: four bytes each, and for names as much
    /// again for escapes.
    fn form(self) -> (usize, Form) {
        match self {
            Self::SpecificCharacterSet => (256, Form::Code(b"\\-")),
            Self::StudyDate | Self::PatientBirthDate => (10, Form::Digits(b".")),
            Self::StudyTime => (16, Form::Digits(b".:")),
            Self::PatientSex => (16, Form::Code(b"")),
            Self::AccessionNumber | Self::StudyId => (128, Form::Text),
            Self::PatientId | Self::IssuerOfPatientId => (512, Form::Text),
            Self::PatientName | Self::ReferringPhysicianName => (1536, Form::Text),
        }
    }

    fn accepts(self, value: &[u8]) -> bool {
        let (longest, form) = self.form();
        let allowed = |byte: &u8| match form {
            Form::Digits(others) => byte.is_ascii_digit() || others.contains(byte),
            Form::Code(others) => byte.is_ascii_uppercase() || byte.is_ascii_digit() || b" _".contains(byte) || others.contains(byte),
            // Escape begins another character set (ISO 2022).
            Form::Text => *byte >= 0x20 && *byte != 0x7f || *byte == 0x1b,
        };
        value.len() <= longest && value.iter().all(allowed)
    }
}

/// The attributes of one study that results repeat. Shows nothing of them where it is logged or printed.
#[derive(Clone, Default, PartialEq, Eq)]
pub struct Subject {
    values: BTreeMap<Attribute, Vec<u8>>,
}

impl fmt::Debug for Subject {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str("Subject(…)")
    }
}

/// The bytes are not a stored subject.
#[derive(Debug, thiserror::Error)]
#[error("not a stored subject")]
pub struct NotASubject;

impl Subject {
    /// Takes the value of an attribute as the file has it, without the padding at its end. Returns whether it can be: a value that is longer
    /// than DICOM allows or that no such attribute can have is not kept, not even in part, since half an identifier is another patient's.
    #[must_use]
    pub fn put(&mut self, attribute: Attribute, value: &[u8]) -> bool {
        let end = value.iter().rposition(|byte| !matches!(byte, b' ' | 0)).map_or(0, |last| last + 1);
        let value = &value[..end];
        if !attribute.accepts(value) {
            return false;
        }
        if !value.is_empty() {
            self.values.insert(attribute, value.to_vec());
        }
        true
    }

    /// The value of an attribute, never empty.
    pub fn get(&self, attribute: Attribute) -> Option<&[u8]> {
        self.values.get(&attribute).map(Vec::as_slice)
    }

    /// The form in which it is stored: JSON, each value in base64.
    pub fn encode(&self) -> Vec<u8> {
        let stored: BTreeMap<Attribute, String> =
            self.values.iter().map(|(attribute, value)| (*attribute, STANDARD.encode(value))).collect();
        serde_json::to_vec(&stored).unwrap_or_default()
    }

    /// What [`Self::encode`] wrote.
    ///
    /// # Errors
    /// [`NotASubject`], which says nothing of the content.
    pub fn decode(bytes: &[u8]) -> Result<Self, NotASubject> {
        let stored: BTreeMap<Attribute, String> = serde_json::from_slice(bytes).map_err(|_| NotASubject)?;
        let mut subject = Self::default();
        for (attribute, value) in stored {
            let value = STANDARD.decode(value).map_err(|_| NotASubject)?;
            if !subject.put(attribute, &value) {
                return Err(NotASubject);
            }
        }
        Ok(subject)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes_are_kept_as_they_were_and_come_back() {
        let mut subject = Subject::default();
        // Yamada^Tarou in JIS X 0208 by escapes, as PS3.5 H.3.2 has it.
        let name = b"Yamada^Tarou=\x1b$B;3ED\x1b(B^\x1b$BB@O:\x1b(B";
        assert!(subject.put(Attribute::PatientName, name));
        assert!(subject.put(Attribute::SpecificCharacterSet, b"\\ISO 2022 IR 87 "));
        assert!(subject.put(Attribute::PatientId, b"0042\0"));
        assert!(subject.put(Attribute::StudyId, b"  "));
        let again = Subject::decode(&subject.encode()).unwrap();
        assert_eq!(again, subject);
        assert_eq!(again.get(Attribute::PatientName), Some(name.as_slice()));
        assert_eq!(again.get(Attribute::SpecificCharacterSet), Some(b"\\ISO 2022 IR 87".as_slice()));
        assert_eq!(again.get(Attribute::PatientId), Some(b"0042".as_slice()));
        assert_eq!(again.get(Attribute::StudyId), None, "blank is absent");
    }

    #[test]
    fn what_no_such_attribute_can_have_is_left_out_whole() {
        let mut subject = Subject::default();
        for (attribute, value) in [
            (Attribute::PatientId, [b'1'; 513].as_slice()),
            (Attribute::PatientName, &[b'N'; 1537]),
            (Attribute::PatientBirthDate, b"yesterday"),
            (Attribute::StudyDate, b"20260101-20260102"),
            (Attribute::PatientSex, b"m\n"),
            (Attribute::AccessionNumber, b"A\x00B"),
            (Attribute::SpecificCharacterSet, b"\x1b$B"),
        ] {
            assert!(!subject.put(attribute, value), "{attribute:?}");
            assert_eq!(subject.get(attribute), None);
        }
        assert_eq!(subject, Subject::default());
    }

    #[test]
    fn nothing_of_it_is_printed() {
        let mut subject = Subject::default();
        assert!(subject.put(Attribute::PatientName, b"DOE^JANE"));
        assert_eq!(format!("{subject:?}"), "Subject(…)");
        let error = Subject::decode(b"{\"patient_name\":\"DOE^JANE\"}").unwrap_err();
        assert_eq!(error.to_string(), "not a stored subject");
    }
}
