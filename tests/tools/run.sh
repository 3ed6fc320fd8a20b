#!/usr/bin/env bash
# Runs all tests and ends by saying what ran: a line a binary, the tests that skipped themselves, and the sum on a line of its own.
# The tests of the store run on PostgreSQL too: on the database that TEST_DATABASE_URL names, else on a server that lives as long as this.
set -euo pipefail
cd "$(dirname "$0")/../.."

if [[ -z ${TEST_DATABASE_URL:-} ]]; then
  temporary=$(mktemp -d "${TMPDIR:-/tmp}/ventricle-postgres-XXXXXX")
  # The server's user, which is not root, passes through to its own directory.
  chmod 711 "$temporary"
  trap 'tests/tools/postgres.sh stop "$temporary/cluster" || true; rm -rf "$temporary"' EXIT
  trap 'exit 129' HUP
  trap 'exit 130' INT
  trap 'exit 143' TERM
  # Without a server the tests that need one say so and skip themselves, or fail where CI is set.
  if url=$(tests/tools/postgres.sh start "$temporary/cluster"); then export TEST_DATABASE_URL=$url; fi
fi

# --show-output, as a test that skips itself says so and passes; the output of other passing tests is dropped here.
cargo test --locked --no-fail-fast "$@" -- --show-output 2>&1 | awk '
  /^ *Running / || /^ *Doc-tests / { name = $0; sub(/^ *(Running )?/, "", name); sub(/ \([^)]*\)$/, "", name) }
  /^successes:$/ { quiet = 1 }
  /^failures:$/ || /^test result:/ { quiet = 0 }
  match($0, /skipped: .*/) { line = substr($0, RSTART); if (!(line in skips)) { skips[line] = 1; skipped[++s] = line } }
  /^test result:/ {
    for (i = 1; i <= NF; i++) { if ($i ~ /^passed;?$/) p = $(i - 1); if ($i ~ /^failed;?$/) f = $(i - 1); if ($i ~ /^ignored;?$/) g = $(i - 1) }
    passed += p; failed += f; ignored += g
    ran[++n] = sprintf("%6d passed %3d failed %3d ignored  %s", p, f, g, name)
  }
  !quiet && !/^$/ && !/^test .* \.\.\. ok$/ { print; fflush() }
  END {
    print "\nwhat ran:"
    for (i = 1; i <= n; i++) print ran[i]
    for (i = 1; i <= s; i++) print "  " skipped[i]
    if (n == 0) print "  nothing: the tests did not build"
    printf "%d passed, %d failed\n", passed, failed
  }'
