#!/usr/bin/env bash
# Builds the release of the commit that is checked out twice, in two directories of different names, and compares the programs byte by byte. Takes two
# release builds (some ten minutes on two processors). What is not committed is left out; the viewer, if it was built, is copied to both.
set -euo pipefail
cd "$(dirname "$0")/../.."

sources=$PWD
work=$(mktemp -d "${TMPDIR:-/tmp}/ventricle-reproduce-XXXXXX")
trap 'rm -rf "$work"' EXIT
commit=$(git rev-parse --short=12 HEAD)
for place in first a/second-and-longer-place; do
  mkdir -p "$work/$place"
  git archive HEAD | tar -x -C "$work/$place"
  if [[ -d web/dist ]]; then cp -r web/dist "$work/$place/web/"; fi
  (
    cd "$work/$place"
    VENTRICLE_COMMIT=$commit CARGO_TARGET_DIR=$work/$place/target "$sources/tests/tools/release.sh"
  )
done
sums=$(sha256sum "$work"/first/target/release/ventricle "$work"/a/second-and-longer-place/target/release/ventricle)
echo "${sums//$work\//}"
[[ $(cut -d' ' -f1 <<<"$sums" | sort -u | wc -l) == 1 ]] || { echo "the programs differ"; exit 1; }
echo "the same program twice, of commit $commit"
