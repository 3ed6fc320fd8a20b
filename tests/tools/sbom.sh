#!/usr/bin/env bash
# The bills of materials of a release, in CycloneDX, into target/sbom: ventricle.cdx.json of the crates that are linked into the program,
# ventricle-web.cdx.json of the npm packages in its pages. Then they are compared with the lock files. cargo-cyclonedx is installed under
# target/tools where it is missing; times and serial numbers are those of the commit (SOURCE_DATE_EPOCH), so that the same sources give the same bills.
set -euo pipefail
cd "$(dirname "$0")/../.."

version=0.5.9
tools=$PWD/target/tools
out=$PWD/target/sbom
if ! "$tools/bin/cargo-cyclonedx" cyclonedx --version 2>/dev/null | grep -qF " $version"; then
  echo "installing cargo-cyclonedx $version into target/tools"
  CARGO_TARGET_DIR=$tools/build cargo install --quiet --locked --root "$tools" "cargo-cyclonedx@$version"
  rm -rf "$tools/build"
fi
mkdir -p "$out"
export SOURCE_DATE_EPOCH=${SOURCE_DATE_EPOCH:-$(git log -1 --format=%ct 2>/dev/null || echo 0)}

# It writes beside the manifest.
trap 'rm -f ventricle-sbom.json' EXIT
PATH=$tools/bin:$PATH cargo cyclonedx --quiet --format json --spec-version 1.5 --target all --no-build-deps --override-filename ventricle-sbom
mv ventricle-sbom.json "$out/ventricle.cdx.json"
cargo tree --locked --edges normal --target all --prefix none --format '{p}' | awk '{ print $1, substr($2, 2) }' | sort -u >"$out/crates.txt"

if command -v npm >/dev/null; then
  (cd web && npm sbom --package-lock-only --omit dev --sbom-format cyclonedx 2>/dev/null) >"$out/ventricle-web.cdx.json"
else
  echo "not written: the bill of the pages, as npm is not installed"
fi
node tests/tools/check-sbom.mjs "$out"
