#!/usr/bin/env bash
# Builds the release in the current directory so that the program does not tell where: paths of the sources, of the registry and of the toolchain
# are replaced by names. What else could differ is pinned: the compiler (rust-toolchain.toml), the crates (Cargo.lock), the viewer's packages
# (web/package-lock.json). No time is in the program.
set -euo pipefail

cargo_home=${CARGO_HOME:-$HOME/.cargo}
target=${CARGO_TARGET_DIR:-$PWD/target}
remap="--remap-path-prefix=$PWD=ventricle --remap-path-prefix=$target=target --remap-path-prefix=$cargo_home=cargo --remap-path-prefix=$(rustc --print sysroot)=rust"
RUSTFLAGS="${RUSTFLAGS:-} $remap" cargo build --release --locked
