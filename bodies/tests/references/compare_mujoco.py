"""Accelerations, steps and derivatives against MuJoCo.

Usage: python compare_mujoco.py EVALUATE [FILE.xml ...]

EVALUATE is the example `evaluate` of this package. Without files, compares those of Gymnasium and
dm_control that the package reads, and variants of some with other cones, actuators and softness. Needs
mujoco, gymnasium and dm_control from PyPI. The exit code is 1 if an error is above its tolerance.

Columns of a row, largest errors over all states:

smooth        accelerations without constraints, relative
constrained   accelerations, relative, and most iterations of the solver
one step      states of trajectories, each after one step from MuJoCo's state, relative to the change
100 steps     states after 100 steps. Contact may make a motion chaotic. `growth` is the largest factor by
              which MuJoCo's own error grows: the distance after 100 steps from a start that is moved by
              1e-13. An error may be 1e-8, or 1e-12 times the growth of its trajectory.
derivative    1 - cosine between products with the derivative of a step and those with the differences of
              `mjd_transitionFD`, for all, positions, velocities and controls. A state is left out if a
              change of 1e-5 of one entry changes its contacts or the active parts of its constraints, or
              moves a contact point or frame by more than 1e-3: differences are wrong across a kink.
"""
import copy
import functools
import glob
import importlib.util
import os
import subprocess
import sys
import tempfile

import mujoco
import numpy as np

SMOOTH, CONSTRAINED, STEP, TRAJECTORY, COSINE = 1e-10, 1e-8, 1e-8, 1e-8, 1e-6
INTEGRATORS = {
    "euler": mujoco.mjtIntegrator.mjINT_EULER,
    "rk4": mujoco.mjtIntegrator.mjINT_RK4,
    "implicitfast": mujoco.mjtIntegrator.mjINT_IMPLICITFAST,
}
ASSETS = os.path.dirname(importlib.util.find_spec("gymnasium").origin) + "/envs/mujoco/assets/"
SUITE = os.path.dirname(importlib.util.find_spec("dm_control").origin) + "/suite/"


def position_actuators(text):
    """Motors as position actuators with feedback of the velocity and a range of forces."""
    begin, end = text.index("<actuator>"), text.index("</actuator>")
    motors = text[begin:end].replace("<motor", '<position kp="0.3" kv="0.002" forcerange="-0.4 0.4"')
    return text[:begin] + motors + text[end:]


def replaced(*pairs):
    def change(text):
        for old, new in pairs:
            assert old in text, old
            text = text.replace(old, new)
        return text

    return change


ELLIPTIC = ("<option ", '<option cone="elliptic" ')
TENDONS = replaced(
    ("<actuator>", '<tendon><fixed name="back"><joint joint="bthigh" coef="1"/><joint joint="bshin" coef="-0.5"/>'
                   '</fixed><fixed name="both"><joint joint="bfoot" coef="0.6"/><joint joint="ffoot" coef="0.4"/>'
                   "</fixed></tendon><actuator>"),
    ('joint="bthigh" name="bthigh"/>', 'tendon="back" name="bthigh"/>'),
    ('joint="ffoot" name="ffoot"/>', 'tendon="both" name="ffoot"/>'),
)
JOINT_RANGES = replaced(
    ('<joint armature="1"', '<joint actuatorfrclimited="true" actuatorfrcrange="-30 30" armature="1"')
)
# Name, file of Gymnasium, and change of its text.
VARIANTS = [
    ("ant, elliptic", "ant", replaced(ELLIPTIC)),
    ("ant, elliptic, ratio 10", "ant", replaced(("<option ", '<option cone="elliptic" impratio="10" '))),
    ("walker2d, elliptic", "walker2d_v5", replaced(ELLIPTIC)),
    ("humanoid, elliptic", "humanoid", replaced(ELLIPTIC)),
    ("ant, no friction", "ant", replaced(('condim="3"', 'condim="1"'))),
    ("ant, dry joints", "ant", replaced(("<joint armature=", '<joint frictionloss="0.4" armature='))),
    ("ant, position", "ant", position_actuators),
    ("ant, position, joint ranges", "ant", lambda text: position_actuators(JOINT_RANGES(text))),
    ("half_cheetah, position", "half_cheetah", position_actuators),
    ("half_cheetah, tendons", "half_cheetah", TENDONS),
    ("half_cheetah, position, tendons", "half_cheetah", lambda text: position_actuators(TENDONS(text))),
    # The ball of the file grazes the floor in every state, so that rounding decides.
    ("point, floor 1 mm lower", "point", replaced(('name="floor" pos="0 0 0"', 'name="floor" pos="0 0 -0.001"'))),
    ("point, floor 1 mm higher", "point", replaced(('name="floor" pos="0 0 0"', 'name="floor" pos="0 0 0.001"'))),
    ("ant, boxes", "ant", replaced(('size="0.25" type="sphere"', 'size="0.2 0.25 0.3" type="box"'))),
    ("ant, touching itself", "ant", replaced(('conaffinity="0"', 'conaffinity="1"'))),
    ("ant, stiff", "ant", replaced(("<geom conaffinity", '<geom solref="-9000 -90" conaffinity'))),
    ("ant, soft", "ant", replaced(("<geom conaffinity", '<geom solimp="0.1 0.95 0.1 0.3 3" conaffinity'))),
    ("ant, gap", "ant", replaced(('margin="0.01" rgba', 'margin="0.02" gap="0.015" rgba'))),
    ("ant, medium", "ant", replaced(("<option ", '<option density="9" viscosity="0.2" wind="1 2 0" '))),
    ("swimmer, ball", "swimmer", replaced(('axis="0 0 1" name="free_body_rot"', 'name="free_body_rot"'),
                                           ('name="free_body_rot" pos="0 0 0" type="hinge"',
                                            'name="free_body_rot" pos="0 0 0" type="ball"'))),
]


