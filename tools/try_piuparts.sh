#!/usr/bin/env bash
# Install, upgrade, remove and purge the Debian package of this computer's architecture in an empty Debian 12 and 13 with piuparts,
# as root: make piuparts. MIRROR may name a mirror of Debian, DEBIAN one version.
set -euo pipefail
cd "$(dirname "$0")/.."
mirror=${MIRROR:-http://deb.debian.org/debian}
arch=$(dpkg --print-architecture)
shopt -s nullglob
declare -A suites=([12]=bookworm [13]=trixie)
for debian in ${DEBIAN:-12 13}; do
  suite=${suites[$debian]}
  packages=(build/deb/hostlink_*+deb"${debian}_$arch".deb)
  [ ${#packages[@]} -gt 0 ] || { .venv/bin/python -m tools.build_deb --arch "$arch" --debian "$debian"; packages=(build/deb/hostlink_*+deb"${debian}_$arch".deb); }
  deb=${packages[-1]}
  work=build/piuparts/$suite
  mkdir -p "$work"
  # The same package with a lower version: the upgrade starts from it.
  rm -rf "$work/earlier" "$work/archive" && mkdir "$work/archive" && dpkg-deb -R "$deb" "$work/earlier"
  sed -i 's/^Version: /Version: 0~/' "$work/earlier/DEBIAN/control"
  dpkg-deb --root-owner-group -Zgzip -z1 --build "$work/earlier" "$work/archive/earlier.deb" >/dev/null
  if [ ! -f "$work/base.tar.gz" ]; then
    debootstrap --variant=minbase --include=ca-certificates "$suite" "$work/root" "$mirror" >"$work/debootstrap.log"
    tar -C "$work/root" -czf "$work/base.tar.gz" . && rm -rf "$work/root"
  fi
  # piuparts upgrades from the version that an archive has: this folder is one.
  (cd "$work/archive" && dpkg-scanpackages --multiversion . /dev/null >Packages 2>/dev/null)
  log=$work/piuparts.log
  rm -f "$log"  # piuparts appends
  # debconf makes tmp.ci for every package that apt installs; piuparts of Debian 12 does not know that of Debian 13.
  piuparts --ignore /var/cache/debconf/tmp.ci/ --basetgz "$work/base.tar.gz" --distribution "$suite" --mirror "$mirror main" --no-eatmydata \
    --extra-repo "deb [trusted=yes] file://$PWD/$work/archive ./" --bindmount "$PWD/$work/archive" --log-file "$log" "$deb" >/dev/null || { tail -n 40 "$log"; exit 1; }
  echo "Debian $debian:"
  grep -E "PASS|FAIL|WARN" "$log"
done
