#!/usr/bin/env bash
# Known vulnerabilities of the npm packages: of the viewer and its client, which are in the program, and of the tools that the tests run. Asks the
# registry; where that does not answer, or npm is not there, that is said. What is found fails, unless audit-exceptions.json names it with a reason
# and a day.
set -euo pipefail
cd "$(dirname "$0")/../.."

if ! command -v npm >/dev/null; then
  echo "not checked: advisories of npm packages, as npm is not installed"
  exit 0
fi
status=0
for folder in web tests/tools; do
  # npm ends with a status of its own where it finds something, or gets no answer: what it said decides.
  said=$(cd "$folder" && npm audit --json 2>/dev/null) || true
  node tests/tools/audit.mjs tests/tools/audit-exceptions.json "$folder" <<<"$said" || { [[ $? == 3 ]] || status=1; }
done
exit "$status"
