-- Version 3: DICOM instances that came one by one, kept until the study they belong to is whole, and by which job each was taken. The
-- data is an excerpt that names nobody; it goes when a job has taken the instance for good.

CREATE TABLE instances (
    owner TEXT NOT NULL,
    sop_instance_uid TEXT NOT NULL,
    sop_class_uid TEXT NOT NULL,
    study_instance_uid TEXT NOT NULL,
    series_instance_uid TEXT NOT NULL,
    holds TEXT NOT NULL,
    sha256 TEXT NOT NULL,
    size BIGINT NOT NULL,
    data {bytes},
    job_id TEXT REFERENCES jobs (id) ON DELETE CASCADE,
    received_at BIGINT NOT NULL,
    PRIMARY KEY (owner, sop_instance_uid)
);

CREATE INDEX instances_by_series ON instances (owner, study_instance_uid, series_instance_uid);
CREATE INDEX instances_waiting ON instances (received_at) WHERE job_id IS NULL;
CREATE INDEX instances_by_job ON instances (job_id);
