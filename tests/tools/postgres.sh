#!/usr/bin/env bash
# A PostgreSQL of its own for a test run, from Debian's package `postgresql`: a cluster in a directory, on a free loopback port, that
# trusts whoever reaches it.
#
#   postgres.sh start DIRECTORY     makes it (the directory must not be there), starts it, prints its URL
#   postgres.sh durable DIRECTORY   the same, with every commit synchronised to disk
#   postgres.sh crash DIRECTORY     ends it as a crash would and starts it again on the same port
#   postgres.sh halt DIRECTORY      stops it for the time being
#   postgres.sh resume DIRECTORY    starts it again on the same port
#   postgres.sh stop DIRECTORY      stops and deletes it
#   postgres.sh run DIRECTORY PROGRAM [ARGUMENT]...
#                                   runs a program of the same installation, as pg_dump
#
# `start` ends with status 3 where PostgreSQL is not installed. fsync is off, which makes the tests of the store several times as fast
# and takes nothing from them: what they crash are processes, and what was written outlives those in the kernel's cache. It would be
# lost with the machine, which no test here can crash. Measurements of commits need `durable`.
set -euo pipefail

action=${1:-} directory=${2:-}
if [[ -z $directory ]] || [[ ! $action =~ ^(start|durable|crash|halt|resume|stop|run)$ ]]; then
  sed -n '2,12s/^# \{0,1\}//p' "$0" >&2
  exit 2
fi

bin=$(for candidate in "$(command -v initdb | xargs -r readlink -f | xargs -r dirname)" /usr/lib/postgresql/*/bin; do
  [[ -x $candidate/initdb && -x $candidate/pg_ctl ]] && echo "$candidate"
done | sort -V | tail -n 1)
if [[ -z $bin ]]; then
  echo "PostgreSQL is not installed (apt-get install postgresql)" >&2
  exit 3
fi

# PostgreSQL refuses to run as root.
as_other=()
if [[ $(id -u) == 0 ]]; then
  user=postgres
  id "$user" >/dev/null 2>&1 || user=nobody
  as_other=(setpriv --reuid "$user" --regid "$(id -g "$user")" --clear-groups env "HOME=$directory")
fi
# The working directory may be one that user cannot enter.
unprivileged() { (cd / && "${as_other[@]}" "$@"); }

case $action in
  start | durable)
    mkdir -p "$(dirname "$directory")"
    mkdir "$directory"
    if ((${#as_other[@]})); then chown "$user" "$directory"; fi
    unprivileged "$bin/initdb" --pgdata "$directory/data" --username ventricle --auth trust --encoding UTF8 --no-locale --no-sync \
      >"$directory.log" 2>&1 || { cat "$directory.log" >&2; exit 1; }
    rm "$directory.log"
    # Below the ports that the system gives to connections. Another process may have the one drawn: then the next is tried.
    for _ in {1..20}; do
      port=$((20000 + RANDOM % 12000))
      options="-c listen_addresses=127.0.0.1 -c port=$port -c unix_socket_directories= -c max_connections=200"
      [[ $action == durable ]] || options+=" -c fsync=off -c full_page_writes=off"
      if unprivileged "$bin/pg_ctl" start --silent --wait --pgdata "$directory/data" --log "$directory/log" --options "$options" \
        >/dev/null 2>&1; then
        echo "postgres://ventricle@127.0.0.1:$port/postgres"
        exit 0
      fi
    done
    cat "$directory/log" >&2
    exit 1
    ;;
  crash)
    # Options given at the start are kept by `restart`.
    unprivileged "$bin/pg_ctl" restart --silent --wait --mode immediate --pgdata "$directory/data" --log "$directory/log" >/dev/null
    ;;
  halt)
    unprivileged "$bin/pg_ctl" stop --silent --wait --mode fast --pgdata "$directory/data" >/dev/null
    ;;
  resume)
    # `start` would not know the options.
    unprivileged "$bin/pg_ctl" restart --silent --wait --pgdata "$directory/data" --log "$directory/log" >/dev/null 2>&1
    ;;
  run)
    "$bin/${3:?which program?}" "${@:4}"
    ;;
  stop)
    unprivileged "$bin/pg_ctl" stop --silent --wait --mode immediate --pgdata "$directory/data" >/dev/null 2>&1 || true
    rm -rf "$directory"
    ;;
esac
