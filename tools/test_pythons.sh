#!/usr/bin/env bash
# Runs the unit, property and integration tests on each Python from 3.11 on: of the system, of pyenv, of uv.
# One virtual environment and one log each, in build/pythons; ends with a table, and with 1 if one of them failed.
# With versions ("3.12 3.13.0"): only these. A version that is not found has failed.
set -uo pipefail
cd "$(dirname "$0")/.."

LIMIT_S=${LIMIT_S:-3600} # for the tests of one Python: one that does not end must not hide the others
TESTS=(tests/unit tests/property tests/integration)
FOLDER=build/pythons

interpreters() {
  compgen -c python3. | grep -xE 'python3\.[0-9]+' | sort -u | xargs -r -n1 which -a 2>/dev/null | grep -v '/shims/'
  ls -d "${PYENV_ROOT:-$HOME/.pyenv}"/versions/*/bin/python3 "$HOME"/.local/share/uv/python/*/bin/python3 2>/dev/null
}

# Prints "3.12.1"; nothing for a Python that is too old or does not start.
version() {
  "$1" -c 'import sys; sys.version_info < (3, 11) or print("%d.%d.%d" % sys.version_info[:3])' 2>/dev/null
}

# Whether it is one of the versions: "3.12.1" is "3.12", too.
is_wanted() {
  local version=$1 wanted
  shift
  (($# == 0)) && return
  for wanted in "$@"; do [[ $version. == "$wanted".* ]] && return; done
  return 1
}

# Runs pytest and keeps its log; sets `result` to what pytest says last, such as "2 failed, 1762 passed in 56.35s".
run_tests() {
  local log=$1 status=0
  shift
  timeout --foreground --kill-after=10 "$LIMIT_S" "$@" "${TESTS[@]}" </dev/null 2>&1 | tee "$log" || status=$?
  result=$(tail -n1 "$log" | grep -aoE '[0-9]+ (failed|passed|error|skipped|warning).* in [0-9.]+s')
  [[ -n $result ]] || result="ended with $status, $log"
  ((status == 124)) && result="not done in $LIMIT_S s, $log"
  return $status
}

# Sets `result` to what became of the tests with this Python.
test_with() {
  local python=$1 venv=$2 plain
  if [[ ! -x $venv/bin/pip ]] && ! "$python" -m venv --clear "$venv" >/dev/null 2>&1; then
    rm -rf "$venv"
    result="no venv module"
    return 1
  fi
  if ! "$venv/bin/python" -m pip install --quiet --disable-pip-version-check -e '.[dev]' >"$venv.log" 2>&1; then
    result="not installed: $(tail -n1 "$venv.log") ($venv.log)"
    return 1
  fi
  local failed=0
  run_tests "$venv.log" "$venv/bin/python" -m pytest -q --workers "$(nproc)" -m "not quiet" || failed=1
  plain=$result
  run_tests "$venv.quiet.log" "$venv/bin/python" -m pytest -q -m quiet || failed=1
  result="$plain; quiet: $result"
  return $failed
}

mapfile -t found < <(interpreters)
mkdir -p "$FOLDER"
declare -A verdicts=()
table=()
for python in "${found[@]}"; do
  version=$(version "$python")
  [[ -z $version || ${verdicts[$version]:-} == @(passed|FAILED) ]] && continue
  is_wanted "$version" "$@" || continue
  printf '\nPython %s: %s\n' "$version" "$python"
  verdict=passed
  test_with "$python" "$FOLDER/$version" || verdict=FAILED
  [[ $result == "no venv module" ]] && verdict="not run" # another Python of this version may have one
  verdicts[$version]=$verdict
  table+=("$(printf '%-8s %-7s  %s' "$version" "$verdict" "$result")")
  [[ $verdict == FAILED ]] &&
    mapfile -t -O "${#table[@]}" table < <(sed -nE 's/^(FAILED|ERROR) tests/                   &/p' "$FOLDER/$version".{,quiet.}log)
done
for wanted in "$@"; do
  printf '%s\n' "${!verdicts[@]}" | grep -qE "^${wanted//./\\.}(\.|$)" || {
    verdicts[$wanted]=FAILED
    table+=("$(printf '%-8s %-7s  %s' "$wanted" FAILED "not found")")
  }
done

printf '\n'
printf '%s\n' "${table[@]:-no Python from 3.11 on was found}"
[[ " ${verdicts[*]} " == *" passed "* && " ${verdicts[*]} " != *" FAILED "* ]]
