//! One NM object: its attributes checked, its pixels located and not yet decoded.

use super::attributes::{Attributes, invalid};
use super::identity::{self, Kind};
use super::pixels::Pixels;
use super::subject;
use crate::intake::prescan::{self, Scan};
use crate::intake::{IntakeError, Limits, counts};
use crate::study::Warning;
use crate::subject::Subject;
use dicom_core::Tag;
use dicom_dictionary_std::tags;

/// An object that is a tomographic reconstruction with plausible dimensions and all its pixel data.
#[derive(Debug)]
pub(super) struct Object<'a> {
    pub(super) attributes: Attributes,
    pub(super) kind: Kind,
    pub(super) rows: usize,
    pub(super) columns: usize,
    pub(super) frames: usize,
    pub(super) pixels: Pixels<'a>,
    pub(super) study_uid: Option<String>,
    pub(super) series_uid: Option<String>,
    pub(super) instance_uid: Option<String>,
    /// The class as which it was read.
    pub(super) class_uid: String,
    /// Whom it is of, if that is to be kept.
    pub(super) subject: Option<Subject>,
}

impl<'a> Object<'a> {
    /// Scans, parses and checks one file.
    pub(super) fn read(bytes: &'a [u8], keep_subject: bool, limits: &Limits, warnings: &mut Vec<Warning>) -> Result<Self, IntakeError> {
        let scan = prescan::scan(bytes, limits)?;
        let attributes = Attributes::parse(&scan, limits)?;
        Self::of(scan, attributes, keep_subject, limits, warnings)
    }

    /// Checks one file that was scanned and parsed.
    pub(super) fn of(
        scan: Scan<'a>,
        attributes: Attributes,
        keep_subject: bool,
        limits: &Limits,
        warnings: &mut Vec<Warning>,
    ) -> Result<Self, IntakeError> {
        let declared_frames = attributes.integer(tags::NUMBER_OF_FRAMES, "Number of Frames");
        let kind = identity::check(
            &attributes,
            &scan,
            declared_frames.as_ref().map_or(1, |frames| frames.unwrap_or(1).max(0) as usize),
            warnings,
        )?;
        if !scan.part_10 {
            warnings.push(Warning::new(
                "not_part_10",
                "The file has no preamble or file meta information; its encoding was guessed from its first bytes.",
            ));
        }
        let frames = match declared_frames? {
            None => 1,
            Some(frames) if frames >= 1 => usize::try_from(frames).unwrap_or(usize::MAX),
            Some(frames) => return Err(invalid(tags::NUMBER_OF_FRAMES, "Number of Frames", &frames.to_string(), "it must be at least 1")),
        };
        counts::within("frames", frames, &(1..=limits.frames))?;
        let rows = dimension(&attributes, tags::ROWS, "Rows")?;
        let columns = dimension(&attributes, tags::COLUMNS, "Columns")?;
        counts::within("rows", rows, &limits.rows_and_columns)?;
        counts::within("columns", columns, &limits.rows_and_columns)?;
        if frames * rows * columns > limits.voxels {
            return Err(IntakeError::OutsideLimits {
                what: format!("{} voxels ({frames} frames of {rows} rows and {columns} columns)", frames * rows * columns),
                accepted: format!("at most {}", limits.voxels),
            });
        }
        let study_uid = attributes.uid(tags::STUDY_INSTANCE_UID);
        let series_uid = attributes.uid(tags::SERIES_INSTANCE_UID);
        let instance_uid = attributes.uid(tags::SOP_INSTANCE_UID);
        let class_uid = identity::class_uid(&attributes, &scan);
        let subject = keep_subject.then(|| subject::of_scan(&scan, warnings));
        let pixels = Pixels::locate(scan, &attributes, [frames, rows, columns], limits, warnings)?;
        Ok(Self { attributes, kind, rows, columns, frames, pixels, study_uid, series_uid, instance_uid, class_uid, subject })
    }
}

fn dimension(attributes: &Attributes, tag: Tag, name: &'static str) -> Result<usize, IntakeError> {
    let value = attributes.integer(tag, name)?.ok_or_else(|| IntakeError::MissingAttribute {
        name,
        tag: tag.to_string(),
        advice: "an image cannot be read without it",
    })?;
    usize::try_from(value).map_err(|_| invalid(tag, name, &value.to_string(), "it must be positive"))
}
