# Each target is one command a person types; make alone lists them.

SHELL := /usr/bin/env bash
.SHELLFLAGS := -euo pipefail -c
.DEFAULT_GOAL := help
.PHONY: help demo build web test chaos soak bench bench-peers bench-http bench-queue bench-scaling guard guard-update fuzz lint sbom openapi tables accuracy

# Absent in a fresh clone; cargo then uses ./target.
CARGO_TARGET_DIR ?= target

help: ## lists the targets
	@awk -F ':.*## ' '/^[a-z-]+:.*## / { printf "  make %-12s %s\n", $$1, $$2 }' $(MAKEFILE_LIST)

demo: build ## starts the service, posts a beating phantom as DICOM, shows the result (ONCE=1: then exits)
	@"$(CARGO_TARGET_DIR)/release/ventricle" demo $(if $(ONCE),--once)

build: ## builds the release binary, with the viewer inside where npm is there
	@if command -v npm >/dev/null; then $(MAKE) --no-print-directory web; else echo "npm is absent: the program is built without the viewer"; fi
	cargo build --release --locked

# What the viewer is made from; its files are made again where any of them is newer.
WEB_SOURCES := openapi/openapi.json $(shell find web \( -name node_modules -o -name dist -o -path web/tests \) -prune -o -type f -print 2>/dev/null)

web: ## builds the viewer into web/dist (needs npm)
	@command -v npm >/dev/null || { echo "make web needs npm: install Node.js 20 or later with npm (Debian packages nodejs and npm)"; exit 1; }
	@if [[ -e web/package.json ]]; then $(MAKE) --no-print-directory web/dist/index.html; else echo "there is no web/package.json: nothing to build"; fi

web/node_modules/.package-lock.json: web/package.json web/package-lock.json
	cd web && npm ci --no-audit --no-fund
	@touch $@

web/dist/index.html: web/node_modules/.package-lock.json $(WEB_SOURCES)
	cd web && npm run build
	@touch $@

web/package.json web/package-lock.json:

test: ## installs what the tests need on Debian, then runs all of them
	@tests/tools/prepare.sh
	@tests/tools/run.sh
	@tests/tools/guard.sh

guard: ## counts the instructions of a small workload under valgrind and compares them with benches/instructions.json
	@tests/tools/guard.sh

guard-update: ## counts them and writes benches/instructions.json, to be committed
	@tests/tools/guard.sh update

bench: ## measures each stage and whole cycles, and how their cost grows (some five minutes)
	cargo bench --locked --bench stages

bench-peers: ## measures beside ITK, SimpleITK, scikit-image, scipy, numba and pyamg, installed from PyPI under target/ (some five minutes)
	@benches/peers/prepare.sh
	cargo bench --locked --bench peers

# As long as a person likes; the tests of CI do the same with fewer. On PostgreSQL a kill is a round: a node killed, one paused beyond its
# lease, one replaced, the listeners cut off and the database crashed.
CHAOS_JOBS ?= 500
CHAOS_KILLS ?= 8

# The release is what is tested; the tests need not be built like it.
release_tests = TEST_PROGRAM="$$(cd "$(CARGO_TARGET_DIR)" && pwd)/release/ventricle" cargo test --locked --test it

chaos: build ## kills services and databases at random times under 500 real jobs each, takes disk, clock, descriptors and database away, and says what came of it
	CHAOS_JOBS=$(CHAOS_JOBS) CHAOS_KILLS=$(CHAOS_KILLS) $(release_tests) chaos:: -- --nocapture --test-threads 1

# The tests of CI do the same for a minute.
SOAK_SECONDS ?= 1800

soak: build ## puts the release service under mixed load for half an hour, and judges memory, descriptors, errors and the time of looks
	SOAK_SECONDS=$(SOAK_SECONDS) $(release_tests) soak:: -- --nocapture

bench-queue: ## measures what the queue carries and what more nodes bring (about five minutes)
	cargo bench --locked --bench queue

bench-http: ## measures the service through HTTP: accepted, answered, computed, memory (about five minutes)
	cargo bench --locked --bench http -- $(SECTIONS)

bench-scaling: ## simulates 1, 10 and 1 000 studies a minute from what bench-http measured
	cargo bench --locked --bench scaling

# Targets and their corpus are in fuzz/; what is found stays in fuzz/artifacts.
FUZZ_SECONDS ?= 600
FUZZ_TARGETS ?= prescan dicom nifti npy json multipart frame_header

fuzz: ## runs each fuzz target for FUZZ_SECONDS (needs a nightly toolchain and cargo-fuzz)
	@tests/tools/fuzz.sh $(FUZZ_SECONDS) $(FUZZ_TARGETS)

lint: ## formatting, clippy, documentation, licences and advisories (crates and npm packages)
	cargo fmt --check
	cargo clippy --all-targets --locked -- -D warnings
	RUSTDOCFLAGS="-D warnings" cargo doc --no-deps --locked
	@tests/tools/deny.sh
	@tests/tools/audit.sh

sbom: ## writes what a release is made of, in CycloneDX, into target/sbom (installs cargo-cyclonedx under target/tools)
	@tests/tools/sbom.sh

openapi: ## writes openapi/openapi.json from the routes, and the schemas beside it from the types
	mkdir -p openapi
	cargo run --quiet --locked -- openapi > openapi/openapi.json.new
	mv openapi/openapi.json.new openapi/openapi.json
	for schema in report-1 comparison-1; do \
		cargo run --quiet --locked -- openapi --schema $$schema > openapi/$$schema.json.new; \
		mv openapi/$$schema.json.new openapi/$$schema.json; \
	done

tables: build ## redoes the paper's tables and figures into docs/paper.md and docs/paper/
	@"$(CARGO_TARGET_DIR)/release/ventricle" tables --write docs/paper.md --figures docs/paper

# The labelled studies are not part of the project; without them their tables stay as they are.
LABELLED ?= ../shared/data/gated-short-axis

accuracy: build ## measures both presets on phantoms and labelled studies into docs/accuracy.md (some twenty minutes)
	@"$(CARGO_TARGET_DIR)/release/ventricle" accuracy --ablation --write docs/accuracy.md --plots docs/accuracy \
		$(if $(wildcard $(LABELLED)/labels.json),--real $(LABELLED))
	@"$(CARGO_TARGET_DIR)/release/ventricle" accuracy --regional --write docs/accuracy.md
	@"$(CARGO_TARGET_DIR)/release/ventricle" accuracy --spoiled --write docs/accuracy.md
