#!/usr/bin/env bash
# Run tests on the modules of the compiled wheel: make test-compiled (TESTS="tests/unit/core/hub" chooses).
# They run in build/mypyc/tree, a copy of the sources with the wheel's extension modules next to them. Its virtual
# environment finds hostlink there, and everything else where this checkout's .venv has it.
set -euo pipefail
cd "$(dirname "$0")/.."
root=$PWD
tree=$root/build/mypyc/tree
version=$(.venv/bin/python -c 'import sys; print("%d.%d" % sys.version_info[:2])')
packages=lib/python$version/site-packages
rm -rf "$tree" "$root/build/mypyc/wheel" && mkdir -p "$tree"
.venv/bin/python -m tools.compiled --into build/mypyc/wheel --python "$version" --arch "$(dpkg --print-architecture)"
git ls-files -z --cached --others --exclude-standard | tar --null --files-from=- --create | tar --extract --directory "$tree"
.venv/bin/python -m zipfile -e build/mypyc/wheel/*.whl build/mypyc/wheel
(cd build/mypyc/wheel && cp --parents -- *.so $(find hostlink -name '*.so') "$tree")
ln -s "$root/build" "$tree/build" # the firmware that was compiled before
ln -s "$root/tests/clients/node_modules" "$tree/tests/clients/node_modules"
cd "$tree"
"$root/.venv/bin/python" -m venv .venv
.venv/bin/python -m pip install --quiet --disable-pip-version-check --no-deps -e .
echo "$root/.venv/$packages" >".venv/$packages/zz_tests.pth" # after hostlink's own
cp --recursive --no-clobber --symbolic-link "$root"/.venv/bin/* .venv/bin/ # ruff and other programs that tests run
.venv/bin/python tools/try_compiled.py
run() { .venv/bin/python -m pytest -q -p no:cacheprovider "$@"; }
status=0
run --workers "$(nproc)" -m "not quiet and not alone and not long" "$@" || status=$?
run -m "(quiet or alone) and not long" "$@" || [ $? -eq 5 ] || status=1 # 5: none of these tests is so marked
exit "$status"
