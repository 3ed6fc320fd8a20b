//! The coded concepts of results. Each was looked up in the context groups and templates of DICOM PS3.16; where none names what is meant, the
//! code is one of our own (`99VENTRICLE`), never a near one.

/// A coded concept.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Code {
    /// At most 16 characters.
    pub(super) value: &'static str,
    pub(super) scheme: &'static str,
    pub(super) meaning: &'static str,
}

const fn dcm(value: &'static str, meaning: &'static str) -> Code {
    Code { value, scheme: "DCM", meaning }
}

const fn sct(value: &'static str, meaning: &'static str) -> Code {
    Code { value, scheme: "SCT", meaning }
}

const fn unit(value: &'static str, meaning: &'static str) -> Code {
    Code { value, scheme: "UCUM", meaning }
}

const fn own(value: &'static str, meaning: &'static str) -> Code {
    Code { value, scheme: OWN_SCHEME, meaning }
}

/// Our own coding scheme.
pub(super) const OWN_SCHEME: &str = "99VENTRICLE";
/// Its UID.
pub(super) const OWN_SCHEME_UID: &str = "2.25.168157756643434697941025443874208456875";

// The document (TID 1500, 1001, 1204, 1600).
pub(super) const MEASUREMENT_REPORT: Code = dcm("126000", "Imaging Measurement Report");
pub(super) const LANGUAGE: Code = dcm("121049", "Language of Content Item and Descendants");
pub(super) const ENGLISH: Code = Code { value: "en", scheme: "RFC5646", meaning: "English" };
pub(super) const OBSERVER_TYPE: Code = dcm("121005", "Observer Type");
pub(super) const DEVICE: Code = dcm("121007", "Device");
pub(super) const DEVICE_UID: Code = dcm("121012", "Device Observer UID");
pub(super) const DEVICE_NAME: Code = dcm("121013", "Device Observer Name");
pub(super) const DEVICE_MANUFACTURER: Code = dcm("121014", "Device Observer Manufacturer");
pub(super) const DEVICE_MODEL: Code = dcm("121015", "Device Observer Model Name");
pub(super) const PROCEDURE_REPORTED: Code = dcm("121058", "Procedure reported");
/// CID 100 names no SPECT of the heart.
pub(super) const IMAGING_PROCEDURE: Code = sct("363679005", "Imaging procedure");
pub(super) const IMAGE_LIBRARY: Code = dcm("111028", "Image Library");
pub(super) const IMAGE_LIBRARY_GROUP: Code = dcm("126200", "Image Library Group");
pub(super) const MODALITY: Code = dcm("121139", "Modality");
pub(super) const NUCLEAR_MEDICINE: Code = dcm("NM", "Nuclear Medicine");
pub(super) const FRAME_OF_REFERENCE: Code = dcm("112227", "Frame of Reference UID");
pub(super) const IMAGING_MEASUREMENTS: Code = dcm("126010", "Imaging Measurements");
pub(super) const QUALITATIVE_EVALUATIONS: Code = Code { value: "C0034375", scheme: "UMLS", meaning: "Qualitative Evaluations" };
pub(super) const COMMENT: Code = dcm("121106", "Comment");

// A group of measurements (TID 1501, 1502, 4019).
pub(super) const MEASUREMENT_GROUP: Code = dcm("125007", "Measurement Group");
pub(super) const TRACKING_IDENTIFIER: Code = dcm("112039", "Tracking Identifier");
pub(super) const TRACKING_UID: Code = dcm("112040", "Tracking Unique Identifier");
pub(super) const FINDING: Code = dcm("121071", "Finding");
pub(super) const END_DIASTOLE: Code = sct("416190007", "End diastole");
pub(super) const END_SYSTOLE: Code = sct("416430001", "End Systole");
pub(super) const FINDING_SITE: Code = sct("363698007", "Finding Site");
pub(super) const LEFT_VENTRICLE: Code = sct("87878005", "Left ventricle");
pub(super) const MEASUREMENT_METHOD: Code = sct("370129005", "Measurement Method");
pub(super) const ALGORITHM_NAME: Code = dcm("111001", "Algorithm Name");
pub(super) const ALGORITHM_VERSION: Code = dcm("111003", "Algorithm Version");
pub(super) const ALGORITHM_PARAMETERS: Code = dcm("111002", "Algorithm Parameters");
pub(super) const TIME_POINT: Code = Code { value: "C2348792", scheme: "UMLS", meaning: "Time Point" };
pub(super) const TIME_POINT_ORDER: Code = dcm("126073", "Time Point Order");

// What was measured.
/// CID 3468 and 3835.
pub(super) const ED_VOLUME: Code = Code { value: "8821-1", scheme: "LN", meaning: "Left Ventricular ED Volume" };
/// CID 3469 and 3835.
pub(super) const ES_VOLUME: Code = Code { value: "8823-7", scheme: "LN", meaning: "Left Ventricular ES Volume" };
/// CID 3835.
pub(super) const STROKE_VOLUME: Code = sct("90096001", "Stroke Volume");
/// CID 3467 and 3833 name it by angiography, CT and MR only.
pub(super) const EJECTION_FRACTION: Code = sct("70822001", "Cardiac ejection fraction");
pub(super) const WALL_VOLUME: Code = dcm("122446", "Wall Volume");
pub(super) const WALL_MASS: Code = dcm("122447", "Wall Mass");
pub(super) const R_R_INTERVAL: Code = dcm("122182", "R-R interval");
pub(super) const HEART_RATE: Code = Code { value: "8867-4", scheme: "LN", meaning: "Heart rate" };
pub(super) const ENDOCARDIAL_VOLUME: Code = own("ENDO_VOLUME", "Volume within the endocardial surface");
pub(super) const EPICARDIAL_VOLUME: Code = own("EPI_VOLUME", "Volume within the epicardial surface");
pub(super) const QUALITY_SCORE: Code = own("QUALITY_SCORE", "Quality score");
pub(super) const QUALITY_FLAG: Code = own("QUALITY_FLAG", "Quality flag");

/// Derivation of a value (TID 300), and what it can be.
pub(super) const DERIVATION: Code = dcm("121401", "Derivation");
/// CID 3627 and 7464.
pub(super) const MEAN: Code = sct("373098007", "Mean");

/// CID 225.
pub(super) const UPPER_UNCERTAINTY: Code = sct("371886008", "+, range of upper measurement uncertainty");
/// CID 225.
pub(super) const LOWER_UNCERTAINTY: Code = sct("371885007", "-, range of lower measurement uncertainty");
/// CID 7464.
pub(super) const STANDARD_DEVIATION: Code = sct("386136009", "Standard Deviation");

// How surfaces were found.
pub(super) const CAMERA_MODEL: Code = own("CAMERA_MODEL", "Model of the camera fitted to the counts of all gates");
pub(super) const GRADIENT_EXTREMA: Code = own("GRADIENT_EXTREMA", "Borders at the extrema of the gradient across the wall");
pub(super) const DEFORMABLE_MODEL: Code = own("DEFORMABLE_MODEL", "Deformable model in a gradient vector flow");

// Units.
pub(super) const MILLILITRES: Code = unit("ml", "milliliter");
pub(super) const GRAMS: Code = unit("g", "gram");
pub(super) const PERCENT: Code = unit("%", "Percent");
pub(super) const MILLISECONDS: Code = unit("ms", "millisecond");
pub(super) const BEATS_A_MINUTE: Code = unit("{H.B.}/min", "heart beats per minute");
pub(super) const MILLIMETRES: Code = unit("mm", "mm");
pub(super) const NO_UNIT: Code = unit("1", "no units");
