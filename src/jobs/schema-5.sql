-- Version 5: an instance is the same when it comes again in another transfer syntax, so that its bytes do not tell. Absent where an earlier
-- version stored it: the excerpt's SHA-256 is compared then.

ALTER TABLE instances ADD COLUMN identity TEXT;
