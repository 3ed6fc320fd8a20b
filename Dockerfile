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
RUN mkdir -p src tests/it benches/http benches/instructions \
    && echo 'fn main() {}' > src/main.rs \
    && touch src/lib.rs tests/it/main.rs benches/queue.rs benches/scaling.rs benches/stages.rs benches/peers.rs benches/http/main.rs benches/instructions/main.rs \
    && cargo build --release --locked
COPY . .
COPY --from=web /build/web/dist web/dist
# Copied files keep their times, which may lie before those of the empty ones above.
RUN touch src/main.rs src/lib.rs \
    && cargo build --release --locked \
    && ./target/release/ventricle --version

FROM debian:bookworm-slim
LABEL org.opencontainers.image.title="Ventricle" \
      org.opencontainers.image.description="Reconstructs the left ventricle from gated cardiac SPECT" \
      org.opencontainers.image.licenses="MIT OR Apache-2.0"
RUN useradd --uid 10001 --user-group --no-create-home --shell /usr/sbin/nologin ventricle \
    && install --directory --owner ventricle --group ventricle --mode 0700 /data
# Whom callbacks' receivers are checked against (--callback-ca-file); mount another file over it for authorities of your own.
COPY --from=build /etc/ssl/certs/ca-certificates.crt /etc/ssl/certs/ca-certificates.crt
COPY --from=build /build/target/release/ventricle /usr/local/bin/ventricle
COPY LICENSE LICENSE-MIT LICENSE-APACHE /usr/share/doc/ventricle/
USER ventricle
WORKDIR /data
# The port is open to the container's network, and the service refuses that until there are keys (`ventricle keys add` on the volume), an OpenID
# provider, or the operator's word that something before it authenticates (-e VENTRICLE_INSECURE_NO_AUTH=true).
ENV VENTRICLE_LISTEN=0.0.0.0:8080 VENTRICLE_DATA_DIR=/data VENTRICLE_LOG_FORMAT=json
EXPOSE 8080
VOLUME /data
STOPSIGNAL SIGTERM
HEALTHCHECK --interval=15s --timeout=5s --start-period=10s --retries=3 CMD ["ventricle", "healthcheck"]
ENTRYPOINT ["ventricle"]
CMD ["serve"]
