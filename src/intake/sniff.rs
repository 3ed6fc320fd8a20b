//! What a body is, by its own signature first: PACS and scripts mislabel DICOM as `application/octet-stream` or even as a web form.

use super::{IntakeError, Part, prescan};

/// A format that has a reader here.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Format {
    Dicom,
    Nifti,
    Gzip,
    Npy,
    Json,
}

impl Format {
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Dicom => "DICOM",
            Self::Nifti => "NIfTI",
            Self::Gzip => "gzip",
            Self::Npy => "NPY",
            Self::Json => "JSON",
        }
    }
}

/// The format of a part.
///
/// # Errors
/// [`IntakeError::Empty`] and [`IntakeError::UnknownFormat`].
pub(super) fn format(part: &Part<'_>) -> Result<Format, IntakeError> {
    let bytes = part.bytes;
    if bytes.is_empty() {
        return Err(IntakeError::Empty);
    }
    if bytes.starts_with(&[0x1f, 0x8b]) {
        return Ok(Format::Gzip);
    }
    if bytes.starts_with(b"\x93NUMPY") {
        return Ok(Format::Npy);
    }
    // Before DICOM: the first bytes of a NIfTI header are its size, and offset 128 lies in free text.
    if has_nifti_magic(bytes) {
        return Ok(Format::Nifti);
    }
    if prescan::looks_like_dicom(bytes) {
        return Ok(Format::Dicom);
    }
    let text = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes).trim_ascii_start();
    if text.starts_with(b"{") {
        return Ok(Format::Json);
    }
    let declared = part.media_type.map(|media_type| media_type.split(';').next().unwrap_or_default().trim().to_ascii_lowercase());
    Err(IntakeError::UnknownFormat {
        declared: match declared.as_deref() {
            Some("application/dicom") => "declared as application/dicom, but there is no DICM at byte 128: ".to_owned(),
            Some("application/x-nifti") => "declared as application/x-nifti, but there is no NIfTI magic at byte 344: ".to_owned(),
            Some("application/x-npy") => "declared as application/x-npy, but there is no NUMPY magic: ".to_owned(),
            Some("application/json") => "declared as application/json, but it is no JSON object: ".to_owned(),
            Some("application/gzip" | "application/x-gzip") => "declared as gzip, but there is no gzip magic: ".to_owned(),
            _ => String::new(),
        },
        begins: first_bytes(bytes),
    })
}

fn has_nifti_magic(bytes: &[u8]) -> bool {
    matches!(bytes.get(344..348), Some(b"n+1\0" | b"ni1\0")) || matches!(bytes.get(4..8), Some(b"n+2\0" | b"ni2\0"))
}

/// Names well-known formats that people send by mistake; of others the first eight bytes.
fn first_bytes(bytes: &[u8]) -> String {
    const KNOWN: [(&[u8], &str); 13] = [
        (b"PK", "a ZIP archive (unpack it first)"),
        (b"\x89PNG", "a PNG picture"),
        (b"\xff\xd8\xff", "a JPEG picture"),
        (b"\x00\x00\x00\x0cjP", "a JPEG 2000 picture"),
        (b"%PDF", "a PDF document"),
        (b"GIF8", "a GIF picture"),
        (b"NRRD", "NRRD"),
        (b"\x89HDF", "HDF5"),
        (b"!INTERFILE", "Interfile"),
        (b"ObjectType", "MetaImage"),
        (b"CDF", "NetCDF (MINC)"),
        (b"<", "XML or HTML"),
        (b"[", "a JSON array (the body is one JSON object)"),
    ];
    let text = bytes.trim_ascii_start();
    if let Some((_, name)) = KNOWN.into_iter().find(|(magic, _)| bytes.starts_with(magic) || text.starts_with(magic)) {
        return name.to_owned();
    }
    let shown = &bytes[..bytes.len().min(8)];
    let hex: Vec<String> = shown.iter().map(|byte| format!("{byte:02X}")).collect();
    format!("the bytes {}", hex.join(" "))
}
