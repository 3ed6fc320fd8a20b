//! The marker segments of JPEG and JPEG-LS up to the first scan (ITU-T T.81 annex B, T.87 annex C).

use super::{
    Codec,
    header::{Declared, HeaderError, damaged},
};

/// Largest value of RESET that T.87 C.2.4.1.1 lets small images have.
const MOST_RESET: u16 = 255;

/// What stands before the samples.
#[derive(Debug, Default, PartialEq, Eq)]
struct Header {
    /// Frame marker and what the frame segment says.
    frame: Option<(u8, Declared)>,
    restart_interval: u16,
    /// JPEG-LS presets MAXVAL, T1, T2, T3, RESET; 0 for the default.
    presets: Option<[u16; 5]>,
    /// The last three bytes of the scan header: Ss, Se, Ah and Al; in JPEG-LS NEAR, the interleave mode and the point transform.
    scan: [u8; 3],
}

/// Reads the header and refuses what the decoders are known to read wrongly.
pub(super) fn declared(codec: Codec, bytes: &[u8]) -> Result<Declared, HeaderError> {
    let header = read(bytes)?;
    let Some((marker, declared)) = header.frame else { return Err(damaged("its first scan stands before its frame header")) };
    let [first, second, third] = header.scan;
    match (codec, marker) {
        (Codec::Jpeg, 0xC0 | 0xC1) if declared.precision == 8 => {}
        (Codec::Jpeg, 0xC1) if declared.precision == 12 => return Err(HeaderError::Unsupported("JPEG Extended with 12 bits")),
        (Codec::Jpeg, 0xC2) => return Err(HeaderError::Unsupported("JPEG with progressive coding")),
        (Codec::JpegLossless, 0xC3) => {
            if !(1..=7).contains(&first) || second != 0 {
                return Err(damaged(format!("its scan names predictor {first}; there are 1 to 7")));
            }
            if third & 0x0F != 0 {
                return Err(HeaderError::Unsupported("JPEG Lossless with a point transform"));
            }
            if header.restart_interval != 0 {
                return Err(HeaderError::Unsupported("JPEG Lossless with restart intervals"));
            }
        }
        (Codec::JpegLs, 0xF7) => {
            if header.restart_interval != 0 {
                return Err(HeaderError::Unsupported("JPEG-LS with restart intervals"));
            }
            coding_parameters(&header, declared)?;
        }
        (Codec::Jpeg | Codec::JpegLossless, 0xC9..=0xCF) => return Err(HeaderError::Unsupported("JPEG with arithmetic coding")),
        _ => {
            return Err(damaged(format!(
                "its frame has the marker FF {marker:02X} and {} bits, which are of another encoding",
                declared.precision
            )));
        }
    }
    Ok(declared)
}

/// The rules for NEAR, interleaving and presets (T.87 C.2.3 and C.2.4.1.1).
fn coding_parameters(header: &Header, declared: Declared) -> Result<(), HeaderError> {
    let [near, interleave, transform] = header.scan;
    if !(2..=16).contains(&declared.precision) {
        return Err(damaged(format!("its own header says {} bits; JPEG-LS has 2 to 16", declared.precision)));
    }
    let largest = ((1_u32 << declared.precision) - 1) as u16;
    let [maximum, thresholds @ .., reset] = header.presets.unwrap_or_default();
    let maximum = if maximum == 0 { largest } else { maximum };
    if interleave != 0 || transform != 0 {
        return Err(damaged(format!(
            "its scan has interleave mode {interleave} and point transform {transform}; one component has neither"
        )));
    }
    if u16::from(near) > maximum / 2 {
        return Err(damaged(format!("its scan allows an error of {near} in values up to {maximum}")));
    }
    let given: Vec<u16> = thresholds.into_iter().filter(|threshold| *threshold != 0).collect();
    let ordered = given.is_sorted() && given.iter().all(|threshold| *threshold > u16::from(near) && *threshold <= maximum);
    if maximum > largest || !ordered || (reset != 0 && !(3..=maximum.max(MOST_RESET)).contains(&reset)) {
        return Err(damaged("its coding parameters (LSE) contradict each other"));
    }
    Ok(())
}

