"""Sends gated reconstructions of the heart from Orthanc to Ventricle: a script for Orthanc's Python plugin.

What became stable is read from Orthanc's own list of changes, and what is still to be sent is kept in its database, so that a series is sent
once it can be, whichever of the two was away. Other series are left alone: Orthanc takes an answer that refuses some instances for a failure.
A series that is sent twice is one job.

The log names series by Orthanc's own identifiers, no patients. Series from before the first start are not sent; POST /dicom-web/servers/ventricle/stow does.
"""

import json
import threading
import time

import orthanc

SETTINGS = {"Server": "ventricle", "PauseSeconds": 10, "GiveUpHours": 25, **json.loads(orthanc.GetConfiguration()).get("Forward", {})}
LONGEST_PAUSE_S = 3600
# What the third value of Image Type has to be. Add "RECON TOMO" for ungated volumes, if all of yours are hearts.
KINDS = {"RECON GATED TOMO"}
# Where the state is kept: a number of our own among Orthanc's global properties.
PROPERTY = 20490

stopping = threading.Event()


def get(path):
    return json.loads(orthanc.RestApiGet(path))


def eligible(series):
    """The instances of a series that are to be sent."""
    try:
        described = get(f"/series/{series}")
        if described["MainDicomTags"].get("Modality") != "NM":
            return []
        tags = {instance: get(f"/instances/{instance}/simplified-tags") for instance in described["Instances"]}
    except orthanc.OrthancException:
        return []  # deleted meanwhile
    return [instance for instance, values in tags.items() if KINDS & set(values.get("ImageType", "").split("\\")[2:3])]


def send(instances):
    """Sends instances in one request. Whether all were taken; None when Orthanc stops before that is known."""
    try:
        body = json.dumps({"Resources": instances, "Synchronous": False})
        job = json.loads(orthanc.RestApiPostAfterPlugins(f"/dicom-web/servers/{SETTINGS['Server']}/stow", body))["ID"]
        while not stopping.wait(0.2):
            state = get(f"/jobs/{job}")["State"]
            if state in ("Success", "Failure"):
                return state == "Success"
    except orthanc.OrthancException as error:
        orthanc.LogWarning(f"Forward: {error}")
        return False
    return None


def series_of(instance):
    """The series of an instance, nothing where it is deleted meanwhile."""
    try:
        return {get(f"/instances/{instance}")["ParentSeries"]}
    except orthanc.OrthancException:
        return set()


def enqueue(state, series):
    if eligible(series):
        state["waiting"][series] = {"attempts": 0, "since": time.time(), "due": time.time()}


def note_changes(state):
    """Reads what changed since the last look: series that get instances are open, and to be sent once they are stable."""
    done = False
    while not done:
        page = get(f"/changes?since={state['seen']}&limit=1000")
        for change in page["Changes"]:
            if change["ChangeType"] == "NewInstance":
                state["open"] = sorted({*state["open"], *series_of(change["ID"])})
            elif change["ChangeType"] == "StableSeries":
                state["open"] = [series for series in state["open"] if series != change["ID"]]
                enqueue(state, change["ID"])
        state["seen"], done = page["Last"], page["Done"]


def close_forgotten(state):
    """Orthanc never says of a series that it is stable where it was stopped before: it simply is after the start."""
    for series in state["open"]:
        try:
            if not get(f"/series/{series}")["IsStable"]:
                continue
            enqueue(state, series)
        except orthanc.OrthancException:
            pass  # deleted meanwhile
        state["open"] = [other for other in state["open"] if other != series]


def send_next(state):
    """Sends what is due first, if anything is."""
    due = [series for series, wait in state["waiting"].items() if wait["due"] <= time.time()]
    if not due:
        return
    series = min(due, key=lambda series: state["waiting"][series]["due"])
    wait = state["waiting"][series]
    instances = eligible(series)
    taken = send(instances) if instances else True
    if taken is None:
        return
    del state["waiting"][series]
    if taken:
        return
    if time.time() - wait["since"] > SETTINGS["GiveUpHours"] * 3600:
        orthanc.LogError(f"Forward: series {series} was not taken in {wait['attempts'] + 1} attempts and is not sent again")
        return
    pause = min(SETTINGS["PauseSeconds"] * 2 ** min(wait["attempts"], 20), LONGEST_PAUSE_S)
    orthanc.LogWarning(f"Forward: series {series} was not taken, again in {pause} s")
    state["waiting"][series] = {**wait, "attempts": wait["attempts"] + 1, "due": time.time() + pause}


def work():
    kept = orthanc.GetGlobalProperty(PROPERTY, "")
    state = json.loads(kept) if kept else {"seen": get("/changes?last")["Last"], "open": [], "waiting": {}}
    started = False
    while not stopping.wait(1):
        try:
            note_changes(state)
            if not started:
                close_forgotten(state)
                started = True
            send_next(state)
        except Exception as error:  # whatever it was, the next round tries again
            orthanc.LogError(f"Forward: {type(error).__name__} {error}")
        now = json.dumps(state)
        if now != kept:
            orthanc.SetGlobalProperty(PROPERTY, now)
            kept = now


worker = threading.Thread(target=work, daemon=True)


def on_change(change, level, resource):
    if change == orthanc.ChangeType.ORTHANC_STARTED:
        worker.start()
    elif change == orthanc.ChangeType.ORTHANC_STOPPED:
        stopping.set()
        # Not longer: a job that is submitted right now waits for a lock that Orthanc holds until this returns.
        worker.join(timeout=1)


orthanc.RegisterOnChangeCallback(on_change)
