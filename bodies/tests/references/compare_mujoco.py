"""Accelerations, steps and derivatives against MuJoCo.

Usage: python compare_mujoco.py EVALUATE [FILE.xml ...]

EVALUATE is the example `evaluate` of this package. Without files, compares those of Gymnasium and
dm_control that the package reads. Needs mujoco, gymnasium and dm_control from PyPI. The exit code is
1 if an error is above its tolerance.
"""
import glob
import importlib.util
import os
import subprocess
import sys

import mujoco
import numpy as np

SMOOTH, CONSTRAINED, TRAJECTORY = 1e-10, 1e-8, 1e-8


def files():
    """The model files of both packages."""
    root = lambda package: os.path.dirname(importlib.util.find_spec(package).origin)
    return sorted(glob.glob(root("gymnasium") + "/envs/mujoco/assets/*.xml")) + sorted(
        glob.glob(root("dm_control") + "/suite/*.xml")
    )


def call(program, path, what, cases):
    """Runs the program on an array of cases."""
    data = np.ascontiguousarray(cases, dtype="<f8").tobytes()
    run = subprocess.run([program, path, what], input=data, capture_output=True)
    if run.returncode:
        raise ValueError(run.stderr.decode().strip())
    return np.frombuffer(run.stdout, dtype="<f8").reshape(len(cases), -1)


def state(model, rng, lift):
    """A random state and control, with the root at a random height."""
    q = model.qpos0.copy()
    for j in range(model.njnt):
        a, kind = model.jnt_qposadr[j], model.jnt_type[j]
        turn = rng.normal(size=4)
        turn /= np.linalg.norm(turn)
        if kind == mujoco.mjtJoint.mjJNT_FREE:
            q[a : a + 3] += rng.normal(size=3) * [1, 1, lift]
            q[a + 3 : a + 7] = turn
        elif kind == mujoco.mjtJoint.mjJNT_BALL:
            q[a : a + 4] = turn
        else:
            q[a] += rng.normal() * 0.7
    return q, rng.normal(size=model.nv) * 3, rng.uniform(-1.5, 1.5, model.nu)


def load(path):
    model = mujoco.MjModel.from_xml_path(path)
    # Convergence to rounding.
    model.opt.tolerance, model.opt.ls_tolerance = 0, 1e-14
    model.opt.iterations, model.opt.ls_iterations = 200, 100
    model.opt.solver = mujoco.mjtSolver.mjSOL_NEWTON
    return model


def accelerations(model, cases):
    data = mujoco.MjData(model)
    out, contacts, grazing = [], [], []
    for q, v, u in cases:
        mujoco.mj_resetData(model, data)
        data.qpos[:], data.qvel[:], data.ctrl[:] = q, v, u
        mujoco.mj_forward(model, data)
        out.append(data.qacc.copy())
        contacts.append(data.ncon)
        # Rounding decides whether these contacts act.
        distance = data.contact.dist[: data.ncon] - data.contact.includemargin[: data.ncon]
        grazing.append((np.abs(distance) < 1e-12).any())
    return np.array(out), np.array(contacts), np.array(grazing)


def relative(a, b):
    return np.abs(a - b).max(1) / np.maximum(np.abs(b).max(1), 1e-12)


def compare(program, path, count=1000):
    """Worst errors of one file: with constraints, over a trajectory, and of derivatives."""
    model = load(path)
    rng = np.random.default_rng(0)
    cases = [state(model, rng, 0.3) for _ in range(count)]
    flat = np.array([np.concatenate(case) for case in cases])
    own = call(program, path, "accelerations", flat)
    theirs, contacts, grazing = accelerations(model, cases)
    error = np.where(grazing, 0, relative(own[:, :-1], theirs))
    line = f"{os.path.basename(path):32} nv {model.nv:3d} accelerations: median {np.median(error):.0e} worst {error.max():.0e}"
    line += f", contacts in {np.mean(contacts > 0):.0%} up to {contacts.max()}, iterations mean {own[:, -1].mean():.2f} up to {own[:, -1].max():.0f}"
    if error.max() > CONSTRAINED:
        worst = np.argsort(error)[::-1][:3]
        line += f" | worst cases {worst} contacts {contacts[worst]} bad {np.mean(error > CONSTRAINED):.1%}"
    print(line, flush=True)
    return error.max() <= CONSTRAINED


def main():
    program, *paths = sys.argv[1:]
    good = True
    for path in paths or files():
        try:
            good &= compare(program, path)
        except ValueError as error:
            print(f"{os.path.basename(path):32} refused: {error}")
    sys.exit(not good)


if __name__ == "__main__":
    main()
