-- Version 2: how long a finished job is kept, and who is told of its end.

ALTER TABLE jobs ADD COLUMN retention_ms BIGINT;
ALTER TABLE jobs ADD COLUMN callback_url TEXT;

CREATE INDEX jobs_by_expiry ON jobs (expires_at);

CREATE TABLE deliveries (
    id TEXT PRIMARY KEY,
    job_id TEXT NOT NULL REFERENCES jobs (id) ON DELETE CASCADE,
    url TEXT NOT NULL,
    state TEXT NOT NULL CHECK (state IN ('pending', 'delivered', 'given_up')),
    attempts BIGINT NOT NULL DEFAULT 0,
    run_after BIGINT NOT NULL,
    lease_until BIGINT,
    last_error TEXT,
    created_at BIGINT NOT NULL,
    finished_at BIGINT
);

CREATE INDEX deliveries_by_state ON deliveries (state, run_after);
-- Deleting a job deletes its deliveries: without this, by reading all of them.
CREATE INDEX deliveries_by_job ON deliveries (job_id);
