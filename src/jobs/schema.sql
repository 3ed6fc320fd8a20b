-- Version 1. Times are ms since 1970 by the clock of the database. BIGINT, TEXT, DOUBLE PRECISION and BOOLEAN mean the same on SQLite
-- and PostgreSQL.

CREATE TABLE jobs (
    id TEXT PRIMARY KEY,
    owner TEXT NOT NULL,
    idempotency_key TEXT,
    request_hash {bytes} NOT NULL,
    kind TEXT NOT NULL,
    parameters TEXT NOT NULL,
    study_instance_uid TEXT,
    input_bytes BIGINT NOT NULL,
    state TEXT NOT NULL CHECK (state IN ('queued', 'running', 'succeeded', 'failed', 'cancelled')),
    priority BIGINT NOT NULL DEFAULT 0,
    attempts BIGINT NOT NULL DEFAULT 0,
    max_attempts BIGINT NOT NULL,
    run_after BIGINT NOT NULL,
    lease_owner TEXT,
    lease_until BIGINT,
    cancel_requested BOOLEAN NOT NULL DEFAULT FALSE,
    progress DOUBLE PRECISION NOT NULL DEFAULT 0,
    stage TEXT,
    gates_done BIGINT NOT NULL DEFAULT 0,
    gates_total BIGINT NOT NULL,
    version BIGINT NOT NULL DEFAULT 1,
    error TEXT,
    created_at BIGINT NOT NULL,
    started_at BIGINT,
    finished_at BIGINT,
    expires_at BIGINT,
    UNIQUE (owner, idempotency_key)
);

CREATE INDEX jobs_by_state ON jobs (state, priority, id);
CREATE INDEX jobs_by_study ON jobs (study_instance_uid, id);

CREATE TABLE blobs (
    job_id TEXT NOT NULL REFERENCES jobs (id) ON DELETE CASCADE,
    name TEXT NOT NULL,
    media_type TEXT NOT NULL,
    sha256 TEXT NOT NULL,
    size BIGINT NOT NULL,
    data {bytes} NOT NULL,
    PRIMARY KEY (job_id, name)
);