fn read(bytes: &[u8]) -> Result<Header, HeaderError> {
    let Some(mut rest) = bytes.strip_prefix(&[0xFF, 0xD8]) else { return Err(damaged("it does not begin with the marker FF D8")) };
    let mut header = Header::default();
    loop {
        let (marker, segment, after) = segment(rest)?;
        rest = after;
        match (marker, segment) {
            (0xC4 | 0xDB | 0xE0..=0xEF | 0xFE, _) => {} // tables, applications' own, comment
            (0xC0..=0xCF | 0xF7, &[precision, y1, y0, x1, x0, components, ref of_components @ ..]) => {
                if of_components.len() != 3 * usize::from(components) || header.frame.is_some() {
                    return Err(damaged("its frame header is malformed, or there are two"));
                }
                let (rows, columns) = (u64::from(u16::from_be_bytes([y1, y0])), u64::from(u16::from_be_bytes([x1, x0])));
                header.frame = Some((marker, Declared { rows, columns, components: components.into(), precision }));
            }
            (0xDD, &[high, low]) => header.restart_interval = u16::from_be_bytes([high, low]),
            (0xF8, [1, values @ ..]) if values.len() == 10 => {
                let mut presets = [0; 5];
                for (preset, pair) in presets.iter_mut().zip(values.chunks_exact(2)) {
                    *preset = u16::from_be_bytes([pair[0], pair[1]]);
                }
                header.presets = Some(presets);
            }
            (0xF8, _) => return Err(HeaderError::Unsupported("JPEG-LS with a mapping table or extensions")),
            (0xDA, [components, rest @ ..]) if rest.len() == 2 * usize::from(*components) + 3 => {
                header.scan.copy_from_slice(&rest[rest.len() - 3..]);
                return Ok(header);
            }
            _ => return Err(damaged(format!("its header has a segment FF {marker:02X} that does not belong there or is malformed"))),
        }
    }
}

