#!/usr/bin/env bash
# Builds the wheel, installs it in a new virtual environment and runs the tests. Skips with a
# message if Python 3.10 or newer, its module venv or a package index is missing.
# PHYSGRAD_MODULE, the path of a compiled module, is installed in place of a wheel.
# PHYSGRAD_PYTHON_ALL=1 also installs PyTorch, Stable-Baselines3, pandas, checkers of types and others,
# and runs slow tests.
set -euo pipefail
cd "$(dirname "$0")"

skip() { echo "skipped the Python bindings: $1"; exit 0; }

python=${PYTHON:-python3}
"$python" -c 'import sys; sys.exit(sys.version_info < (3, 10))' 2>/dev/null || skip "there is no Python 3.10 or newer; set PYTHON"
"$python" -c 'import ensurepip, venv' 2>/dev/null || skip "$python has no module venv"

target=$(cargo metadata --format-version 1 --no-deps | "$python" -c 'import json, sys; print(json.load(sys.stdin)["target_directory"])')
venv=$target/python-venv
rm -rf "$venv"
"$python" -m venv "$venv"
pip() { "$venv/bin/python" -m pip --quiet --disable-pip-version-check --retries 1 "$@"; }
pip install numpy pytest pytest-xdist || skip "pip cannot install packages"
# Tests of missing packages skip with a reason.
pip install gymnasium pygame jax casadi || echo "gymnasium, pygame, jax or casadi is missing: their tests are skipped"
if [ "${PHYSGRAD_PYTHON_ALL:-0}" = 1 ]; then
    pip install torch stable-baselines3 moviepy pandas matplotlib lmfit mujoco
    pip install mypy pyright ipython tqdm joblib 'dask[distributed]' ray nbclient ipykernel
    # controlgym asks for old releases of NumPy and Gymnasium, and runs with the present ones.
    pip install do-mpc scipy
    pip install --no-deps controlgym
    # Wheels have no examples. Those of CasADi are in its source archive, those of do-mpc in its repository.
    casadi=$target/casadi do_mpc=$target/do-mpc
    rm -rf "$casadi" "$do_mpc"
    version=$("$venv/bin/python" -c 'import casadi; print(casadi.__version__)')
    pip download --no-deps --no-binary casadi --dest "$casadi" "casadi==$version"
    tar -xzf "$casadi/casadi-$version.tar.gz" -C "$casadi" --strip-components 1
    export PHYSGRAD_CASADI_EXAMPLES=$casadi/docs/examples/python
    if git clone --quiet --depth 1 https://github.com/do-mpc/do-mpc "$do_mpc"; then
        export PHYSGRAD_DO_MPC_EXAMPLES=$do_mpc/examples
    else
        echo "GitHub cannot be reached: the tests of do-mpc's examples are skipped"
    fi
fi

if [ -n "${PHYSGRAD_MODULE:-}" ]; then
    packages=$("$venv/bin/python" -c 'import sysconfig; print(sysconfig.get_path("purelib"))')
    cp -r physgrad "$packages/physgrad"
    cp "$PHYSGRAD_MODULE" "$packages/physgrad/_core.abi3.so"
else
    pip install 'maturin>=1.9,<2' || skip "pip cannot install maturin"
    wheels=$target/wheels
    rm -rf "$wheels"
    PYO3_PYTHON=$venv/bin/python "$venv/bin/maturin" build --release --interpreter "$venv/bin/python" --out "$wheels"
    pip install --force-reinstall --no-deps "$wheels"/physgrad-*.whl
fi
# Tests of the program run the release binary, if it exists.
if [ -x "$target/release/physgrad" ]; then
    export PHYSGRAD=$target/release/physgrad
fi
# Runs in the folder of the tests, so that Python and its child processes import the installed
# package, not the folder `physgrad`, which has no compiled module. The tests share `networks.py`.
cd tests
tests() { PYTHONPATH=$PWD "$venv/bin/pytest" -q --import-mode=importlib --rootdir . -c ../pyproject.toml "$@"; }
# Tests of times run alone.
tests test_interrupt.py
tests --numprocesses auto --dist worksteal --ignore test_interrupt.py .
