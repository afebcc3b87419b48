#!/usr/bin/env bash
# Runs the unit, property and integration tests on each Python from 3.11 on: of the system, of pyenv, of uv.
# One virtual environment each, in build/pythons; an interpreter on which something cannot be installed is named.
set -uo pipefail
cd "$(dirname "$0")/.."

interpreters() {
  compgen -c python3. | grep -xE 'python3\.[0-9]+' | sort -u | xargs -r -n1 which -a 2>/dev/null | grep -v '/shims/'
  ls -d "${PYENV_ROOT:-$HOME/.pyenv}"/versions/*/bin/python3 "$HOME"/.local/share/uv/python/*/bin/python3 2>/dev/null
}

declare -A known=()
failed=()
while read -r python; do
  version=$("$python" -c 'import sys; print(*sys.version_info[:2], sep=".") if sys.version_info >= (3, 11) else 0' 2>/dev/null)
  [[ ${version:-0} == 0 || -n ${known[$version]:-} ]] && continue
  venv=build/pythons/$version
  if ! "$python" -m venv "$venv" >/dev/null; then
    echo "$python has no venv module"
    continue
  fi
  known[$version]=$python
  echo "Python $version: $python"
  if ! "$venv/bin/python" -m pip install --quiet --disable-pip-version-check -e '.[dev]'; then
    failed+=("$version (not installed)")
    continue
  fi
  "$venv/bin/python" -m pytest -q -n "$(nproc)" tests/unit tests/property tests/integration -m 'not quiet' || failed+=("$version")
done < <(interpreters)

echo "ran on: ${!known[*]}"
[[ ${#failed[@]} == 0 ]] || { echo "failed on: ${failed[*]}"; exit 1; }