/// The next marker segment: marker, content, what follows.
fn segment(bytes: &[u8]) -> Result<(u8, &[u8], &[u8]), HeaderError> {
    let ends = || damaged("it ends within its header");
    // T.81 B.1.1.2: a marker may have any number of fill bytes FF before it.
    let fill = bytes.iter().take_while(|byte| **byte == 0xFF).count();
    let (marker, rest) = bytes[fill..].split_first().ok_or_else(ends)?;
    if fill == 0 {
        return Err(damaged(format!("its header has {marker:02X} where a marker must begin")));
    }
    if matches!(marker, 0 | 1 | 0xD0..=0xD9) {
        return Err(damaged(format!("its header has the marker FF {marker:02X}, which does not belong there")));
    }
    let (length, _) = rest.split_first_chunk::<2>().ok_or_else(ends)?;
    let (whole, after) = rest.split_at_checked(usize::from(u16::from_be_bytes(*length))).ok_or_else(ends)?;
    Ok((*marker, whole.get(2..).ok_or_else(|| damaged("its header has a segment without a length"))?, after))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// SOI, extra segments, a frame header of 64 rows and 32 columns, a scan header, EOI.
    fn stream(extra: &[u8], sof: u8, precision: u8, scan: [u8; 3]) -> Vec<u8> {
        let frame = [0xFF, sof, 0, 11, precision, 0, 64, 0, 32, 1, 1, 0x11, 0];
        let scan = [[0xFF, 0xDA, 0, 8].as_slice(), &[1, 1, 0], &scan].concat();
        [[0xFF, 0xD8].as_slice(), extra, &frame, &scan, &[0xFF, 0xD9]].concat()
    }

    #[test]
    fn each_codec_has_its_frame_marker() {
        let expected = |precision| Ok(Declared { rows: 64, columns: 32, components: 1, precision });
        assert_eq!(declared(Codec::Jpeg, &stream(&[], 0xC0, 8, [0, 63, 0])), expected(8));
        assert_eq!(declared(Codec::Jpeg, &stream(&[0xFF, 0xFF, 0xFE, 0, 4, 1, 2], 0xC1, 8, [0, 63, 0])), expected(8));
        assert_eq!(declared(Codec::JpegLossless, &stream(&[], 0xC3, 16, [1, 0, 0])), expected(16));
        assert_eq!(declared(Codec::JpegLs, &stream(&[], 0xF7, 12, [2, 0, 0])), expected(12));
        assert!(matches!(declared(Codec::JpegLs, &stream(&[], 0xC3, 12, [1, 0, 0])), Err(HeaderError::Damaged(_))));
        assert!(matches!(declared(Codec::JpegLossless, &stream(&[], 0xF7, 12, [0, 0, 0])), Err(HeaderError::Damaged(_))));
    }

    #[test]
    fn what_decoders_read_wrongly_is_refused_by_name() {
        let restart = [0xFF, 0xDD, 0, 4, 0, 32];
        for (codec, stream, name) in [
            (Codec::Jpeg, stream(&[], 0xC1, 12, [0, 63, 0]), "12 bits"),
            (Codec::Jpeg, stream(&[], 0xC2, 8, [0, 0, 0]), "progressive"),
            (Codec::Jpeg, stream(&[], 0xC9, 8, [0, 63, 0]), "arithmetic"),
            (Codec::JpegLossless, stream(&[], 0xC3, 16, [1, 0, 2]), "point transform"),
            (Codec::JpegLossless, stream(&restart, 0xC3, 16, [1, 0, 0]), "restart"),
            (Codec::JpegLs, stream(&restart, 0xF7, 16, [0, 0, 0]), "restart"),
            (Codec::JpegLs, stream(&[0xFF, 0xF8, 0, 5, 2, 1, 1], 0xF7, 16, [0, 0, 0]), "mapping table"),
        ] {
            let error = declared(codec, &stream).unwrap_err();
            assert!(matches!(error, HeaderError::Unsupported(named) if named.contains(name)), "{name}: {error}");
        }
    }

    #[test]
    fn coding_parameters_must_be_possible() {
        let presets = |values: [u16; 5]| {
            let mut bytes = vec![0xFF, 0xF8, 0, 13, 1];
            bytes.extend(values.iter().flat_map(|value| value.to_be_bytes()));
            stream(&bytes, 0xF7, 12, [2, 0, 0])
        };
        assert!(declared(Codec::JpegLs, &presets([0; 5])).is_ok());
        assert!(declared(Codec::JpegLs, &presets([4095, 18, 67, 276, 64])).is_ok());
        for wrong in [[4096, 0, 0, 0, 0], [4095, 67, 18, 276, 64], [4095, 2, 67, 276, 64], [4095, 18, 67, 276, 2], [3, 0, 0, 0, 0]] {
            assert!(declared(Codec::JpegLs, &presets(wrong)).is_err(), "{wrong:?}");
        }
        for scan in [[0, 1, 0], [0, 0, 1]] {
            assert!(declared(Codec::JpegLs, &stream(&[], 0xF7, 12, scan)).is_err(), "{scan:?}");
        }
    }

    #[test]
    fn a_header_cut_anywhere_is_damaged() {
        let whole = stream(&[0xFF, 0xDD, 0, 4, 0, 0], 0xC3, 16, [1, 0, 0]);
        for length in 0..whole.len() - 2 {
            assert!(matches!(declared(Codec::JpegLossless, &whole[..length]), Err(HeaderError::Damaged(_))), "{length}");
        }
    }
}
