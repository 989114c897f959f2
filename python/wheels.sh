#!/usr/bin/env bash
# Builds a wheel that needs no Rust toolchain to install, and a source distribution, in `dist`, or in
# the folder of the first argument. On Linux, the wheel is linked against an old C library by Zig, so
# that it runs on distributions since 2018 (manylinux_2_28). One wheel serves Python 3.10 and newer.
# Needs a Rust toolchain, Python 3.10 or newer, and access to a package index.
set -euo pipefail
out=$(realpath -m "${1:-dist}")
cd "$(dirname "$0")"

python=${PYTHON:-python3}
target=$(cargo metadata --format-version 1 --no-deps | "$python" -c 'import json, sys; print(json.load(sys.stdin)["target_directory"])')
venv=$target/python-wheels
[ -x "$venv/bin/python" ] || "$python" -m venv "$venv"
"$venv/bin/python" -m pip --quiet --disable-pip-version-check install 'maturin[zig]>=1.9,<2' auditwheel

# Maturin finds Zig, a package of Python, by this path.
export PATH=$venv/bin:$PATH PYO3_PYTHON=$venv/bin/python
options=""
if [ "$(uname -s)" = Linux ]; then options="--zig --compatibility manylinux_2_28"; fi
maturin build --release $options --out "$out"
maturin sdist --out "$out"
if [ "$(uname -s)" = Linux ]; then auditwheel show "$out"/physgrad-*.whl; fi
