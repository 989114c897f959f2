"""Compare our models with those of Gymnasium, both in MuJoCo.

    python bodies/tests/references/compare_models_to_gymnasium.py

For each file of `bodies/models` that has a counterpart: settings, the names that are an interface, control
ranges, and, in 200 random states with limits and contacts, accelerations and places of bodies and sites. The
table has the largest difference, relative to the largest number of the state, and the share of states with
contacts and with violated limits. The exit code is 1 if a difference exceeds 1e-10, or a setting or name
differs. Needs mujoco 4.0 and gymnasium.
"""

import importlib.util
import pathlib
import sys

import mujoco
import numpy as np

TOLERANCE = 1e-10
STATES = 200
MODELS = pathlib.Path(__file__).resolve().parents[2] / "models"
# Our file and that of the environment of version 5.
PAIRS = {
    "hopper": "hopper",
    "half_cheetah": "half_cheetah",
    "walker2d": "walker2d_v5",
    "ant": "ant",
    "swimmer": "swimmer",
    "reacher": "reacher",
    "inverted_double_pendulum": "inverted_double_pendulum",
    "humanoid": "humanoid",
}
SETTINGS = ["timestep", "integrator", "cone", "impratio", "density", "viscosity", "gravity", "wind"]
NAMED = [
    mujoco.mjtObj.mjOBJ_BODY,
    mujoco.mjtObj.mjOBJ_JOINT,
    mujoco.mjtObj.mjOBJ_ACTUATOR,
    mujoco.mjtObj.mjOBJ_SITE,
]
COUNTS = ["nbody", "njnt", "nq", "nv", "nu", "nsite"]


def load(path):
    model = mujoco.MjModel.from_xml_path(str(path))
    # The solution of the constraints does not depend on the solver once that has converged.
    model.opt.solver = mujoco.mjtSolver.mjSOL_NEWTON
    model.opt.tolerance, model.opt.ls_tolerance = 0, 1e-14
    model.opt.iterations, model.opt.ls_iterations = 200, 100
    return model


def disagreements(ours, theirs):
    """Sentences on settings and names that differ. An element without a name in theirs may have one."""
    found = []
    for what in COUNTS:
        if getattr(ours, what) != getattr(theirs, what):
            return [f"{what}: {getattr(ours, what)} and {getattr(theirs, what)}"]
    for what in SETTINGS:
        if np.any(getattr(ours.opt, what) != getattr(theirs.opt, what)):
            found.append(f"{what}: {getattr(ours.opt, what)} and {getattr(theirs.opt, what)}")
    for kind, count in zip(NAMED, [ours.nbody, ours.njnt, ours.nu, ours.nsite]):
        for i in range(count):
            own, other = (mujoco.mj_id2name(model, kind, i) for model in (ours, theirs))
            if other and own != other:
                found.append(f"{kind.name} {i}: {own} and {other}")
    for what in ["qpos0", "actuator_ctrlrange", "actuator_trnid"]:
        if np.any(getattr(ours, what) != getattr(theirs, what)):
            found.append(f"{what} differs")
    return found


def state(model, rng):
    """Positions in and around the ranges of joints and often near the floor; velocities and controls."""
    q = model.qpos0.copy()
    for joint in range(model.njnt):
        first, kind = model.jnt_qposadr[joint], model.jnt_type[joint]
        if kind == mujoco.mjtJoint.mjJNT_FREE:
            q[first : first + 3] += rng.uniform([-1, -1, -0.7], [1, 1, 0.1])
            turn = rng.normal(size=4)
            q[first + 3 : first + 7] = turn / np.linalg.norm(turn)
        elif model.jnt_limited[joint]:
            low, high = model.jnt_range[joint]
            q[first] = rng.uniform(low - 0.1 * (high - low), high + 0.1 * (high - low))
        else:
            q[first] += rng.normal() * 0.7
    return q, rng.normal(size=model.nv) * 2, rng.uniform(-1.5, 1.5, model.nu)


def motion(model, data, q, v, u):
    """Accelerations, and places: positions and rotations of bodies, and positions of sites."""
    mujoco.mj_resetData(model, data)
    data.qpos[:], data.qvel[:], data.ctrl[:] = q, v, u
    mujoco.mj_forward(model, data)
    return data.qacc.copy(), np.concatenate([x.ravel() for x in (data.xpos, data.xmat, data.site_xpos)])


def compare(ours, theirs):
    """Largest relative differences of accelerations and places; shares of states with constraints."""
    rng = np.random.default_rng(1)
    data = [mujoco.MjData(model) for model in (ours, theirs)]
    worst, contacts, limits = [0.0, 0.0], 0, 0
    for _ in range(STATES):
        sample = state(theirs, rng)
        own, other = (motion(model, d, *sample) for model, d in zip((ours, theirs), data))
        for i in range(2):
            worst[i] = max(worst[i], np.abs(own[i] - other[i]).max() / np.abs(other[i]).max())
        types = data[1].efc_type
        contacts += data[1].ncon > 0
        limits += bool((types == mujoco.mjtConstraint.mjCNSTR_LIMIT_JOINT).any())
    return worst, contacts / STATES, limits / STATES


def main():
    root = pathlib.Path(importlib.util.find_spec("gymnasium").origin).parent / "envs/mujoco/assets"
    print(f"{'model':26} {'accelerations':>14} {'places':>9} {'contacts':>9} {'limits':>7}")
    good = True
    for own, other in PAIRS.items():
        ours, theirs = load(MODELS / f"{own}.xml"), load(root / f"{other}.xml")
        found = disagreements(ours, theirs)
        if not found:
            worst, contacts, limits = compare(ours, theirs)
            print(f"{own:26} {worst[0]:14.1e} {worst[1]:9.1e} {contacts:9.0%} {limits:7.0%}")
            if not max(worst) <= TOLERANCE:
                found = [f"a difference is larger than {TOLERANCE:.0e}"]
        for sentence in found:
            print(f"{own:26} {sentence}")
        good &= not found
    sys.exit(not good)


if __name__ == "__main__":
    main()
