"""Threads, forked processes, and files that wait."""

import multiprocessing
import os
import subprocess
import sys
import threading

import numpy as np
import physgrad as pg
import pytest

FAST = {"train_samples": 16, "test_samples": 16}


def results(folder):
    """Results of all calls that share their work among threads."""
    task = pg.task("cart_pole", poles=1, horizon=10, precision="f64")
    policy = pg.Mlp(task, [8], seed=1, zero_init_output=False)
    starts = task.starts(2000, seed=1)
    x, u = pg.rollout(task, policy, starts)
    run = pg.train(task, policy, epochs=1, seed=1, threads=2, **FAST)
    run.save(folder)
    run.report(folder / "report.html")
    data = [(x[i, :-1], u[i]) for i in range(4)]
    fit = pg.identify(task, data, params={"system.pole_mass": 0.12})
    return {
        "step": task.step(x[:, 0], u[:, 0]),
        "policy": policy(x[:, 0]),
        "losses": pg.losses(task, policy, starts),
        "gradients": pg.gradients(task, policy, starts, fields=["R"])["R"],
        "train": pg.load(folder).policy.theta,
        "identify": np.array(list(fit.values.values())),
        "optimize": pg.optimize(task, starts[0], iterations=2).u,
    }


@pytest.mark.skipif("fork" not in multiprocessing.get_all_start_methods(), reason="the system has no fork")
@pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning")
@pytest.mark.parametrize("generations", [1, 2])
def test_forked_processes_have_threads_of_their_own(tmp_path, generations):
    expected, fork = results(tmp_path / "parent"), multiprocessing.get_context("fork")

    def child(generation):
        if generation == generations:
            return np.savez(tmp_path / "results.npz", **results(tmp_path / "child"))
        run(generation + 1)

    def run(generation):
        process = fork.Process(target=child, args=(generation,))
        process.start()
        process.join(60)
        if process.is_alive():
            process.kill()

    run(1)
    # A child that waits for threads of its parent writes nothing.
    found = np.load(tmp_path / "results.npz")
    assert all(np.array_equal(found[name], expected[name]) for name in expected)


def python(code, **variables):
    environment = {**os.environ, **{name: str(value) for name, value in variables.items()}}
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120, env=environment)


CALLS = """
import numpy as np, physgrad as pg
task = pg.task("cart_pole", poles=1, horizon=5)
def outcome(call):
    try:
        call()
        return "done"
    except Exception as error:
        return f"{type(error).__name__}: {error}"
x, u = np.zeros((2000, 4)), np.zeros((2000, 1))
for call in (
    lambda: task.step(x[:10], u[:10]),
    lambda: task.step(x, u),
    lambda: pg.losses(task, pg.Policy(task), task.starts(4)),
    lambda: pg.optimize(task, task.starts(1)[0], iterations=1),
    lambda: pg.train(task, epochs=1, train_samples=16, test_samples=16),
):
    print(outcome(call))
"""


@pytest.mark.skipif(sys.platform != "linux", reason="limits the threads as Linux does")
@pytest.mark.parametrize("threads", [2, 1])
def test_threads_that_the_system_refuses_are_an_exception(threads):
    # No address space has room for the stack of a new thread.
    ran = python(CALLS, RAYON_NUM_THREADS=threads, RUST_MIN_STACK=1 << 47)
    lines = ran.stdout.splitlines()
    assert ran.returncode == 0 and len(lines) == 5, ran.stdout + ran.stderr
    assert lines[0] == "done"
    message = "RuntimeError: the system does not start 2 threads"
    assert all(line == "done" if threads == 1 else line.startswith(message) for line in lines[1:]), lines


def test_numbers_of_threads_have_a_limit():
    task = pg.task("cart_pole", poles=1)
    for threads in (0, 10**9, 2**63):
        with pytest.raises(ValueError, match=f"`threads` is {threads}; allowed: 1 to"):
            pg.Run(task, threads=threads)
    lines = python(CALLS, RAYON_NUM_THREADS=100_000).stdout.splitlines()
    assert lines[0] == "done" and all("RAYON_NUM_THREADS is 100000; allowed: 1 to" in line for line in lines[1:])
    for value in ("3", "1", "0", ""):
        assert python(CALLS, RAYON_NUM_THREADS=value).stdout == "done\n" * 5


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="the system has no pipes in folders")
def test_pipes_are_refused(tmp_path):
    pipe, task = tmp_path / "pipe.toml", pg.task("cart_pole", poles=1)
    os.mkfifo(pipe)
    folder = tmp_path / "run"
    pg.train(task, epochs=1, out=folder, **FAST)
    (folder / "checkpoint.bin").unlink()
    os.mkfifo(folder / "checkpoint.bin")
    # A write end ends the wait of a call that opens the pipe, after the test has failed.
    timer = threading.Timer(20, lambda: [os.open(p, os.O_RDWR) for p in (pipe, folder / "checkpoint.bin")])
    timer.daemon = True
    timer.start()
    for call in (
        lambda: pg.Policy(task).load(pipe),
        lambda: pg.task(pipe),
        lambda: pg.load(folder),
    ):
        with pytest.raises(ValueError, match="not a file"):
            call()
    timer.cancel()
