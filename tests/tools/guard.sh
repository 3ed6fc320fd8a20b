#!/usr/bin/env bash
# The guard against slower code: instructions of a small fixed workload under valgrind against benches/instructions.json. With `update`,
# writes that file instead. Without valgrind it skips, or fails where CI is set.
set -euo pipefail
cd "$(dirname "$0")/../.."
if ! command -v valgrind >/dev/null; then
  [[ -z ${CI:-} && ${1:-} != update ]] || { echo "valgrind must be installed (Debian package valgrind)"; exit 1; }
  echo "skipped: valgrind is absent (Debian package valgrind)"
  exit
fi
# The counts are those of 64-bit x86; other instructions have other counts.
if [[ $(uname -m) != x86_64 ]]; then
  echo "skipped: the committed counts of instructions are those of x86_64, and this is $(uname -m)"
  exit
fi
exec cargo bench --quiet --locked --bench instructions -- "$@"
