//! Why something was not accepted: what was received, what is wrong with it, what to send instead.

use super::prescan::ScanError;

/// What the service reads; the end of every refusal that does not have better advice.
const ACCEPTED: &str =
    "send a reconstructed short-axis study: DICOM NM Image Storage with image type RECON GATED TOMO or RECON TOMO, NIfTI-1, NPY or JSON";

/// A text from a file or a client, fit for a sentence: short, without control characters.
pub(super) fn shown(text: &str) -> String {
    const MOST_CHARACTERS: usize = 200;
    let mut shown: String = text.chars().take(MOST_CHARACTERS).map(|c| if c.is_control() { '?' } else { c }).collect();
    if text.chars().nth(MOST_CHARACTERS).is_some() {
        shown.push('…');
    }
    shown
}

/// A sentence with a capital and a full stop, as problems and failed jobs have them.
pub(crate) fn sentence(text: &str) -> String {
    let mut letters = text.chars();
    let first = letters.next().map(|letter| letter.to_uppercase().collect::<String>()).unwrap_or_default();
    let end = if text.ends_with(['.', '!', '?']) { "" } else { "." };
    format!("{first}{}{end}", letters.as_str())
}

/// What kind of refusal an [`IntakeError`] is, for those who choose a status code.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Nature {
    /// The bytes do not follow their own format.
    Malformed,
    /// More than the limits of a request allow.
    TooLarge,
    /// A format, or an encoding within a format, that is not read here.
    Unsupported,
    /// Understood, and not something that can be reconstructed.
    Refused,
    /// Nothing is wrong with it, but with the service.
    Unavailable,
}

