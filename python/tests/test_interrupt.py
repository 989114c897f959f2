"""Ctrl-C in computations of several seconds."""

import subprocess
import sys

import pytest

SCRIPT = """
import os, signal, threading, time
import physgrad as pg
# A shell ignores the signal in background processes.
signal.signal(signal.SIGINT, signal.default_int_handler)
{setup}
sent = []
def send():
    sent.append(time.monotonic())
    os.kill(os.getpid(), signal.SIGINT)
threading.Timer(1.0, send).start()
try:
    {call}
    print("finished")
except KeyboardInterrupt:
    print(time.monotonic() - sent[0])
    while time.monotonic() - sent[0] < {limit}:
        busy = time.process_time()
        time.sleep(0.2)
        if time.process_time() - busy < 0.05:
            print("idle")
            break
    plan = pg.optimize(pg.task("cart_pole", poles=1, horizon=5), [0.0, 0.0, 3.0, 0.0], iterations=1)
    print(plan.u.shape)
"""

LONG = """
import numpy as np
task = pg.task('cart_pole', poles=1, horizon=100)
policy = pg.Mlp(task, [64, 64], seed=1)
starts = task.starts(10**5)
"""
SETUPS = {
    "identify": (
        "task = pg.task('cart_pole', poles=4, horizon=2000, precision='f64')\n"
        "x, u = pg.rollout(task, pg.Mlp(task, [8], seed=1, zero_init_output=False), task.starts(2, seed=1))\n"
        "data = [(x[i, :-1], u[i]) for i in range(2)] * 40",
        "pg.identify(task, data, params={'system.pole_mass': 0.3, 'system.cart_mass': 0.7})",
    ),
    # An iteration takes longer than the test allows.
    "optimize": (
        "task = pg.task('cart_pole', poles=4, horizon=40000)",
        "pg.optimize(task, task.starts(1)[0], bounds=[[-20, 20]])",
    ),
    # A block of 32 samples takes less than a second.
    "rollout": (LONG, "pg.rollout(task, policy, starts)"),
    "losses": (LONG, "pg.losses(task, policy, np.tile(starts, (20, 1)))"),
    "gradients": (LONG, "pg.gradients(task, policy, starts)"),
    "policy": (LONG, "[policy(np.zeros((10**7, 4))) for _ in range(100)]"),
    "starts": (LONG, "task.starts(10**8)"),
    "step": (LONG, "[task.step(np.zeros((10**7, 4)), np.zeros((10**7, 1))) for _ in range(100)]"),
    "check": ("task = pg.task('cart_pole', poles=20, horizon=400)", "pg.check(task)"),
    "accuracy": ("task = pg.task('cart_pole', poles=8)", "pg.accuracy(task, target=1e-4)"),
}


@pytest.mark.parametrize("name", SETUPS)
def test_ctrl_c_raises_within_a_second_and_stops_the_threads(name):
    setup, call = SETUPS[name]
    # `accuracy` reads the stop flag only between simulations, and `check` between its notes. One simulation
    # takes seconds in a debug build.
    code = SCRIPT.format(setup=setup, call=call, limit=20.0 if name in ("accuracy", "check") else 1.5)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120)
    elapsed, after = done.stdout.split("\n", 1)
    assert float(elapsed) < 1.0 and after == "idle\n(5, 1)\n", done.stdout + done.stderr
