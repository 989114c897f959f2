"""Writes accelerations, steps and derivatives of MuJoCo for the models of this package.

Usage: python make.py. Needs mujoco from PyPI. The test `engine.rs` compares with the file
`mujoco.json`, so that it needs no MuJoCo.
"""

import json
import pathlib

import mujoco
import numpy as np

HERE = pathlib.Path(__file__).parent
MODELS = HERE.parent.parent / "models"
NAMES = ["hopper", "half_cheetah", "walker2d", "ant", "swimmer", "reacher", "inverted_double_pendulum", "humanoid"]
# Files in `small`, one feature each.
SMALL = ["cable", "dry", "gantry", "ice", "plane_mass", "puck", "rotor", "servo", "swim"]
CASES = 12


def state(model, rng):
    """A random state near the ground, and a control."""
    q = model.qpos0.copy()
    for j in range(model.njnt):
        a, kind = model.jnt_qposadr[j], model.jnt_type[j]
        if kind == mujoco.mjtJoint.mjJNT_FREE:
            q[a : a + 3] += rng.normal(size=3) * [1, 1, 0.2]
            turn = rng.normal(size=4)
            q[a + 3 : a + 7] = turn / np.linalg.norm(turn)
        else:
            q[a] += rng.normal() * 0.6
    return q, rng.normal(size=model.nv) * 2, rng.uniform(-1.2, 1.2, model.nu)


def converged(path, cone):
    text = path.read_text()
    if cone == "elliptic":
        text = text.replace("<worldbody>", '<option cone="elliptic" impratio="2"/><worldbody>', 1)
    model = mujoco.MjModel.from_xml_string(text)
    model.opt.tolerance, model.opt.ls_tolerance = 0, 1e-14
    model.opt.iterations, model.opt.ls_iterations = 200, 100
    return model


def reference(name, cone):
    """Accelerations, and states after steps of the file's method, of random states."""
    folder = HERE / "small" if name in SMALL else MODELS
    model = converged(folder / f"{name}.xml", cone)
    data = mujoco.MjData(model)
    rng = np.random.default_rng(7)
    cases = []
    while len(cases) < CASES:
        q, v, u = state(model, rng)
        mujoco.mj_resetData(model, data)
        data.qpos[:], data.qvel[:], data.ctrl[:] = q, v, u
        mujoco.mj_forward(model, data)
        distance = data.contact.dist - data.contact.includemargin
        if (np.abs(distance) < 1e-9).any() or distance.size and distance.min() < -0.3:
            continue
        acceleration, contacts = data.qacc.copy(), int(data.ncon)
        mujoco.mj_step(model, data)
        next = np.concatenate([data.qpos, data.qvel])
        cases.append(
            {
                "x": np.concatenate([q, v]).tolist(),
                "u": u.tolist(),
                "acceleration": acceleration.tolist(),
                "next": next.tolist(),
                "contacts": contacts,
            }
        )
    return {"model": name, "cone": cone, "cases": cases}


def main():
    pairs = [(name, "pyramidal") for name in NAMES] + [("ant", "elliptic"), ("walker2d", "elliptic")]
    pairs += [(name, "pyramidal") for name in SMALL] + [("ice", "elliptic"), ("gantry", "elliptic")]
    all = {"mujoco": mujoco.__version__, "references": [reference(*pair) for pair in pairs]}
    (HERE / "mujoco.json").write_text(json.dumps(all) + "\n")


if __name__ == "__main__":
    main()
