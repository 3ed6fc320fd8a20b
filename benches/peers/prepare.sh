#!/usr/bin/env bash
# Installs what Ventricle is compared with from PyPI into target/peers, which may be thrown away. The copy of the list beside the packages says
# what they were installed from.
set -euo pipefail
cd "$(dirname "$0")"
environment=${CARGO_TARGET_DIR:-../../target}/peers
python3 -c 'import ensurepip' 2>/dev/null || { echo "make bench-peers needs Python 3.11 or later with venv (Debian packages python3 and python3-venv)"; exit 1; }
if ! cmp -s requirements.txt "$environment/requirements.txt"; then
  rm -rf "$environment"
  python3 -m venv "$environment"
  "$environment/bin/pip" install --quiet --disable-pip-version-check --requirement requirements.txt
  cp requirements.txt "$environment/"
fi
