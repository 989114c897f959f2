"""Times of steps and derivatives beside those of MuJoCo, on one thread.

Usage: python speed.py SPEED [FILE.xml ...]

SPEED is the example `speed` of this package, which see. Without files, times those of Gymnasium. MuJoCo
uses Euler's method and the solver settings of the file. Its derivatives are forward differences of
`mjd_transitionFD`: all columns, where a reverse derivative is one product. Smallest times of many rounds.

With the package `mujoco-mjx`, also times MJX on the same core: rollouts of 32 samples and 16 steps, and their
reverse derivatives, with one iteration of the solver, since the reverse mode of MJX has no more.
"""
import importlib.util
import os
import subprocess
import sys
import time

# JAX reads this when it is imported.
os.environ["XLA_FLAGS"] = "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"

import mujoco
import numpy as np

ASSETS = os.path.dirname(importlib.util.find_spec("gymnasium").origin) + "/envs/mujoco/assets/"
NAMES = ["hopper", "half_cheetah", "walker2d_v5", "ant", "humanoid"]


def typical(model, data, count=32):
    """States and controls after 200 steps of random controls, as in SPEED."""
    rng, states = np.random.default_rng(0), []
    for _ in range(count):
        mujoco.mj_resetData(model, data)
        data.qvel[:] = rng.normal(size=model.nv) * 0.05
        for _ in range(20):
            data.ctrl[:] = rng.uniform(-1, 1, model.nu)
            mujoco.mj_step(model, data, 10)
        states.append((data.qpos.copy(), data.qvel.copy(), data.ctrl.copy(), data.qacc_warmstart.copy()))
    return states


def rounds(states, data, work, count):
    """Smallest and median time of a call in microseconds, mean over states."""
    times = np.zeros((count, len(states)))
    for i in range(count):
        for k, (q, v, u, warmstart) in enumerate(states):
            data.qpos[:], data.qvel[:], data.ctrl[:], data.qacc_warmstart[:] = q, v, u, warmstart
            begin = time.perf_counter()
            work()
            times[i, k] = time.perf_counter() - begin
    means = times.mean(1) * 1e6
    return means.min(), np.median(means)


def mujoco_row(path):
    model = mujoco.MjModel.from_xml_path(path)
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_EULER
    data = mujoco.MjData(model)
    states = typical(model, data)
    A, B = np.zeros((2 * model.nv, 2 * model.nv)), np.zeros((2 * model.nv, model.nu))
    # Five steps from each state: a call from Python takes 1 us.
    step = np.array(rounds(states, data, lambda: mujoco.mj_step(model, data, 5), 60)) / 5
    fd = rounds(states, data, lambda: mujoco.mjd_transitionFD(model, data, 1e-6, False, A, B, None, None), 20)
    return f"step {step[0]:.2f} ({step[1]:.2f}), mjd_transitionFD {fd[0]:.0f} ({fd[1]:.0f})"


def mjx_row(path):
    """Times of MJX per sample and step, and of its compilation."""
    import jax
    from mujoco import mjx

    samples, steps = 32, 16
    model = mujoco.MjModel.from_xml_path(path)
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_EULER
    model.opt.iterations, model.opt.ls_iterations = 1, 4
    try:
        device = mjx.put_model(model)
    except NotImplementedError as error:
        return f"refused: {error}"
    data = mujoco.MjData(model)
    q, v, u, _ = typical(model, data, 1)[0]
    data.qpos[:], data.qvel[:], data.ctrl[:] = q, v, u
    mujoco.mj_forward(model, data)
    start = mjx.put_data(model, data)

    def cost(q, controls):
        step = lambda data, u: (mjx.step(device, data.replace(ctrl=u)), None)
        last, _ = jax.lax.scan(step, start.replace(qpos=q), controls)
        return last.qpos[0] + 0.01 * (last.qvel**2).sum()

    rng = np.random.default_rng(0)
    starts = q + 1e-3 * rng.normal(size=(samples, model.nq))
    controls = rng.uniform(-1, 1, (samples, steps, model.nu))
    parts = []
    for name, function in [("rollout", cost), ("value_and_grad", jax.value_and_grad(cost, argnums=1))]:
        begin = time.perf_counter()
        compiled = jax.jit(jax.vmap(function)).lower(starts, controls).compile()
        compilation, times = time.perf_counter() - begin, []
        for _ in range(5):
            begin = time.process_time()
            jax.block_until_ready(compiled(starts, controls))
            times.append(time.process_time() - begin)
        each = min(times) / samples / steps * 1e6
        parts.append(f"{name} {each:.0f} (compiled in {compilation:.0f} s)")
    return ", ".join(parts)


def main():
    program, *paths = sys.argv[1:]
    paths = paths or [ASSETS + name + ".xml" for name in NAMES]
    print(subprocess.run([program, *paths], capture_output=True, text=True, check=True).stdout, end="")
    for path in paths:
        print(f"MuJoCo, {os.path.basename(path)[:-4]:16} {mujoco_row(path)}")
    if importlib.util.find_spec("mujoco.mjx"):
        for path in paths:
            print(f"MJX, {os.path.basename(path)[:-4]:16} {mjx_row(path)}", flush=True)


if __name__ == "__main__":
    main()
