#!/usr/bin/env bash
# Runs a command (default: make test) on a copy of this checkout in a Debian 13 root, made by debootstrap if missing.
# TRIXIE_ROOT: where (build/trixie). DEBIAN_MIRROR: from where. Needs root. Its mounts live in a namespace of their own.
set -euo pipefail
cd "$(dirname "$0")/.."

root=$(realpath -m "${TRIXIE_ROOT:-build/trixie}")
mirror=${DEBIAN_MIRROR:-http://deb.debian.org/debian}
[ $# -gt 0 ] || set -- make test

fail() {
    printf 'trixie: %s\n' "$@" >&2
    exit 1
}

make_root() {
    command -v debootstrap >/dev/null || fail "debootstrap is missing: apt-get install debootstrap"
    echo "trixie: debootstrap into $root"
    debootstrap --variant=minbase --include=make trixie "$root" "$mirror" >"$root.log" ||
        fail "debootstrap failed, see $root.log and $root/debootstrap/debootstrap.log"
    touch "$root/.complete"
}

# What the network needs here: name servers, and certificates or pip settings of a local mirror or proxy.
copy_network_settings() {
    local file
    for file in /etc/resolv.conf /etc/hosts /etc/pip.conf; do
        [ ! -e "$file" ] || cp --dereference --remove-destination "$file" "$root$file"
    done
    # Not in /etc/ssl/certs: the chroot's own ca-certificates package writes there.
    file=/etc/ssl/certs/ca-certificates.crt
    [ ! -e "$file" ] || cp --dereference "$file" "$root/etc/host-certificates.crt"
}

# Tracked and new files, not the host's .venv; the copy keeps its own.
copy_checkout() {
    mkdir -p "$root/src"
    find "$root/src" -mindepth 1 -maxdepth 1 ! -name .venv -exec rm -rf {} +
    git -c safe.directory="$PWD" ls-files -z --cached --others --exclude-standard |
        tar --create --null --files-from=- --ignore-failed-read --warning=no-failed-read |
        tar --extract --no-same-owner --directory "$root/src"
}

[ "$(id -u)" -eq 0 ] || fail "a chroot needs root: sudo make test-trixie"
mkdir -p "$root"
exec 9>"$root.lock"
flock --nonblock 9 || { echo "trixie: waiting for another run in $root" && flock 9; }
[ -e "$root/.complete" ] || make_root
copy_network_settings
copy_checkout

environment=(HOME=/root LANG=C.UTF-8 PATH=/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin)
[ ! -e "$root/etc/host-certificates.crt" ] || environment+=(PIP_CERT=/etc/host-certificates.crt)
for name in http_proxy https_proxy no_proxy PIP_INDEX_URL; do
    [ -z "${!name:-}" ] || environment+=("$name=${!name}")
done

# shellcheck disable=SC2016 # expanded inside the namespace
unshare --mount --pid --fork --kill-child bash -euc '
    root=$1
    shift
    mount -t proc proc "$root/proc"
    mount -t sysfs -o ro sysfs "$root/sys"
    mount -t devpts devpts "$root/dev/pts"
    mount -t tmpfs tmpfs "$root/dev/shm"
    exec chroot "$root" "$@"
' trixie "$root" env --ignore-environment --chdir=/src "${environment[@]}" "$@" </dev/null