def write_variants(folder):
    """Paths of the variants, by name."""
    paths = []
    for name, file, change in VARIANTS:
        path = os.path.join(folder, name + ".xml")
        with open(ASSETS + file + ".xml") as original, open(path, "w") as variant:
            variant.write(change(original.read()))
        paths.append(path)
    return paths


def refusal(program, path, *settings):
    """Why the program does not read the file, if it does not."""
    run = subprocess.run([program, path, "step", *settings], input=b"", capture_output=True)
    return run.stderr.decode().strip() if run.returncode else None


def call(program, path, what, cases, *settings):
    """Runs the program on an array of cases."""
    data = np.ascontiguousarray(cases, dtype="<f8").tobytes()
    run = subprocess.run([program, path, what, *settings], input=data, stdout=subprocess.PIPE, check=True)
    return np.frombuffer(run.stdout, dtype="<f8").reshape(len(cases), -1)


def anywhere(model, rng):
    """A random state and control, with the root at a random height."""
    q = model.qpos0.copy()
    for j in range(model.njnt):
        a, kind = model.jnt_qposadr[j], model.jnt_type[j]
        turn = rng.normal(size=4)
        turn /= np.linalg.norm(turn)
        if kind == mujoco.mjtJoint.mjJNT_FREE:
            q[a : a + 3] += rng.normal(size=3) * [1, 1, 0.3]
            q[a + 3 : a + 7] = turn
        elif kind == mujoco.mjtJoint.mjJNT_BALL:
            q[a : a + 4] = turn
        else:
            q[a] += rng.normal() * 0.7
    return q, rng.normal(size=model.nv) * 3, rng.uniform(-1.5, 1.5, model.nu)


def near_ground(model, rng):
    """A state near the reference pose, which is near the ground in most files."""
    q = model.qpos0.copy()
    mujoco.mj_integratePos(model, q, rng.normal(size=model.nv) * 0.15, 1)
    return q, rng.normal(size=model.nv) * 0.5


@functools.cache
def compiled(path):
    return mujoco.MjModel.from_xml_path(path)


def load(path, integrator=None):
    model = copy.copy(compiled(path))
    # Convergence to rounding.
    model.opt.tolerance, model.opt.ls_tolerance = 0, 1e-14
    model.opt.iterations, model.opt.ls_iterations = 200, 100
    model.opt.solver = mujoco.mjtSolver.mjSOL_NEWTON
    # Lists contacts slightly beyond those that act, for `grazes`. They act within the margin only.
    model.geom_gap += 1e-9
    if integrator:
        model.opt.integrator = INTEGRATORS[integrator]
    return model


def put(data, q, v, u):
    mujoco.mj_resetData(data.model, data)
    data.qpos[:], data.qvel[:], data.ctrl[:] = q, v, u


def grazes(data):
    """Whether rounding decides if a contact acts."""
    contact = data.contact
    return (np.abs(contact.dist - contact.includemargin) < 1e-12).any()


def relative(a, b):
    return np.abs(a - b).max(1) / np.maximum(np.abs(b).max(1), 1e-12)


