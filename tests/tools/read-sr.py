"""Reads a structured report with highdicom and prints as JSON what it found.

usage: read-sr.py FILE

Exit status 1 with a word on standard error where highdicom cannot read it as a measurement report. `unknown_codes` are the coded concepts that
pydicom's copy of the DICOM context groups does not have under that value, scheme and meaning; units, languages, UMLS and private codes aside.
"""

import json
import sys

import highdicom
import pydicom
from pydicom.sr._concepts_dict import concepts

known = {}
for scheme, names in concepts.items():
    for values in names.values():
        for value, (meaning, _) in values.items():
            known.setdefault((scheme, value), set()).add(meaning.casefold())


def codes(data_set):
    """Every coded concept of a data set, at any depth."""
    if "CodeValue" in data_set:
        yield data_set.CodingSchemeDesignator, data_set.CodeValue, data_set.CodeMeaning
    for element in data_set:
        if element.VR == "SQ":
            for item in element.value:
                yield from codes(item)


def code(concept):
    return f"{concept.value}/{concept.scheme_designator}"


data_set = pydicom.dcmread(sys.argv[1])
report = highdicom.sr.ComprehensiveSR.from_dataset(data_set)
content = highdicom.sr.MeasurementReport.from_sequence([report])
groups = []
for group in content.get_image_measurement_groups():
    time_points = [item.value for item in group[0].ContentSequence if item.name.value == "C2348792"]
    measurements = {}
    for measurement in group.get_measurements():
        properties = {code(child.name): child.value for child in measurement[0].get("ContentSequence", []) if child.ValueType == "NUM"}
        item = measurement[0]
        measurements[code(measurement.name)] = {
            "value": measurement.value,
            "exact": item.MeasuredValueSequence[0].FloatingPointValue,
            "unit": measurement.unit.value,
            "properties": properties,
        }
    groups.append(
        {
            "tracking_identifier": group.tracking_identifier,
            "time_points": time_points,
            "finding": group.finding_type and code(group.finding_type),
            "method": group.method and code(group.method),
            "sites": [code(site.value) for site in group.finding_sites],
            "measurements": measurements,
        }
    )
evidence = [
    instance.ReferencedSOPInstanceUID
    for study in data_set.get("CurrentRequestedProcedureEvidenceSequence", [])
    for series in study.ReferencedSeriesSequence
    for instance in series.ReferencedSOPSequence
]


def text(data_set, name):
    """Text under a private or standard concept, at any depth."""
    for item in data_set.get("ContentSequence", []):
        if item.ValueType == "TEXT" and item.ConceptNameCodeSequence[0].CodeValue == name:
            yield item.TextValue
        yield from text(item, name)


foreign = {"UCUM", "RFC5646", "UMLS", "99VENTRICLE"}
unknown = sorted(
    {
        f"{value} {scheme} {meaning}"
        for scheme, value, meaning in codes(data_set)
        if scheme not in foreign and not any(meaning.casefold() in name for name in known.get((scheme, value), ()))
    }
)
print(
    json.dumps(
        {
            "patient_name": str(data_set.PatientName),
            "patient_id": str(data_set.PatientID),
            "accession_number": str(data_set.AccessionNumber),
            "study_instance_uid": data_set.StudyInstanceUID,
            "sop_instance_uid": data_set.SOPInstanceUID,
            "content_date_time": data_set.ContentDate + data_set.ContentTime,
            "devices": [str(context.observer_identifying_attributes.name) for context in content.get_observer_contexts()],
            "algorithms": sorted(set(text(data_set, "111001"))),
            "parameters": list(text(data_set, "111002")),
            "flags": list(text(data_set, "QUALITY_FLAG")),
            "comments": list(text(data_set, "121106")),
            "evidence": evidence,
            "groups": groups,
            "unknown_codes": unknown,
        }
    )
)
