-- Version 4: what is sent beside the news of a job's end: its result.

ALTER TABLE deliveries ADD COLUMN kind TEXT NOT NULL DEFAULT 'callback';
