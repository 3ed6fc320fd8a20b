"""Stores DICOM files with dicomweb-client (STOW-RS), all in one request, and prints as JSON what came back.

usage: store.py URL FILE...

URL is the root of the DICOMweb service. `statuses` are those of the HTTP answers; `raised` says whether the client raised an error for the last.
`stored` and `failed` are the SOP Instance UIDs in the data set that it returned else, `reasons` the Failure Reasons of the latter.
"""

import json
import sys

import pydicom
import requests
from dicomweb_client.api import DICOMwebClient

url, *files = sys.argv[1:]
statuses = []
session = requests.Session()
session.hooks["response"].append(lambda response, **_: statuses.append(response.status_code))
try:
    answer, raised = DICOMwebClient(url, session=session).store_instances([pydicom.dcmread(file) for file in files]), False
except requests.HTTPError:
    answer, raised = pydicom.Dataset(), True
stored, failed = (answer.get(name) or [] for name in ("ReferencedSOPSequence", "FailedSOPSequence"))
print(
    json.dumps(
        {
            "statuses": statuses,
            "raised": raised,
            "stored": [item.ReferencedSOPInstanceUID for item in stored],
            "failed": [item.ReferencedSOPInstanceUID for item in failed],
            "reasons": [item.FailureReason for item in failed],
        }
    )
)