/// Why a request holds no study that can be reconstructed.
#[derive(Debug, thiserror::Error)]
pub enum IntakeError {
    /// No bytes at all.
    #[error("the request has no content; {ACCEPTED}")]
    Empty,
    /// Over a limit on bytes, before or after inflating.
    #[error("{what} {}, more than the limit of {limit} bytes", bytes.map_or_else(|| "inflates to too many bytes".to_owned(), |bytes| format!("has {bytes} bytes")))]
    TooLarge {
        /// What is too large.
        what: &'static str,
        /// Its bytes; unknown when inflating stopped at the limit.
        bytes: Option<usize>,
        /// The limit.
        limit: usize,
    },
    /// Nothing here recognises the content.
    #[error("{declared}the content begins with {begins}, which is no format that is read here; {ACCEPTED}")]
    UnknownFormat {
        /// What the request called it, as the beginning of a sentence, or empty.
        declared: String,
        /// What the first bytes are.
        begins: String,
    },
    /// Another format where only DICOM can be.
    #[error("received {received} where a DICOM file is expected; post other formats to /v1/reconstructions")]
    NotDicom {
        /// What it is.
        received: &'static str,
    },
    /// Several files that are not one study.
    #[error(
        "the files of the request do not make one study: {reason}; send the files of one series, and each series in a request of its own"
    )]
    MixedParts {
        /// Which parts, and why.
        reason: String,
    },
    /// One of several files.
    #[error("file {file} of the request: {source}")]
    InFile {
        /// Which, counted from 1.
        file: usize,
        /// What is wrong with it.
        source: Box<IntakeError>,
    },
    /// The bytes of a DICOM file contradict themselves.
    #[error(transparent)]
    DicomStructure(#[from] ScanError),
    /// A DICOM object that is no NM image.
    #[error("received {received}; {ACCEPTED}")]
    NotNuclearMedicine {
        /// What the object is.
        received: String,
    },
    /// Raw projections.
    #[error(
        "received {frames} raw projections (image type {image_type}); the ventricle is reconstructed from slices: send the short-axis slices that \
         the gamma camera's workstation reconstructs from them (image type RECON GATED TOMO or RECON TOMO)"
    )]
    Projections {
        /// Number of frames.
        frames: usize,
        /// Image Type (0008,0008).
        image_type: String,
    },
    /// An NM image that is no tomographic reconstruction.
    #[error("received {received}, which holds no tomographic slices; {ACCEPTED}")]
    NotTomographic {
        /// What the image is.
        received: String,
    },
    /// Pixel data in an encoding that is not read.
    #[error(
        "the pixel data is encoded as {name} ({uid}); send it uncompressed (Explicit VR Little Endian, 1.2.840.10008.1.2.1) or as RLE Lossless"
    )]
    UnsupportedTransferSyntax {
        /// Name of the transfer syntax.
        name: String,
        /// Its UID.
        uid: String,
    },
    /// A DICOM attribute that cannot be done without.
    #[error("the DICOM object has no {name} {tag}; {advice}")]
    MissingAttribute {
        /// Keyword of the attribute in words.
        name: &'static str,
        /// `(gggg,eeee)`.
        tag: String,
        /// Why it is needed.
        advice: &'static str,
    },
    /// A DICOM attribute whose value makes no sense.
    #[error("{name} {tag} is {value}; {expected}")]
    InvalidAttribute {
        /// Keyword of the attribute in words.
        name: &'static str,
        /// `(gggg,eeee)`.
        tag: String,
        /// The value as found, shortened.
        value: String,
        /// What it must be.
        expected: String,
    },
    /// Frames that do not fill the rectangle of slices and time slots.
    #[error("the frames do not make a complete set of slices and gates: {reason}")]
    InconsistentFrames {
        /// What is missing or twice there.
        reason: String,
    },
    /// Pixel data of another length than the header declares.
    #[error(
        "Pixel Data (7FE0,0010) has {actual} bytes where {frames} frames of {rows} rows and {columns} columns need {expected}; send the whole file"
    )]
    PixelDataLength {
        /// Bytes there.
        actual: usize,
        /// Bytes needed.
        expected: usize,
        /// Frames.
        frames: usize,
        /// Rows.
        rows: usize,
        /// Columns.
        columns: usize,
    },
    /// Compressed pixel data that does not decode.
    #[error("frame {frame} of the compressed pixel data is damaged: {reason}")]
    DamagedPixelData {
        /// Frame, counted from 1.
        frame: usize,
        /// What is wrong.
        reason: String,
    },
    /// Outside the limits on rows, columns, slices, gates or voxels.
    #[error("the study has {what}; accepted are {accepted}")]
    OutsideLimits {
        /// The quantity and its value.
        what: String,
        /// The accepted range.
        accepted: String,
    },
    /// A voxel that is no number.
    #[error("gate {gate} holds {value} at slice {}, row {}, column {} (counted from 1); counts must be finite numbers", voxel[0] + 1, voxel[1] + 1, voxel[2] + 1)]
    NotFinite {
        /// Gate, counted from 1.
        gate: usize,
        /// Voxel `[z, y, x]`.
        voxel: [usize; 3],
        /// The value.
        value: f32,
    },
    /// No positive count anywhere.
    #[error("all counts of the study are zero or negative; send a study with an image in it")]
    NoCounts,
    /// A NIfTI file that contradicts itself.
    #[error("the NIfTI file is malformed: {reason}")]
    MalformedNifti {
        /// What is wrong.
        reason: String,
    },
    /// A valid NIfTI file of a kind that is not read.
    #[error("the file is {received}; send NIfTI-1 in one file (.nii or .nii.gz) with x, y, z and gate as dimensions")]
    UnsupportedNifti {
        /// What it is.
        received: String,
    },
    /// A gzip stream that does not inflate.
    #[error("the gzip stream is damaged: {reason}")]
    DamagedGzip {
        /// What is wrong.
        reason: String,
    },
    /// An NPY file that contradicts itself or has a type or order that is not read.
    #[error(
        "the NPY file is not accepted: {reason}; send a C-ordered array [gate, slice, row, column] or [slice, row, column] of uint8, uint16, int16, float32 or float64, little-endian"
    )]
    MalformedNpy {
        /// What is wrong.
        reason: String,
    },
    /// NPY without the distance between voxels.
    #[error("an NPY array does not say how far apart its voxels are; give spacing_mm=z,y,x in the query")]
    MissingSpacing,
    /// A JSON body that does not follow the contract.
    #[error("the JSON body is not accepted: {reason}")]
    MalformedJson {
        /// What is wrong.
        reason: String,
    },
    /// Nothing decodes compressed pixel data at the moment.
    #[error("the pixel data is compressed and cannot be decoded now: {reason}; send it again later, or uncompressed")]
    DecoderUnavailable {
        /// Why not.
        reason: String,
    },
    /// The reader itself failed.
    #[error("the DICOM data set could not be read: {reason}")]
    UnreadableDataSet {
        /// What the parser said.
        reason: String,
    },
}

