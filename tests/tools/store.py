"""Stores DICOM files with dicomweb-client (STOW-RS), all in one request, and prints as JSON what came back.

usage: store.py URL FILE...

URL is the root of the DICOMweb service. `status` is 200 where the client returned a data set, else what it raised; `stored` and `failed` are the SOP
Instance UIDs in it, `reasons` the Failure Reasons of the latter.
"""

import json
import sys

import pydicom
import requests
from dicomweb_client.api import DICOMwebClient

url, *files = sys.argv[1:]
client = DICOMwebClient(url)
try:
    answer, status = client.store_instances([pydicom.dcmread(file) for file in files]), None
except requests.HTTPError as error:
    answer, status = pydicom.Dataset(), error.response.status_code
stored, failed = (answer.get(name) or [] for name in ("ReferencedSOPSequence", "FailedSOPSequence"))
print(
    json.dumps(
        {
            "raised": status,
            "stored": [item.ReferencedSOPInstanceUID for item in stored],
            "failed": [item.ReferencedSOPInstanceUID for item in failed],
            "reasons": [item.FailureReason for item in failed],
        }
    )
)
