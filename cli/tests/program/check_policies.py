"""Compares policies of runs, as policy files and as ONNX models, with controls of their rollouts.

Run: python check_policies.py RUN ...

Each run has `policy.safetensors`, `policy.onnx` and `trajectory.csv`. NumPy and ONNX Runtime
compute the controls from the observations in the same precision as the run. TOLERANCE bounds the
largest difference relative to the largest control, in machine epsilons. Sums in a network have up
to about 140 terms. The order of summation differs between programs.
"""

import csv
import json
import pathlib
import sys

import numpy as np
import onnxruntime
import safetensors

from read_policy import controls

TOLERANCE = 32

for run in map(pathlib.Path, sys.argv[1:]):
    with safetensors.safe_open(run / "policy.safetensors", "numpy") as file:
        about = json.loads(file.metadata()["physgrad"])
        dtype = file.get_tensor(about["layers"][0]["kernel"]).dtype
    rows = [row for row in csv.DictReader(open(run / "trajectory.csv")) if row[about["controls"][0]]]
    column = lambda names: np.array([[row[name] for name in names] for row in rows], dtype=float).astype(dtype)
    x, u = column(about["observations"]), column(about["controls"])
    session = onnxruntime.InferenceSession(str(run / "policy.onnx"), providers=["CPUExecutionProvider"])
    evaluate = lambda x: session.run(["control"], {"observation": x})[0]
    assert json.loads(session.get_modelmeta().custom_metadata_map["physgrad"]) == about
    assert np.abs(u).max() > 1e-3 and np.ptp(u) > 1e-3, f"{run.name}: the controls vary too little"
    found = {"safetensors": controls(run / "policy.safetensors", x), "onnx": evaluate(x), "one row": evaluate(x[:1])}
    for name, v in found.items():
        assert v.dtype == dtype, f"{run.name}: {name} has {v.dtype}, the policy {dtype}"
        error = np.abs(v - u[: len(v)]).max() / np.abs(u).max() / np.finfo(dtype).eps
        print(f"{run.name}: {name}: {len(v)} controls, {error:.1f} machine epsilons")
        assert error <= TOLERANCE, f"{run.name}: {name} differs by {error:.1f} machine epsilons"
