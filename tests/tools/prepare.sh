#!/usr/bin/env bash
# Installs the programs of others that the tests check Ventricle with: dciodvfy (dicom3tools) for DICOM, strace for what is
# written to disk, Node with the Khronos validator for glTF. What cannot be installed is said; its tests then skip, or fail when CI is set.
set -euo pipefail
cd "$(dirname "$0")"

as_root() {
  if [[ $(id -u) == 0 ]]; then "$@"
  elif command -v sudo >/dev/null && sudo -n true 2>/dev/null; then sudo -n "$@"
  else return 1; fi
}

missing=()
command -v dciodvfy >/dev/null || missing+=(dicom3tools)
command -v strace >/dev/null || missing+=(strace)
command -v node >/dev/null || missing+=(nodejs)
command -v npm >/dev/null || missing+=(npm)
if ((${#missing[@]})); then
  if command -v apt-get >/dev/null && as_root true; then
    echo "installing ${missing[*]}"
    { as_root apt-get update -qq && as_root env DEBIAN_FRONTEND=noninteractive apt-get install -qq -y --no-install-recommends "${missing[@]}"; } \
      >/dev/null || echo "not installed: ${missing[*]} (apt-get failed)"
  else
    echo "not installed: ${missing[*]} (needs apt-get and root, or sudo without a password)"
  fi
fi

if command -v npm >/dev/null; then
  # npm leaves a copy of the lock file in node_modules: newer than ours means installed from it.
  if [[ ! node_modules/.package-lock.json -nt package-lock.json ]]; then
    npm ci --silent --no-audit --no-fund || echo "not installed: the glTF validator (npm ci failed in tests/tools)"
  fi
else
  echo "not installed: the glTF validator (npm is missing)"
fi
