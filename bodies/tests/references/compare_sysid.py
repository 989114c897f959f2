"""Identification of numbers of models, beside `mujoco.sysid`.

Usage: python compare_sysid.py [PROBLEM ...] [--starts 8]

MuJoCo simulates the data, with the true numbers and random controls, and noise is added to positions
and velocities. Both programs know the initial states and the noise, and begin at true numbers times
exp(uniform(-0.5, 0.5)), with bounds at a tenth and ten times that. `mujoco.sysid` minimizes the same sum
of squares by its own Gauss-Newton method on finite differences, with its default options. Needs physgrad
and `mujoco[sysid]` from PyPI. Seconds are those of all threads.

A row has the number of starts that end within 5 % of all true numbers, the median and the largest error
over the starts, where that of a start is its largest relative error of a number, and medians of the
simulations of all segments (for physgrad: and of the Jacobians by dual numbers) and of the seconds.
"""
import argparse
import contextlib
import io
import tempfile
import time
import warnings
from pathlib import Path

import mujoco
import mujoco.rollout
import numpy as np
from mujoco import sysid

import physgrad as pg

MODELS = Path(__file__).parents[2] / "models"

DOUBLE_PENDULUM = """
<mujoco model="double">
  <option timestep="0.005"/>
  <worldbody>
    <body name="upper" pos="0 0 1">
      <joint name="shoulder" axis="0 1 0" damping="0.1"/>
      <geom name="upper" type="capsule" fromto="0 0 0 0 0 -0.4" size="0.03" mass="1.2" contype="0"/>
      <body name="lower" pos="0 0 -0.4">
        <joint name="elbow" axis="0 1 0" damping="0.05"/>
        <geom name="lower" type="capsule" fromto="0 0 0 0 0 -0.3" size="0.03" mass="0.7" contype="0"/>
      </body>
    </body>
  </worldbody>
  <actuator><motor name="shoulder" joint="shoulder"/><motor name="elbow" joint="elbow"/></actuator>
</mujoco>
"""

# A box that falls by 2 cm and is pushed over the floor.
BOX = """
<mujoco model="box">
  <option timestep="0.005"/>
  <worldbody>
    <geom name="floor" type="plane" size="5 5 1" friction="0.1"/>
    <body name="box" pos="0 0 0.12">
      <joint name="x" type="slide" axis="1 0 0"/>
      <joint name="z" type="slide" axis="0 0 1"/>
      <joint name="turn" axis="0 1 0"/>
      <geom name="box" type="box" size="0.15 0.1 0.1" mass="1.5" friction="0.5"/>
    </body>
  </worldbody>
  <actuator><motor name="push" joint="x"/></actuator>
</mujoco>
"""


class Problem:
    """A model with true numbers, by keys of physgrad without `system.`, and how it is moved."""

    def __init__(self, model, numbers, push, *, frames=4, steps=50, segments=6, spread=(0.3, 0.3),
                 velocities=True, **settings):
        self.numbers, self.push, self.frames, self.steps = numbers, push, frames, steps
        self.segments, self.spread, self.velocities, self.settings = segments, spread, velocities, settings
        self.touches = settings.get("contacts") != "none" and model is not DOUBLE_PENDULUM
        self.path = model if isinstance(model, Path) else None
        self.text = None if self.path else model

    def spec(self, numbers):
        """MuJoCo's description with these numbers."""
        spec = mujoco.MjSpec.from_file(str(self.path)) if self.path else mujoco.MjSpec.from_string(self.text)
        # Without this flag a diverging simulation begins again, and its time too.
        spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
        if self.path and self.path.suffix == ".urdf":
            spec.compiler.fusestatic = False
            spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
            for joint in spec.joints:
                actuator = spec.add_actuator(name=joint.name, target=joint.name)
                actuator.trntype = mujoco.mjtTrn.mjTRN_JOINT
        if self.settings.get("method") == "euler":
            spec.option.integrator = mujoco.mjtIntegrator.mjINT_EULER
        model = spec.compile()
        for key, value in numbers.items():
            change(spec, model, key, value)
        return spec

    def task(self, folder):
        model = self.path
        if not model:
            model = folder / "model.xml"
            model.write_text(self.text)
        return pg.bodies(model, frames=self.frames, **self.settings)


