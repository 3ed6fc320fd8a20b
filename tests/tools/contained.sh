#!/usr/bin/env bash
# Runs the service as the image does, without an engine for containers: contained.sh PROGRAM ROOT DATA [ARGUMENT…]. ROOT becomes a root directory with
# the program, the libraries it is linked to and /dev/null, nothing else, and read-only; DATA is /data in it. No shell; processes of
# its own. Needs user namespaces; ends with status 3 where the system gives none.
set -euo pipefail

program=$1 root=$2 data=$3
shift 3
unshare --user --map-root-user --mount --pid --fork true 2>/dev/null || exit 3

mkdir -p "$root"/{usr/local/bin,proc,data,dev}
touch "$root/dev/null"
cp "$program" "$root/usr/local/bin/ventricle"
# Lines of ldd: "name => path (address)", and the loader as "path (address)".
ldd "$program" | grep -o '/[^ ]*' | while read -r library; do
  mkdir -p "$root${library%/*}"
  cp -L "$library" "$root$library"
done
export root data
exec unshare --user --map-root-user --mount --pid --fork --kill-child bash -c '
  set -e
  mount --bind "$root" "$root"
  mount --bind "$data" "$root/data"
  mount --bind /dev/null "$root/dev/null"
  mount -t proc proc "$root/proc" || exit 3
  mount -o remount,ro,bind "$root"
  exec chroot "$root" "$@"
' bash /usr/local/bin/ventricle "$@"
