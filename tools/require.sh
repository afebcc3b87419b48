#!/usr/bin/env bash
# Make sure that the named Debian packages are installed: install them when this user may, else say the command.
set -euo pipefail
missing=()
for package in "$@"; do
  dpkg-query -W -f '${Status}' "$package" 2>/dev/null | grep -q 'install ok installed' || missing+=("$package")
done
[ ${#missing[@]} -eq 0 ] && exit 0
if [ "$(id -u)" -eq 0 ] && command -v apt-get >/dev/null; then
  apt-get -o DPkg::Lock::Timeout=300 -qq update
  size=$(LC_ALL=C apt-get install --no-install-recommends --assume-no "${missing[@]}" 2>/dev/null | grep -o '[0-9.,]* [kMG]B of additional disk space' || true)
  echo "installing ${missing[*]}${size:+: $size} ..."
  DEBIAN_FRONTEND=noninteractive apt-get -o DPkg::Lock::Timeout=300 -qq install --no-install-recommends -y "${missing[@]}" >/dev/null
else
  echo "needed and not installed: ${missing[*]}. Run:  sudo apt-get install ${missing[*]}" >&2
  exit 1
fi
