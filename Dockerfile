# syntax=docker/dockerfile:1

# The viewer, which the program holds. Its packages first: they are fetched again only when their list changes.
FROM node:24-bookworm-slim AS web
WORKDIR /build/web
COPY web/package.json web/package-lock.json ./
COPY web/client/package.json client/
RUN npm ci --no-audit --no-fund
COPY openapi ../openapi
COPY web ./
RUN npm run build

# The version of rust-toolchain.toml, which is not copied: it asks for rustfmt and clippy too.
FROM rust:1.95.0-bookworm AS build
WORKDIR /build
# Dependencies first: this layer is built again only when the manifest or the lock file changes. The manifest names the integration
# tests and the benchmarks, so cargo wants their files to exist.
COPY Cargo.toml Cargo.lock ./
COPY .cargo .cargo
RUN mkdir -p src tests/it benches/http benches/instructions \
    && echo 'fn main() {}' > src/main.rs \
    && touch src/lib.rs tests/it/main.rs benches/queue.rs benches/scaling.rs benches/stages.rs benches/peers.rs benches/http/main.rs benches/instructions/main.rs \
    && cargo build --release --locked
COPY . .
COPY --from=web /build/web/dist web/dist
# The commit, for ventricle_build_info: docker build --build-arg VENTRICLE_COMMIT=$(git rev-parse --short=12 HEAD) .
ARG VENTRICLE_COMMIT=
# Copied files keep their times, which may lie before those of the empty ones above.
RUN touch src/main.rs src/lib.rs \
    && cargo build --release --locked \
    && ./target/release/ventricle --version \
    && mkdir /data

# A C library, certificate authorities and nothing else: no shell, no package manager. The tag moves with Debian's security updates; for an image
# that is the same for ever, write its digest behind it (docker buildx imagetools inspect).
FROM gcr.io/distroless/cc-debian12:nonroot
LABEL org.opencontainers.image.title="Ventricle" \
      org.opencontainers.image.description="Reconstructs the left ventricle from gated cardiac SPECT" \
      org.opencontainers.image.licenses="MIT OR Apache-2.0"
# Whom callbacks' receivers are checked against (--callback-ca-file) is in the base: mount another file over
# /etc/ssl/certs/ca-certificates.crt for authorities of your own.
COPY --from=build --chown=10001:10001 --chmod=0700 /data /data
COPY --from=build /build/target/release/ventricle /usr/local/bin/ventricle
COPY LICENSE LICENSE-MIT LICENSE-APACHE /usr/share/doc/ventricle/
# A number, as there is nothing to add a user with. Nothing outside of /data is written: the root may be read-only.
USER 10001:10001
WORKDIR /data
# The port is open to the container's network, and the service refuses that until there are keys (`ventricle keys add` on the volume), an OpenID
# provider, or the operator's word that something before it authenticates (-e VENTRICLE_INSECURE_NO_AUTH=true).
ENV VENTRICLE_LISTEN=0.0.0.0:8080 VENTRICLE_DATA_DIR=/data VENTRICLE_LOG_FORMAT=json
EXPOSE 8080
VOLUME /data
STOPSIGNAL SIGTERM
HEALTHCHECK --interval=15s --timeout=5s --start-period=10s --retries=3 CMD ["/usr/local/bin/ventricle", "healthcheck"]
ENTRYPOINT ["/usr/local/bin/ventricle"]
CMD ["serve"]