def accelerations(program, path, settings=(), count=1000):
    """Errors, iterations, and fraction of states with contacts."""
    model = load(path)
    if "smooth" in settings:
        model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    rng, data = np.random.default_rng(0), mujoco.MjData(model)
    cases = [anywhere(model, rng) for _ in range(count)]
    own = call(program, path, "accelerations", [np.concatenate(case) for case in cases], *settings)
    theirs, touching, grazing = [], [], []
    for case in cases:
        put(data, *case)
        mujoco.mj_forward(model, data)
        theirs.append(data.qacc.copy())
        touching.append(data.ncon > 0)
        grazing.append(grazes(data))
    error = np.where(grazing, 0, relative(own[:, :-1], np.array(theirs)))
    return error.max(), own[:, -1].max(), np.mean(touching)


def trajectories(program, path, integrator, count=32, steps=100, nudge=1e-13):
    """Errors of single steps; errors after all steps and growth, per trajectory."""
    model = load(path, integrator)
    rng, data = np.random.default_rng(1), mujoco.MjData(model)
    starts = [near_ground(model, rng) for _ in range(count)]
    controls = rng.uniform(-1, 1, (steps, count, model.nu))

    grazing = np.zeros((steps, count), bool)

    def simulate(starts):
        states = np.empty((steps + 1, count, model.nq + model.nv))
        for i, (q, v) in enumerate(starts):
            put(data, q, v, controls[0, i])
            states[0, i] = np.concatenate([q, v])
            for t in range(steps):
                data.ctrl[:] = controls[t, i]
                mujoco.mj_step(model, data)
                grazing[t : t + 2, i] |= grazes(data)
                states[t + 1, i] = np.concatenate([data.qpos, data.qvel])
        return states

    theirs = simulate(starts)
    moved = simulate([(q, v + nudge * rng.normal(size=model.nv)) for q, v in starts])
    growth = np.abs(moved[-1] - theirs[-1]).max(1) / nudge
    before = np.concatenate([theirs[:-1], controls], 2).reshape(steps * count, -1)
    single = call(program, path, "step", before, integrator)
    after = theirs[1:].reshape(steps * count, -1)
    change = np.maximum(np.abs(after - before[:, : after.shape[1]]).max(1), 1e-3)
    single = np.where(grazing.ravel(), 0, np.abs(single - after).max(1) / change)
    own = theirs[0]
    for t in range(steps):
        own = call(program, path, "step", np.concatenate([own, controls[t]], 1), integrator)
    counted = ~grazing.any(0)
    return single.max(), np.abs(own - theirs[-1]).max(1)[counted], growth[counted]


def tangent(model, q):
    """The derivative of positions by the motion of each degree of freedom."""
    columns = np.zeros((model.nq, model.nv))
    for j in range(model.njnt):
        a, k, kind = model.jnt_qposadr[j], model.jnt_dofadr[j], mujoco.mjtJoint(model.jnt_type[j])
        if kind == mujoco.mjtJoint.mjJNT_FREE:
            columns[a : a + 3, k : k + 3] = np.eye(3)
            a, k = a + 3, k + 3
        if kind in (mujoco.mjtJoint.mjJNT_FREE, mujoco.mjtJoint.mjJNT_BALL):
            w, x, y, z = q[a : a + 4]
            turn = np.array([[-x, -y, -z], [w, -z, y], [z, w, -x], [-y, x, w]])
            columns[a : a + 4, k : k + 3] = turn / 2
        else:
            columns[a, k] = 1
    return columns


class Kinks:
    """Tells states at which differences are wrong."""

    def __init__(self, model):
        self.model, self.data = model, mujoco.MjData(model)

    def parts(self, q, v, u):
        """Active parts of all constraints and ranges, and the geometry of contacts."""
        model, data = self.model, self.data
        put(data, q, v, u)
        mujoco.mj_forward(model, data)
        contacts = data.contact
        if grazes(data):
            return None, np.zeros(0)
        limited = [
            (u, model.actuator_ctrlrange, model.actuator_ctrllimited),
            (data.actuator_force, model.actuator_forcerange, model.actuator_forcelimited),
        ]
        ranges = [np.digitize(x, r) for group in limited for x, r, on in zip(*group) if on]
        active = (contacts.geom.tolist(), data.efc_state.tolist(), data.efc_id.tolist(), ranges)
        return active, np.concatenate([contacts.pos, contacts.frame], 1).copy()

    def has(self, q, v, u, by=1e-5):
        active, geometry = self.parts(q, v, u)
        if active is None:
            return True
        nv = self.model.nv
        for i in range(2 * nv + len(u)):
            for sign in (by, -by):
                move = np.zeros(2 * nv + len(u))
                move[i] = sign
                moved = q.copy()
                mujoco.mj_integratePos(self.model, moved, move[:nv], 1)
                other, shape = self.parts(moved, v + move[nv : 2 * nv], u + move[2 * nv :])
                if other != active or np.abs(shape - geometry).max(initial=0) > 1e-3:
                    return True
        return False


