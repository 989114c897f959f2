#!/usr/bin/env bash
# Builds a wheel that needs no Rust toolchain to install, and a source distribution, in `dist`, or in
# the folder of the first argument. On Linux, the wheel is linked against an old C library by Zig, so
# that it runs on distributions since 2018 (manylinux_2_28). One wheel serves Python 3.10 and newer.
# Needs a Rust toolchain, Python 3.10 or newer, and access to a package index.
set -euo pipefail
mkdir -p "${1:-dist}"
out=$(cd "${1:-dist}" && pwd)
cd "$(dirname "$0")"

python=${PYTHON:-python3}
target=$(cargo metadata --format-version 1 --no-deps | "$python" -c 'import json, sys; print(json.load(sys.stdin)["target_directory"])')
venv=$target/python-wheels
[ -f "$venv/pyvenv.cfg" ] || "$python" -m venv "$venv"
# Windows has another folder.
bin=$venv/bin
[ -d "$bin" ] || bin=$venv/Scripts
"$bin/python" -m pip --quiet --disable-pip-version-check install 'maturin[zig]>=1.9,<2' auditwheel

# Maturin finds Zig, a package of Python, by this path.
export PATH=$bin:$PATH PYO3_PYTHON=$bin/python
options=""
if [ "$(uname -s)" = Linux ]; then options="--zig --compatibility manylinux_2_28"; fi
maturin build --release $options --out "$out"
maturin sdist --out "$out"
if [ "$(uname -s)" = Linux ]; then
    auditwheel show "$out"/physgrad-*.whl | tee "$out/auditwheel.txt"
    # The wheel keeps its promise, or the script fails.
    grep -q manylinux_2_28 "$out/auditwheel.txt"
    rm "$out/auditwheel.txt"
fi