def change(spec, model, key, value):
    """Sets a number of a description. `model` has the inertia of the file."""
    kind, name, what = key.split(".")
    if kind == "joint":
        joint = spec.joint(name)
        joint.damping = value if np.isscalar(joint.damping) else [value, 0, 0]
        return
    if kind == "shape":
        geom = spec.geom(name)
        geom.friction = [value, *geom.friction[1:]]
        return
    body, of = spec.body(name), model.body(name)
    if not body.explicitinertial or not np.isnan(body.fullinertia[0]):
        body.mass, body.ipos, body.iquat = of.mass[0], of.ipos, of.iquat
        body.inertia, body.fullinertia, body.explicitinertial = of.inertia, [np.nan] * 6, True
    if what == "mass":
        body.inertia = np.asarray(body.inertia) * value / body.mass
        body.mass = value
    else:
        # A stretch along the principal axis z: S_zz is half of xx + yy - zz.
        xx, yy, zz = body.inertia
        grown = (xx + yy - zz) / 2 * (value**2 - 1)
        body.inertia = [xx + grown, yy + grown, zz]


def simulate(problem, rng):
    """States at each control, and controls, of MuJoCo."""
    model = problem.spec(problem.numbers).compile()
    data = mujoco.MjData(model)
    xs, us = [], []
    for _ in range(problem.segments):
        mujoco.mj_resetData(model, data)
        data.qpos += rng.uniform(-problem.spread[0], problem.spread[0], model.nq)
        data.qvel += rng.uniform(-problem.spread[1], problem.spread[1], model.nv)
        u = problem.push(rng, problem.steps, model.nu)
        x = [np.r_[data.qpos, data.qvel]]
        for row in u:
            data.ctrl[:] = row
            mujoco.mj_step(model, data, problem.frames)
            x.append(np.r_[data.qpos, data.qvel])
        xs.append(np.array(x))
        us.append(u)
    return xs, us


def by_sysid(problem, xs, us, noise, starts):
    """Numbers, simulations and seconds of `mujoco.sysid`."""
    parameters = sysid.ParameterDict()
    spec = problem.spec({})
    reference = spec.compile()
    for key, start in starts.items():
        parameters.add(sysid.Parameter(key, start, start / 10, start * 10))
    spec.add_sensor(name="time", type=mujoco.mjtSensor.mjSENS_CLOCK)
    model, n = spec.compile(), len(us[0]) * problem.frames
    times = np.arange(n + 1) * model.opt.timestep
    control, sensors, initial = [], [], []
    for x, u in zip(xs, us):
        held = np.repeat(np.vstack([u, u[-1:]]), problem.frames, axis=0)[: n + 1]
        control.append(sysid.TimeSeries.from_control_names(times, held, model))
        sensors.append(sysid.TimeSeries.from_names(times, times[:, None], model))
        initial.append(sysid.create_initial_state(model, x[0, : model.nq], x[0, model.nq :]))
    names = [f"segment{i}" for i in range(len(xs))]
    sequences = [
        sysid.ModelSequences(name, spec, name, *rest) for name, *rest in zip(names, initial, control, sensors)
    ]
    order, count = iter(()), 0

    def residual(parameters, predicted, measured, model, return_all, *, state):
        # States after each control. Segments follow each other in the order of `sequences`.
        index = next(order)
        rows = state[problem.frames - 1 :: problem.frames, 1 : 1 + model.nq + model.nv]
        misfit = (rows - xs[index][1 : len(rows) + 1]) / noise
        return misfit[:, : misfit.shape[1] if problem.velocities else model.nq].ravel(), predicted, measured

    def model_of(parameters, spec):
        spec = spec.copy()
        for key in starts:
            change(spec, reference, key, parameters[key].value[0])
        return spec.compile()

    residual_of = sysid.build_residual_fn(
        models_sequences=sequences, build_model=model_of, modify_residual=residual, n_threads=1,
        resample_true=False,
    )

    def counted(x, parameters):
        nonlocal order, count
        columns = x.shape[1] if x.ndim > 1 else 1
        count += columns
        order = iter([i for i in range(len(xs)) for _ in range(columns)])
        return residual_of(x, parameters)

    begin = time.process_time()
    with contextlib.redirect_stdout(io.StringIO()):
        found, _ = sysid.optimize(parameters, counted, verbose=False)
    return dict(zip(starts, found.as_vector())), count, time.process_time() - begin


def in_two_fits(task, xs, us, noise, starts):
    """As `by_physgrad`, from the result with smooth contacts."""
    rough, *effort = by_physgrad(task.replace(contacts="smooth"), xs, us, noise, starts)
    values, counts, seconds = by_physgrad(task, xs, us, noise, rough)
    return values, tuple(np.add(effort[0], counts)), effort[1] + seconds


