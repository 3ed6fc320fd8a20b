#!/usr/bin/env bash
# Fuzzes targets one after the other: fuzz.sh SECONDS TARGET... New inputs go to fuzz/found, the committed corpus stays as it is; an input
# that breaks a target goes to fuzz/artifacts, and the status is not 0.
set -euo pipefail
cd "$(dirname "$0")/../../fuzz"

seconds=$1
shift
if ! cargo fuzz --version >/dev/null 2>&1; then
  echo "cargo-fuzz is not installed (cargo install --locked cargo-fuzz)" >&2
  exit 1
fi
for target in "$@"; do
  mkdir -p "found/$target"
  # What is fuzzed is safe Rust, so there is no address sanitizer: it would find nothing and halve the speed.
  cargo +nightly fuzz run --sanitizer none "$target" "found/$target" "corpus/$target" -- \
    -max_total_time="$seconds" -timeout=10 -rss_limit_mb=1024 -max_len=65536 -print_final_stats=1
done
