//! What can be wrong with the structure of a DICOM file.

use crate::intake::error::Nature;
use dicom_core::Tag;

/// What is wrong with the structure of a DICOM file. Offsets count bytes of the file (of the inflated data set, if it is deflated).
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ScanError {
    /// A value reaches beyond its container.
    #[error(
        "the DICOM file is truncated or damaged: element {tag} at byte {offset} declares {declared} bytes where {remaining} remain; send the whole file"
    )]
    Truncated {
        /// The element.
        tag: Tag,
        /// Where its header begins.
        offset: usize,
        /// Its declared length.
        declared: u32,
        /// What remains of the file or of the enclosing item.
        remaining: usize,
    },
    /// The bytes end within a header or before a delimiter.
    #[error("the DICOM file is truncated: it ends at byte {offset} within {within}; send the whole file")]
    EndsEarly {
        /// Where it ends.
        offset: usize,
        /// Within what.
        within: String,
    },
    /// A header that no DICOM writer makes.
    #[error("the DICOM file is damaged: at byte {offset}, {found}")]
    Malformed {
        /// Where.
        offset: usize,
        /// What is there.
        found: String,
    },
    /// Sequences nested too deeply.
    #[error("the DICOM file nests sequences more than {limit} deep at byte {offset}")]
    TooDeep {
        /// Where.
        offset: usize,
        /// The limit.
        limit: usize,
    },
    /// Too many elements.
    #[error("the DICOM file has more than {limit} data elements")]
    TooManyElements {
        /// The limit.
        limit: usize,
    },
    /// A deflated data set over the cap.
    #[error("the deflated DICOM data set inflates to more than {limit} bytes")]
    InflatesTooLarge {
        /// The limit.
        limit: usize,
    },
    /// A deflated data set that does not inflate.
    #[error("the deflated DICOM data set is damaged: {reason}")]
    DamagedDeflate {
        /// What is wrong.
        reason: String,
    },
    /// File meta information without a transfer syntax.
    #[error(
        "the DICOM file has no Transfer Syntax UID (0002,0010) in its file meta information, so its data set cannot be read; export it again as a Part-10 file"
    )]
    NoTransferSyntax,
}

impl ScanError {
    /// Stable `snake_case` name of the reason.
    pub(in crate::intake) fn code(&self) -> &'static str {
        match self {
            Self::Truncated { .. } | Self::EndsEarly { .. } => "truncated_dicom",
            Self::Malformed { .. } | Self::DamagedDeflate { .. } => "malformed_dicom",
            Self::TooDeep { .. } => "dicom_too_deep",
            Self::TooManyElements { .. } => "dicom_too_many_elements",
            Self::InflatesTooLarge { .. } => "inflates_too_large",
            Self::NoTransferSyntax => "no_transfer_syntax",
        }
    }

    pub(in crate::intake) fn nature(&self) -> Nature {
        match self {
            Self::InflatesTooLarge { .. } => Nature::TooLarge,
            _ => Nature::Malformed,
        }
    }
}
