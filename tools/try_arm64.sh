#!/usr/bin/env bash
# Try the Debian package, the wheel and the compiled wheel for arm64 in an emulated Debian 12 (qemu-aarch64 in proot), as root: make arm64.
# An hour; it says nothing about speed. MIRROR may name a mirror of Debian; the logs are in build/arm64.
set -euo pipefail
cd "$(dirname "$0")/.."
mirror=${MIRROR:-http://deb.debian.org/debian}
work=$PWD/build/arm64
root=$work/root
certificates=/etc/ssl/certs/ca-certificates.crt
mkdir -p "$work"

# Copies, new ones each time, because a package that is installed in the emulated system writes to them through the bind.
emulated() {
  cp "$certificates" "$work/certificates.crt"
  cp /etc/resolv.conf "$work/resolv.conf"
  proot -0 -q qemu-aarch64-static -r "$root" -b /dev -b /proc -b /sys -b "$work/resolv.conf:/etc/resolv.conf" \
    -b "$work/certificates.crt:$certificates" -w / \
    /usr/bin/env -i HOME=/root PATH=/usr/sbin:/usr/bin:/sbin:/bin LC_ALL=C.UTF-8 DEBIAN_FRONTEND=noninteractive \
    PIP_CERT="$certificates" "$@"
}

step() {  # NAME COMMAND...: its log is NAME.log
  local name=$1
  shift
  echo "$name ..."
  "$@" >"$work/$name.log" 2>&1 || { tail -n 30 "$work/$name.log"; echo "$name failed: $work/$name.log" >&2; exit 1; }
}

if [ ! -f "$root/.complete" ]; then
  rm -rf "$root"
  packages=python3,python3-venv,python3-pip,ca-certificates,curl,procps
  step debootstrap debootstrap --foreign --arch=arm64 --variant=minbase --include="$packages" bookworm "$root" "$mirror"
  rm -rf "$root/proc" && mkdir "$root/proc"  # a link to /proc, which proot would follow
  step second-stage emulated DEBOOTSTRAP_DIR=/debootstrap /bin/sh /debootstrap/debootstrap --second-stage
  touch "$root/.complete"
fi

shopt -s nullglob
packages=(build/deb/hostlink_*+deb12_arm64.deb)
[ ${#packages[@]} -gt 0 ] || step build .venv/bin/python -m tools.build_deb --arch arm64
packages=(build/deb/hostlink_*+deb12_arm64.deb)
rm -rf "$root/srv/hostlink" "$root/srv/compiled" && mkdir -p "$root/srv/hostlink"
cp "${packages[-1]}" "$root/srv/hostlink/hostlink.deb"
.venv/bin/python -m hatchling build --target wheel --directory "$root/srv/hostlink" >/dev/null
cp -r tests tools pyproject.toml hostlink firmware docs "$root/srv/hostlink/"
rm -rf "$root/srv/hostlink/tests/clients/node_modules" "$root/srv/hostlink/hostlink/api/web/node_modules"
cp tools/try_drive.py "$root/srv/hostlink/"

# proot does not translate statx: what uses it, as ls and stat, looks at the files of this computer.
step deb-install emulated dpkg -i /srv/hostlink/hostlink.deb
stat -c '%A %n' "$root/etc/hostlink/hostlink.toml" "$root/lib/systemd/system/hostlink.service" "$root/lib/udev/rules.d/70-hostlink.rules"
step deb-drive emulated python3 /srv/hostlink/try_drive.py /usr/bin/hostlink
step deb-remove emulated dpkg --remove hostlink
step deb-purge emulated dpkg --purge hostlink
[ ! -e "$root/etc/hostlink" ] && [ ! -e "$root/usr/lib/hostlink" ]
tests="pytest pytest-asyncio pytest-timeout hypothesis"
pytest="HYPOTHESIS_PROFILE=ci /srv/venv/bin/python -m pytest -q -p no:cacheprovider --timeout 1200"
packages="tests/unit/core/protocol tests/unit/core/messages tests/unit/core/robot tests/unit/core/hub"
step wheel-install emulated sh -c "rm -rf /srv/venv && python3 -m venv /srv/venv && cd /srv/hostlink &&
  /srv/venv/bin/pip install --no-compile \"\$(echo /srv/hostlink/*.whl)[sim,export]\" $tests"
step wheel-drive emulated python3 /srv/hostlink/try_drive.py /srv/venv/bin/hostlink
step unit-tests emulated sh -c "cd /srv/hostlink && $pytest $packages"

# The compiled wheel replaces the pure one; the tests import its modules, which are laid over the sources.
step compiled-build .venv/bin/python -m tools.compiled --arch arm64 --python 3.11 --into "$root/srv/compiled"
step compiled-install emulated sh -c '/srv/venv/bin/pip install --no-compile --no-deps --force-reinstall /srv/compiled/*.whl'
step compiled-modules emulated /srv/venv/bin/python -I /srv/hostlink/tools/try_compiled.py
step compiled-drive emulated python3 /srv/hostlink/try_drive.py /srv/venv/bin/hostlink
.venv/bin/python -m zipfile -e "$root"/srv/compiled/*.whl "$root/srv/hostlink"
step compiled-overlay emulated sh -c 'cd /srv/hostlink && PYTHONPATH=. /srv/venv/bin/python tools/try_compiled.py'
step compiled-tests emulated sh -c "cd /srv/hostlink && $pytest $packages"
tail -n 1 "$work"/{deb-drive,wheel-drive,unit-tests,compiled-modules,compiled-overlay,compiled-drive,compiled-tests}.log
