//! From what is stored of a finished reconstruction to what PACS and health records take: DICOM structured report, DICOM encapsulated
//! surface, FHIR bundle; and to what people look at: polar maps as pictures, the report as a page. Made when asked for, from the report and the surfaces as they are stored.
//!
//! Pure functions of their input: the same job gives the same bytes, so that a result that is fetched or sent twice is one object. Its UIDs
//! are made from the job's id and the number of the form (`FORM`).

mod codes;
mod content;
pub mod fhir;
mod header;
pub mod page;
pub mod polar;
pub mod sr;
pub mod stl;

use crate::{elements, report::Report, subject::Subject};
use jiff::Timestamp;
use uuid::Uuid;

/// Counts the forms in which results were written. To be raised with every change of what is written: objects that differ need other UIDs.
const FORM: u32 = 1;

/// Why a result could not be written: a fault of this program or of what it stored.
#[derive(Debug, thiserror::Error)]
pub enum ArchiveError {
    /// The DICOM writer failed.
    #[error("the DICOM object could not be written: {0}")]
    Dicom(Box<dyn std::error::Error + Send + Sync>),
    /// The JSON writer failed.
    #[error("the FHIR bundle could not be written: {0}")]
    Json(#[from] serde_json::Error),
    /// The PNG writer failed.
    #[error("a picture could not be written: {0}")]
    Picture(#[from] png::EncodingError),
    /// The stored surfaces cannot be read.
    #[error(transparent)]
    Surfaces(#[from] crate::export::ExportError),
}

/// A finished reconstruction.
#[derive(Debug, Clone, PartialEq)]
pub struct Finished {
    /// The job's id.
    pub id: Uuid,
    /// When it was finished: the content's date and time, in UTC.
    pub finished_at: Timestamp,
    /// What was found.
    pub report: Report,
    /// Whom the study is of, where that was kept.
    pub subject: Option<Subject>,
}

/// An instance of the study that was reconstructed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Source<'a> {
    class_uid: &'a str,
    instance_uid: &'a str,
}

/// The instances that were reconstructed, by study and series.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Sources<'a> {
    study_uid: &'a str,
    series_uid: &'a str,
    instances: Vec<Source<'a>>,
}

impl Finished {
    /// A UID of this job and this form.
    fn uid(&self, purpose: &str) -> String {
        elements::uid(&format!("{purpose} {FORM}"), self.id.as_bytes())
    }

    /// The study that results belong to: that of the input, or one of the job's own where the input was of no study.
    fn study_uid(&self) -> String {
        let received = self.report.study.study_instance_uid.clone();
        received.unwrap_or_else(|| elements::uid("study", self.id.as_bytes()))
    }

    /// What was reconstructed, if it can be referred to: without study, series and instance there is no reference.
    fn sources(&self) -> Option<Sources<'_>> {
        let study = &self.report.study;
        let (study_uid, series_uid) = (study.study_instance_uid.as_deref()?, study.series_instance_uid.as_deref()?);
        let class_uids = study.sop_class_uids.iter().map(String::as_str);
        // Reports from before classes were kept have none; images of this class is all that was ever read.
        let class_uids = class_uids.chain(std::iter::repeat(dicom_dictionary_std::uids::NUCLEAR_MEDICINE_IMAGE_STORAGE));
        let instances: Vec<Source<'_>> =
            study.sop_instance_uids.iter().zip(class_uids).map(|(instance_uid, class_uid)| Source { class_uid, instance_uid }).collect();
        (!instances.is_empty()).then_some(Sources { study_uid, series_uid, instances })
    }
}