impl IntakeError {
    /// Stable `snake_case` name of the reason, for programs.
    pub fn code(&self) -> &'static str {
        match self {
            Self::Empty => "empty_body",
            Self::TooLarge { bytes: Some(_), .. } => "too_large",
            Self::TooLarge { bytes: None, .. } => "inflates_too_large",
            Self::UnknownFormat { .. } => "unknown_format",
            Self::NotDicom { .. } => "not_dicom",
            Self::MixedParts { .. } => "mixed_parts",
            Self::InFile { source, .. } => source.code(),
            Self::DicomStructure(scan) => scan.code(),
            Self::NotNuclearMedicine { .. } => "not_nuclear_medicine",
            Self::Projections { .. } => "projections",
            Self::NotTomographic { .. } => "not_tomographic",
            Self::UnsupportedTransferSyntax { .. } => "unsupported_transfer_syntax",
            Self::MissingAttribute { .. } => "missing_attribute",
            Self::InvalidAttribute { .. } => "invalid_attribute",
            Self::InconsistentFrames { .. } => "inconsistent_frames",
            Self::PixelDataLength { .. } => "pixel_data_length",
            Self::DamagedPixelData { .. } => "damaged_pixel_data",
            Self::DecoderUnavailable { .. } => "decoder_unavailable",
            Self::OutsideLimits { .. } => "outside_limits",
            Self::NotFinite { .. } => "counts_not_finite",
            Self::NoCounts => "no_counts",
            Self::MalformedNifti { .. } => "malformed_nifti",
            Self::UnsupportedNifti { .. } => "unsupported_nifti",
            Self::DamagedGzip { .. } => "damaged_gzip",
            Self::MalformedNpy { .. } => "malformed_npy",
            Self::MissingSpacing => "missing_spacing",
            Self::MalformedJson { .. } => "malformed_json",
            Self::UnreadableDataSet { .. } => "unreadable_data_set",
        }
    }

    /// What kind of refusal it is.
    pub fn nature(&self) -> Nature {
        match self {
            Self::TooLarge { .. } => Nature::TooLarge,
            Self::InFile { source, .. } => source.nature(),
            Self::DicomStructure(scan) => scan.nature(),
            Self::DecoderUnavailable { .. } => Nature::Unavailable,
            Self::Empty
            | Self::MalformedNifti { .. }
            | Self::DamagedGzip { .. }
            | Self::MalformedNpy { .. }
            | Self::MalformedJson { .. }
            | Self::DamagedPixelData { .. }
            | Self::PixelDataLength { .. }
            | Self::UnreadableDataSet { .. } => Nature::Malformed,
            Self::UnknownFormat { .. } | Self::NotDicom { .. } | Self::UnsupportedTransferSyntax { .. } | Self::UnsupportedNifti { .. } => {
                Nature::Unsupported
            }
            Self::MixedParts { .. }
            | Self::NotNuclearMedicine { .. }
            | Self::Projections { .. }
            | Self::NotTomographic { .. }
            | Self::MissingAttribute { .. }
            | Self::InvalidAttribute { .. }
            | Self::InconsistentFrames { .. }
            | Self::OutsideLimits { .. }
            | Self::NotFinite { .. }
            | Self::NoCounts
            | Self::MissingSpacing => Nature::Refused,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn details_are_sentences() {
        assert_eq!(sentence("the request has no content; send one"), "The request has no content; send one.");
        assert_eq!(sentence("It is so."), "It is so.");
        assert_eq!(sentence(""), ".");
    }
}