def by_physgrad(task, xs, us, noise, starts):
    """Numbers, simulations and Jacobians, and seconds of `pg.identify`."""
    keys = {f"system.{key}": {"start": v, "min": v / 10, "max": v * 10} for key, v in starts.items()}
    begin = time.process_time()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        fit = pg.identify(task, list(zip(xs, us)), keys, noise, exact_starts=True)
    seconds = time.process_time() - begin
    values = {key: fit.values[f"system.{key}"] for key in starts}
    return values, (fit.simulations, fit.jacobians), seconds


def held(size):
    """Random controls that change every five steps."""
    return lambda rng, steps, m: np.repeat(rng.uniform(-1, 1, (-(-steps // 5), m)), 5, 0)[:steps] * size


BOX_NUMBERS = {"body.box.mass": 1.8, "shape.box.friction": 0.4}
HOPPER_NUMBERS = {
    "body.torso.mass": 4.4, "body.leg.mass": 2.3,
    "joint.thigh_joint.damping": 1.3, "joint.foot_joint.damping": 0.7,
}
HOPPER = {"steps": 20, "segments": 15, "spread": (0.02, 0.1), "method": "euler"}
PROBLEMS = {
    "double pendulum": Problem(
        DOUBLE_PENDULUM,
        {"body.upper.mass": 1.4, "body.lower.mass": 0.6, "body.lower.stretch_z": 1.2,
         "joint.shoulder.damping": 0.15, "joint.elbow.damping": 0.04},
        held(np.array([2.0, 0.6])), spread=(1.0, 1.0),
    ),
    "arm": Problem(
        MODELS / "arm.urdf",
        {"body.upper_arm.mass": 2.2, "body.forearm.mass": 1.5, "body.flange.mass": 0.7,
         "joint.shoulder_pitch.damping": 2.6, "joint.elbow.damping": 1.6, "joint.wrist_pitch.damping": 0.3},
        held(np.array([5, 20, 5, 6, 2, 1, 1])), frames=10, steps=20, segments=8, contacts="none",
    ),
    "box": Problem(BOX, BOX_NUMBERS, held(12.0), spread=(0.0, 0.3)),
    "box, positions": Problem(BOX, BOX_NUMBERS, held(12.0), spread=(0.0, 0.3), velocities=False),
    "hopper": Problem(MODELS / "hopper.xml", HOPPER_NUMBERS, held(0.4), **HOPPER),
    "hopper, positions": Problem(MODELS / "hopper.xml", HOPPER_NUMBERS, held(0.4), velocities=False, **HOPPER),
}


def row(name, found, truths):
    """A row of the table, from numbers, effort and seconds of each start."""
    errors = [max(abs(values[key] / truth - 1) for key, truth in truths.items()) for values, *_ in found]
    efforts = np.median([effort for _, effort, *_ in found], axis=0)
    seconds = np.median([seconds for *_, seconds in found])
    good = sum(error < 0.05 for error in errors)
    effort = " + ".join(f"{count:.0f}" for count in np.atleast_1d(efforts))
    parts = f"{np.median(errors):.1e}", f"{max(errors):.1e}", effort, f"{seconds:.1f}"
    cells = [name, f"{good} of {len(found)}", *parts]
    return f"| {' | '.join(cells)} |"


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("problems", nargs="*", default=list(PROBLEMS))
    parser.add_argument("--starts", type=int, default=8)
    arguments = parser.parse_args()
    print("| problem, program | within 5 % | median error | largest | simulations | seconds |")
    print("|---|---|---|---|---|---|")
    for name in arguments.problems:
        problem, rng = PROBLEMS[name], np.random.default_rng(1)
        xs, us = simulate(problem, rng)
        n = xs[0].shape[1]
        noise = np.where(np.arange(n) < n // 2, 1e-3, 1e-2)
        noisy = [np.vstack([x[:1], rng.normal(x[1:], noise)]) for x in xs]
        if not problem.velocities:
            for x in noisy:
                x[1:, n // 2 :] = np.nan
        programs = {"mujoco.sysid": lambda _, *data: by_sysid(problem, *data), "physgrad": by_physgrad}
        if problem.touches:
            programs["physgrad, smooth first"] = in_two_fits
        results = {program: [] for program in programs}
        with tempfile.TemporaryDirectory() as folder:
            task = problem.task(Path(folder))
            for _ in range(arguments.starts):
                starts = {key: true * np.exp(rng.uniform(-0.5, 0.5)) for key, true in problem.numbers.items()}
                for program, fit in programs.items():
                    results[program].append(fit(task, noisy, us, noise, starts))
        for program, found in results.items():
            print(row(f"{name}, {program}", found, problem.numbers), flush=True)


if __name__ == "__main__":
    main()
