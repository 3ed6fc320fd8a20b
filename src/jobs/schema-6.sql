-- Version 6: whether a job's input is kept after its end, where its request says so, and what a list tells of its result. Both are absent in
-- jobs of before: the operator's setting decides, and nothing is told.

ALTER TABLE jobs ADD COLUMN keep_input BOOLEAN;
ALTER TABLE jobs ADD COLUMN summary TEXT;
