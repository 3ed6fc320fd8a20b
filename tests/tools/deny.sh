#!/usr/bin/env bash
# Licences, sources, duplicates and known vulnerabilities of what Ventricle is built from (deny.toml). In CI cargo-deny is installed when
# it is missing; elsewhere its absence is said. The list of vulnerabilities comes over the network: where it cannot be had, that is said.
set -euo pipefail
cd "$(dirname "$0")/../.."

if ! command -v cargo-deny >/dev/null; then
  if [[ -z ${CI:-} ]]; then
    echo "not checked: licences and advisories, as cargo-deny is not installed (cargo install --locked cargo-deny)"
    exit 0
  fi
  env -u CARGO_TARGET_DIR cargo install --quiet --locked cargo-deny
fi
cargo deny --locked check bans licenses sources
if log=$(cargo deny --locked check advisories 2>&1); then
  echo "advisories ok"
elif grep -q 'failed to fetch advisory database' <<<"$log"; then
  echo "not checked: advisories, as their database cannot be reached"
else
  echo "$log"
  exit 1
fi
