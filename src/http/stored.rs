//! What a PACS is answered about the instances that it sent: DICOM JSON.

use crate::assembly::Outcome;
use serde::Serialize;
use utoipa::ToSchema;

/// What became of instances: a DICOM data set as JSON (PS3.18 table 10.5.3-2 and annex F).
#[derive(Debug, Serialize, ToSchema)]
#[schema(example = json!({
    "00081190": {"vr": "UR"},
    "00081199": {"vr": "SQ", "Value": [{
        "00081150": {"vr": "UI", "Value": ["1.2.840.10008.5.1.4.1.1.20"]},
        "00081155": {"vr": "UI", "Value": ["1.2.826.0.1.3680043.10.1"]}
    }]}
}))]
pub(super) struct StoreInstancesResponse {
    /// Retrieve URL: none, as instances are not given out again.
    #[serde(rename = "00081190")]
    retrieve_url: Attribute<String>,
    /// Referenced SOP Sequence: every instance that is stored.
    #[serde(rename = "00081199", skip_serializing_if = "Attribute::is_empty")]
    stored: Attribute<InstanceAnswer>,
    /// Failed SOP Sequence: instances that were refused, each with its Failure Reason.
    #[serde(rename = "00081198", skip_serializing_if = "Attribute::is_empty")]
    failed: Attribute<InstanceAnswer>,
    /// Other Failures Sequence: what was refused and has no readable UID.
    #[serde(rename = "0008119A", skip_serializing_if = "Attribute::is_empty")]
    unnamed: Attribute<InstanceAnswer>,
}

/// What became of one instance.
#[derive(Debug, Default, Serialize, ToSchema)]
struct InstanceAnswer {
    /// Error Comment: why, in words.
    #[serde(rename = "00000902", skip_serializing_if = "Attribute::is_empty")]
    comment: Attribute<String>,
    /// Referenced SOP Class UID.
    #[serde(rename = "00081150", skip_serializing_if = "Attribute::is_empty")]
    class: Attribute<String>,
    /// Referenced SOP Instance UID.
    #[serde(rename = "00081155", skip_serializing_if = "Attribute::is_empty")]
    instance: Attribute<String>,
    /// Failure Reason.
    #[serde(rename = "00081197", skip_serializing_if = "Attribute::is_empty")]
    reason: Attribute<u16>,
}

/// An attribute: its value representation and values.
#[derive(Debug, Serialize, ToSchema)]
struct Attribute<T> {
    vr: &'static str,
    #[serde(rename = "Value", skip_serializing_if = "Vec::is_empty")]
    values: Vec<T>,
}

impl<T> Attribute<T> {
    fn is_empty(&self) -> bool {
        self.values.is_empty()
    }
}

impl<T> Default for Attribute<T> {
    fn default() -> Self {
        Self { vr: "", values: Vec::new() }
    }
}

impl StoreInstancesResponse {
    pub(super) fn new(outcomes: &[Outcome]) -> Self {
        let sequence = || Attribute { vr: "SQ", values: Vec::new() };
        let uid = |uid: &Option<String>| Attribute { vr: "UI", values: uid.iter().cloned().collect() };
        let mut response =
            Self { retrieve_url: Attribute { vr: "UR", values: vec![] }, stored: sequence(), failed: sequence(), unnamed: sequence() };
        for outcome in outcomes {
            let named =
                InstanceAnswer { class: uid(&outcome.class_uid), instance: uid(&outcome.instance_uid), ..InstanceAnswer::default() };
            let Err(refusal) = &outcome.result else {
                response.stored.values.push(named);
                continue;
            };
            // LO has at most 64 characters, and no reader of DICOM JSON was seen to mind more.
            let answer = InstanceAnswer {
                comment: Attribute { vr: "LO", values: vec![refusal.to_string()] },
                reason: Attribute { vr: "US", values: vec![refusal.status()] },
                ..named
            };
            if answer.instance.is_empty() { response.unnamed.values.push(answer) } else { response.failed.values.push(answer) }
        }
        response
    }
}
