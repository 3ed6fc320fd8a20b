#!/usr/bin/env bash
# Installs the programs of others that the tests check Ventricle with: dciodvfy (dicom3tools), dcmtk (also storescu, storescp) and gdcmconv
# (libgdcm-tools) for DICOM, Orthanc with its DICOMweb and Python plugins for an archive, strace for what is written to disk, libfaketime for
# clocks that are set, Chromium for the pages and what the report prints to, Node with the validators for glTF, FHIR and JSON Schema and a
# DICOMweb client, Python with highdicom for structured reports and another such client, PostgreSQL for what is stored there, valgrind for counts
# of instructions.
# What cannot be installed is said; its tests then skip, or fail when CI is set.
set -euo pipefail
cd "$(dirname "$0")"

as_root() {
  if [[ $(id -u) == 0 ]]; then "$@"
  elif command -v sudo >/dev/null && sudo -n true 2>/dev/null; then sudo -n "$@"
  else return 1; fi
}

missing=()
command -v dciodvfy >/dev/null || missing+=(dicom3tools)
command -v dcmcjpls >/dev/null || missing+=(dcmtk)
command -v gdcmconv >/dev/null || missing+=(libgdcm-tools)
[[ -x /usr/sbin/Orthanc ]] || missing+=(orthanc)
[[ -e /usr/share/orthanc/plugins/libOrthancDicomWeb.so ]] || missing+=(orthanc-dicomweb)
[[ -e /usr/share/orthanc/plugins/libOrthancPython.so ]] || missing+=(orthanc-python)
command -v curl >/dev/null || missing+=(curl)
command -v strace >/dev/null || missing+=(strace)
command -v valgrind >/dev/null || missing+=(valgrind)
compgen -G '/usr/lib/*/faketime/libfaketimeMT.so.1' >/dev/null || missing+=(libfaketime)
command -v chromium >/dev/null || missing+=(chromium)
command -v node >/dev/null || missing+=(nodejs)
command -v npm >/dev/null || missing+=(npm)
# Debian's python3 has venv but not what fills it.
python3 -c 'import ensurepip' 2>/dev/null || missing+=(python3 python3-venv)
command -v initdb >/dev/null || compgen -G '/usr/lib/postgresql/*/bin/initdb' >/dev/null || missing+=(postgresql)
if ((${#missing[@]})); then
  if command -v apt-get >/dev/null && as_root true; then
    echo "installing ${missing[*]}"
    # The tests start a server of their own; the one that Debian would make and start with the package is not needed.
    no_cluster=/etc/postgresql-common/createcluster.d/ventricle-tests.conf
    if [[ " ${missing[*]} " == *" postgresql "* ]]; then
      as_root mkdir -p "${no_cluster%/*}"
      echo 'create_main_cluster = false' | as_root tee "$no_cluster" >/dev/null
    fi
    # Likewise Orthanc, which Debian would start at once and at every boot, on all addresses: masked, and no service is started while this installs.
    no_services=/usr/sbin/policy-rc.d
    if [[ " ${missing[*]} " == *" orthanc "* && ! -e /etc/systemd/system/orthanc.service ]]; then
      as_root mkdir -p /etc/systemd/system
      as_root ln -s /dev/null /etc/systemd/system/orthanc.service
      echo "Orthanc's own service is kept from starting (systemctl unmask orthanc allows it again)"
    fi
    if [[ " ${missing[*]} " == *" orthanc"* && ! -e $no_services ]]; then
      printf '#!/bin/sh\nexit 101\n' | as_root tee "$no_services" >/dev/null
      as_root chmod 755 "$no_services"
    else
      no_services=
    fi
    { as_root apt-get update -qq && as_root env DEBIAN_FRONTEND=noninteractive apt-get install -qq -y --no-install-recommends "${missing[@]}"; } \
      >/dev/null || echo "not installed: ${missing[*]} (apt-get failed)"
    as_root rm -f "$no_cluster" ${no_services:+"$no_services"}
  else
    echo "not installed: ${missing[*]} (needs apt-get and root, or sudo without a password)"
  fi
fi

if command -v npm >/dev/null; then
  # npm leaves a copy of the lock file in node_modules: newer than ours means installed from it.
  if [[ ! node_modules/.package-lock.json -nt package-lock.json ]]; then
    npm ci --silent --no-audit --no-fund || echo "not installed: the npm packages of tests/tools (npm ci failed there)"
  fi
  # The pages are inside of the program that the tests start: built before it, with the packages that drive them in a browser.
  make --no-print-directory -C ../.. web >/dev/null || echo "not built: the pages of web/ (make web failed there)"
else
  echo "not installed: the npm packages of tests/tools, and the pages of web/ are not built (npm is missing)"
fi

if python3 -c 'import ensurepip' 2>/dev/null; then
  # The copy of the list beside the packages says what they were installed from.
  if ! cmp -s requirements.txt .venv/requirements.txt; then
    { rm -rf .venv && python3 -m venv .venv && .venv/bin/pip install --quiet --disable-pip-version-check --requirement requirements.txt &&
      cp requirements.txt .venv/; } || echo "not installed: the Python packages of tests/tools/requirements.txt (pip failed)"
  fi
else
  echo "not installed: the Python packages of tests/tools/requirements.txt (python3-venv is missing)"
fi