def smooth_states(path, count=50):
    """States at which differences are derivatives."""
    model = load(path)
    model.opt.tolerance = 1e-15
    rng, kinks, states = np.random.default_rng(2), Kinks(model), []
    for i in range(count):
        q, v, u = anywhere(model, rng)
        if i % 2:
            q, v = near_ground(model, rng)
        if not kinks.has(q, v, u):
            states.append((q, v, u))
    return states, count


def derivatives(program, path, integrator, states, cotangents=3):
    """Largest 1 - cosine."""
    model = load(path, integrator)
    model.opt.tolerance = 1e-15
    rng, data = np.random.default_rng(3), mujoco.MjData(model)
    nv, nu, cases, expected, kept = model.nv, model.nu, [], [], []
    for q, v, u in states:
        put(data, q, v, u)
        mujoco.mj_forward(model, data)
        A, B = np.zeros((2 * nv, 2 * nv)), np.zeros((2 * nv, nu))
        mujoco.mjd_transitionFD(model, data, 1e-6, True, A, B, None, None)
        mujoco.mj_step(model, data)
        # A cotangent of the coordinates with the given one of the tangent space.
        push = tangent(model, data.qpos)
        lift = push / np.square(push).sum(0)
        for _ in range(cotangents):
            bar = rng.normal(size=2 * nv)
            cases.append(np.concatenate([q, v, u, lift @ bar[:nv], bar[nv:]]))
            expected.append(np.concatenate([bar @ A, bar @ B]))
            kept.append(q)
    if not cases:
        return 0
    own = call(program, path, "vjp", cases, integrator)
    worst = 0
    for q, bars, theirs in zip(kept, own, expected):
        bars = np.concatenate([bars[: model.nq] @ tangent(model, q), bars[model.nq :]])
        whole = np.linalg.norm(theirs)
        for part in (slice(None), slice(nv), slice(nv, 2 * nv), slice(2 * nv, None)):
            a, b = bars[part], theirs[part]
            lengths = np.linalg.norm(a) * np.linalg.norm(b)
            if np.linalg.norm(b) > 1e-5 * whole or np.linalg.norm(a) > 1e-5 * whole:
                worst = max(worst, 1 - a @ b / lengths if lengths > 0 else 1)
    return worst


def compare(program, path):
    """Prints the row of one file. Returns whether all errors are within their tolerances."""
    print(f"{os.path.basename(path)[:-4]:26}", end="", flush=True)
    own = {int(value): key for key, value in INTEGRATORS.items()}[compiled(path).opt.integrator]
    smooth, *_ = accelerations(program, path, ["smooth"])
    constrained, iterations, touching = accelerations(program, path)
    print(f" smooth {smooth:.0e} constrained {constrained:.0e} ({iterations:.0f})", end="")
    print(f", {touching:4.0%} touch", end="")
    states, count = smooth_states(path)
    print(f", {len(states)} of {count} smooth", end="")
    good = smooth <= SMOOTH and constrained <= CONSTRAINED
    for integrator in dict.fromkeys(["euler", own, "implicitfast"]):
        if refusal(program, path, integrator):
            print(f"\n    {integrator:12} refused", end="")
            continue
        single, errors, growth = trajectories(program, path, integrator)
        print(f"\n    {integrator:12} one step {single:.0e}", end="")
        print(f", {len(errors)} trajectories of 100 steps", end=" ")
        if len(errors):
            print(f"{np.median(errors):.0e} to {errors.max():.0e}, growth {growth.max():.0e}", end="")
        good &= single <= STEP and (errors <= np.maximum(TRAJECTORY, 1e-12 * growth)).all()
        if integrator != "rk4":
            cosine = derivatives(program, path, integrator, states)
            print(f", derivative {cosine:.0e}", end="", flush=True)
            good &= cosine <= COSINE
    print("" if good else "  ABOVE TOLERANCE", flush=True)
    return good


def main():
    program, *paths = sys.argv[1:]
    good = True
    program, paths = os.path.abspath(program), [os.path.abspath(path) for path in paths]
    with tempfile.TemporaryDirectory() as folder:
        # MuJoCo writes its log to the working directory.
        os.chdir(folder)
        if not paths:
            paths = sorted(glob.glob(ASSETS + "*.xml")) + sorted(glob.glob(SUITE + "*.xml"))
            paths += write_variants(folder)
        for path in paths:
            if reason := refusal(program, path):
                print(f"{os.path.basename(path)[:-4]:26} refused: {reason}")
            else:
                good &= compare(program, path)
    sys.exit(not good)


if __name__ == "__main__":
    main()
