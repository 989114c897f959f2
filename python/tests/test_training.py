"""Trainings, gradients and rollouts against identities and the program."""

import os
import re
import shutil
import subprocess
import sys
import threading
import time

import numpy as np
import pytest

import physgrad as pg

FAST = {"train_samples": 16, "test_samples": 16}


def small(**settings):
    return pg.task("cart_pole", poles=1, horizon=20, precision="f64", **settings)


def policy_of(task, seed=1):
    policy = pg.Mlp(task, [8], seed=seed, zero_init_output=False)
    return policy


def test_regular_gradient_equals_central_differences():
    task = small()
    policy, starts = policy_of(task), task.starts(8, seed=2)
    gradient, theta, h = pg.gradients(task, policy, starts, fields=["R"])["R"], policy.theta, 1e-6
    direction = np.random.default_rng(0).normal(size=theta.size)
    ends = []
    for sign in (1, -1):
        policy.theta = theta + sign * h * direction
        ends.append(pg.losses(task, policy, starts).mean())
    assert np.isclose(gradient @ direction, (ends[0] - ends[1]) / (2 * h), rtol=1e-5)


def test_combined_has_the_values_of_modified_where_signs_agree():
    task = small()
    found = pg.gradients(task, policy_of(task), task.starts(40, seed=2), fields=["R", "M", "N", "S", "C"])
    agree = np.sign(found["R"]) * np.sign(found["M"]) > 0
    assert np.array_equal(found["C"], np.where(agree, found["M"], 0)) and 0 < agree.mean() <= 1
    again = pg.gradients(task, policy_of(task), task.starts(40, seed=2), fields=["S"])
    np.testing.assert_allclose(again["S"], found["S"], rtol=1e-12)


def test_rollouts_repeat_step_and_policy_and_sum_costs():
    task = small()
    policy, starts = policy_of(task), task.starts(40, seed=2)
    x, u = pg.rollout(task, policy, starts)
    assert x.shape == (40, 21, 4) and u.shape == (40, 20, 1)
    cost = np.zeros(40)
    for t in range(20):
        np.testing.assert_allclose(policy(x[:, t]), u[:, t], rtol=1e-12, atol=1e-12)
        assert np.array_equal(task.step(x[:, t], u[:, t], t=t), x[:, t + 1])
        cost += task.running_cost(x[:, t], u[:, t], x[:, t + 1], t=t)
    np.testing.assert_allclose(cost + task.terminal_cost(x[:, -1]), pg.losses(task, policy, starts), rtol=1e-12)


def test_history_has_the_losses_of_the_policy():
    task = small()
    records = []
    run = pg.train(task, policy_of(task), field="M", epochs=3, seed=1, callback=records.append, **FAST)
    assert run.is_done and [record["epoch"] for record in records] == [1, 2, 3]
    test = task.starts(16, seed=1, split="test")
    assert np.isclose(pg.losses(task, run.policy, test).mean(), run.history["test_loss"][-1], rtol=1e-12)
    assert np.isclose(pg.losses(task, run.best_policy, test).mean(), run.history["test_loss"].min(), rtol=1e-12)


def program():
    path = os.environ.get("PHYSGRAD", shutil.which("physgrad"))
    return path or pytest.skip("the program is missing; set PHYSGRAD to its path")


def test_policy_file_has_the_bytes_of_the_program(tmp_path):
    task = pg.task("cart_pole", poles=2)
    run = pg.train(task, pg.Mlp(task, [16, 16], seed=4), field="C", epochs=3, seed=4, out=tmp_path / "python", **FAST)
    settings = ["system.poles=2", "policy.widths=[16,16]", "training.train_samples=16", "training.test_samples=16"]
    options = [option for setting in settings for option in ("--set", setting)]
    arguments = ["train", "cart_pole", "--field", "C", "--epochs", "3", "--seed", "4", "-q", "-o", str(tmp_path / "program")]
    subprocess.run([program(), *arguments, *options], check=True)
    for name in ("policy.safetensors", "best_policy.safetensors", "run.toml"):
        assert (tmp_path / "python" / name).read_bytes() == (tmp_path / "program" / name).read_bytes()
    run.policy.save(tmp_path / "p.safetensors")
    assert (tmp_path / "p.safetensors").read_bytes() == (tmp_path / "program" / "policy.safetensors").read_bytes()


def test_runs_are_saved_loaded_continued_and_reported(tmp_path):
    task = pg.task("cart_pole", poles=1)
    whole = pg.train(task, epochs=4, seed=1, **FAST)
    pg.train(task, epochs=2, seed=1, out=tmp_path / "run", **FAST)
    run = pg.load(tmp_path / "run")
    run.train(epochs=4)
    assert np.array_equal(run.policy.theta, whole.policy.theta) and len(run.history["epoch"]) == 4
    assert len(pg.load(tmp_path / "run").history["epoch"]) == 4
    fresh = pg.Policy(task, seed=9)
    fresh.load(tmp_path / "run" / "policy.safetensors")
    assert np.array_equal(fresh.theta, run.policy.theta)


@pytest.mark.parametrize("section", [
    {"kind": "linear", "bias": False},
    {"kind": "gru", "units": 3},
    {"kind": "open_loop", "bounds": [[-2.0, 2.0]]},
    {"kind": "equations", "control.force": "k * x", "parameters.k": {"start": 0.5}},
    {"widths": [4], "base": {"kind": "elman", "units": 2}},
])
def test_every_kind_of_policy_is_trained_saved_and_loaded(section, tmp_path):
    task = small()
    policy = pg.Policy(task, seed=1, **section)
    run = pg.train(task, policy, epochs=2, out=tmp_path / "run", learning_rate=0.1, **FAST)
    assert not np.array_equal(run.policy.theta, policy.theta)
    assert np.array_equal(pg.load(tmp_path / "run").policy.theta, run.policy.theta)
    pg.check(task, run.policy)
    # Another kind drops the settings of the first.
    assert pg.Policy(task.replace(policy=section), kind="gru", units=2).theta.size > 0


def page(path):
    """Page of a report without the numbers of clip paths, which count all charts of a process."""
    return re.sub(r"kuva-clip-\d+", "kuva-clip", path.read_text())


def stop(_record):
    raise InterruptedError


@pytest.mark.parametrize("epochs", [2, 1, 0])
def test_a_report_is_that_of_the_program_with_and_without_a_folder(tmp_path, epochs):
    run, folder = pg.Run(small(), policy_of(small()), epochs=2, seed=1, **FAST), tmp_path / "run"
    if epochs == 1:
        with pytest.raises(InterruptedError):
            run.train(stop)
    elif epochs == 2:
        run.train()
    run.report(tmp_path / "memory.html")
    assert run.folder is None and len(run.history["epoch"]) == epochs
    run.save(folder)
    run.report(tmp_path / "folder.html")
    subprocess.run([program(), "report", "-q", str(folder)], check=True)
    whole = page(folder / "report.html")
    assert "<html" in whole and "Folder <b>run</b>" in whole and page(tmp_path / "folder.html") == whole
    without = whole.replace("Folder <b>run</b>, made", "Made").replace(" (run)</title>", "</title>")
    assert page(tmp_path / "memory.html") == without


def test_training_starts_from_a_trained_policy():
    task = small()
    first = pg.train(task, field="C", epochs=2, seed=1, **FAST)
    zero = pg.train(task, first.policy, epochs=1, seed=1, learning_rate=1e-12, **FAST)
    assert np.isclose(zero.history["test_loss"][0], first.history["test_loss"][-1], rtol=1e-6)


def test_a_random_policy_replaces_the_initial_policy_of_a_scene():
    first = pg.train(small(), field="C", epochs=1, seed=1, **FAST)
    second = pg.Run(small(), first.policy, epochs=1, seed=0, **FAST)
    assert np.array_equal(second.policy.theta, first.policy.theta)
    third = pg.Run(second.task, pg.Policy(second.task, seed=0), epochs=1, seed=0, **FAST)
    assert np.array_equal(third.policy.theta, pg.Policy(second.task, seed=0).theta)


def test_policies_of_other_trained_numbers_are_refused(tmp_path):
    def fit(name, **bounds):
        return small(**{name: {"start": 1.0, **bounds}})

    # Bounds have to survive text: 9.81 * 1.05 has 17 digits.
    run = pg.train(fit("cart_mass", min=1 / 1.1, max=9.81 * 1.05), field="C", epochs=1, seed=1, **FAST)
    run.policy.save(tmp_path / "policy.safetensors")
    pg.Policy(run.task).load(tmp_path / "policy.safetensors")
    for other in (fit("pole_mass", min=1 / 1.1, max=9.81 * 1.05), fit("cart_mass", min=0.5)):
        with pytest.raises(ValueError, match="it has the trained numbers system.cart_mass min 0.909"):
            pg.Policy(other).load(tmp_path / "policy.safetensors")


def test_policies_of_another_task_are_refused():
    slider, bounce = pg.task("slider", horizon=5), pg.task("bounce", horizon=5)
    sizes = [(task.observation_dim, task.control_dim, task.start_dim) for task in (slider, bounce)]
    assert sizes[0] == sizes[1]
    policy, starts = pg.Policy(slider), bounce.starts(2)
    for call in (
        lambda: pg.rollout(bounce, policy, starts),
        lambda: pg.losses(bounce, policy, starts),
        lambda: pg.gradients(bounce, policy, starts),
        lambda: pg.Run(bounce, policy),
        lambda: pg.check(bounce, policy),
    ):
        with pytest.raises(ValueError, match="it is a policy of the task `slider`, but the task of the scene is `bounce`"):
            call()


def test_large_policy_files_are_refused(tmp_path):
    path, policy = tmp_path / "policy.safetensors", pg.Policy(pg.task("pendulum"))
    with path.open("wb") as file:
        file.truncate(10**12)
    with pytest.raises(ValueError, match="has more than .* bytes, the limit of a file of this policy"):
        policy.load(path)


def test_exceptions_have_no_escape_sequences_of_foreign_files(tmp_path):
    escape = chr(27) + "]0;name" + chr(7)
    scene = tmp_path / "scene.toml"
    for lines in (
        ['field = "\\u001b]0;name\\u0007"'],
        ['"\\u001b]0;name\\u0007" = 1'],
        ['initial_policy = "\\u001b]0;name\\u0007"'],
        [f"[x{escape}"],
    ):
        scene.write_text("\n".join(['scene = 1', 'task = "cart_pole"', *lines]))
        with pytest.raises(Exception) as error:
            pg.Run(pg.task(scene), epochs=1)
        assert chr(27) not in str(error.value) and chr(7) not in str(error.value)
        assert "u{1b}" in str(error.value) or "u001b" in str(error.value), str(error.value)
    name, pendulum = chr(27) + "[2J", pg.task("pendulum", horizon=3)
    for call in (
        lambda: pg.gradients(pendulum, pg.Policy(pendulum), pendulum.starts(1), fields=[name]),
        lambda: pg.accuracy(pendulum, metric=name),
        lambda: pg.task("pendulum", effects={name: None}),
        lambda: pg.task("pendulum", **{name: None}),
        lambda: pg.gym.make("pendulum", bound=1.0).reset(options={name: 1}),
    ):
        with pytest.raises((ValueError, TypeError)) as error:
            call()
        assert chr(27) not in str(error.value), str(error.value)
    task, path = pg.task("pendulum"), tmp_path / "policy.safetensors"
    pg.Policy(task).save(path)
    header, (name, forged) = path.read_bytes(), (b"layer1.kernel", b"\\u001b[31mred[")
    assert name in header
    size = int.from_bytes(header[:8], "little")
    text = header[8 : 8 + size].replace(b'"' + name + b'"', b'"' + forged + b'"')
    path.write_bytes(len(text).to_bytes(8, "little") + text + header[8 + size :])
    with pytest.raises(ValueError) as error:
        pg.Policy(task).load(path)
    assert chr(27) not in str(error.value) and "u{1b}[31mred" in str(error.value), str(error.value)
    with pytest.raises(Exception) as error:
        pg.Policy(task).load(tmp_path / f"{escape}.safetensors")
    assert chr(27) not in str(error.value)


def test_settings_that_the_field_does_not_read_are_refused():
    for field, setting in [("S", {"discount": 0.5}), ("M", {"control": 0.5}), ("R", {"average": 0.5})]:
        with pytest.raises(ValueError, match=f"`training.{next(iter(setting))}` is 0.5, but has no effect"):
            pg.train(small(), field=field, epochs=1, **FAST, **setting)


def test_saving_in_a_folder_with_another_run_keeps_both(tmp_path, monkeypatch):
    runs = [pg.train(small(), field="C", epochs=1, seed=seed, **FAST) for seed in (1, 2)]
    for run in (runs[0], runs[1], runs[0], runs[0]):
        run.save(tmp_path / "run")
    kept = sorted(path.name for path in tmp_path.iterdir())
    assert kept == ["run", "run.previous-1", "run.previous-2"]
    saved = [pg.Run.load(tmp_path / name).policy.theta for name in kept]
    for found, expected in zip(saved, (runs[0], runs[0], runs[1])):
        assert np.array_equal(found, expected.policy.theta)
    # `save` stores the absolute path. A later change of the current folder does not affect it.
    monkeypatch.chdir(tmp_path)
    runs[1].save("other")
    monkeypatch.chdir(tmp_path.parent)
    assert os.path.samefile(runs[1].folder, tmp_path / "other")


def test_exceptions_of_callbacks_stop_the_run_and_it_continues():
    task, seen = pg.task("cart_pole", poles=1), []

    def callback(record):
        seen.append(record["epoch"])
        if len(seen) == 2:
            raise KeyError("stop")

    run = pg.Run(task, epochs=4, seed=1, **FAST)
    with pytest.raises(KeyError):
        run.train(callback)
    run.train()
    whole = pg.train(task, epochs=4, seed=1, **FAST)
    assert seen == [1, 2] and np.array_equal(run.policy.theta, whole.policy.theta)


INTERRUPTED = """
import os, signal, threading, physgrad as pg
# A shell ignores the signal in background processes.
signal.signal(signal.SIGINT, signal.default_int_handler)
threading.Timer(1.0, lambda: os.kill(os.getpid(), signal.SIGINT)).start()
try:
    pg.train(pg.task("cart_pole"), epochs=100000, seed=1)
except KeyboardInterrupt as error:
    run = error.run
    done = len(run.history["epoch"])
    run.train(epochs=done + 1)
    print("continued", len(run.history["epoch"]) == done + 1)
"""


def test_ctrl_c_raises_keyboard_interrupt_and_the_run_continues():
    done = subprocess.run([sys.executable, "-c", INTERRUPTED], capture_output=True, text=True, timeout=120)
    assert done.stdout == "continued True\n", done.stderr


def test_other_threads_run_during_a_training():
    count, stop = 0, threading.Event()

    def counting():
        nonlocal count
        while not stop.is_set():
            count += 1
            time.sleep(0.001)

    thread = threading.Thread(target=counting)
    thread.start()
    pg.train(pg.task("cart_pole"), epochs=1, seed=1, train_samples=64, test_samples=64)
    stop.set()
    thread.join()
    assert count > 3


def test_divergence_has_its_place():
    task = pg.task("cart_pole", poles=1, horizon=200, dt=10.0)
    policy = pg.Mlp(task, [8], seed=1, zero_init_output=False)
    policy.theta = policy.theta * 1e30
    with pytest.raises(pg.Divergence, match="not finite") as caught:
        pg.rollout(task, policy, task.starts(4))
    error = caught.value
    assert error.variable in ("state", "control", "cost") and 0 <= error.sample < 4


def test_plans_lower_the_cost_and_respect_bounds():
    task = pg.task("cart_pole", poles=1, horizon=30)
    plan = pg.optimize(task, task.starts(1, seed=2)[0], bounds=[[-5, 5]], iterations=30)
    assert plan.cost < plan.costs[0] and abs(plan.u).max() <= 5
    assert plan.x.shape == (31, 4) and plan.u.shape == (30, 1) and plan.gains.shape == (30, 1, 4)


def test_memory_does_not_grow():
    resource = pytest.importorskip("resource")
    task = pg.task("cart_pole")
    x = task.starts(1024)
    u = np.zeros((1024, task.control_dim), "f4")
    for _ in range(50):
        task.step_vjp(x, u, x)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    for _ in range(500):
        task.step_vjp(x, u, x)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 5000


def test_only_a_training_advises_on_the_learning_rate():
    task = pg.task("cart_pole", poles=1, dt=5.0, horizon=60, effects={"bumpers": {}})
    policy = pg.Policy(task, seed=1, zero_init_output=False)
    with pytest.raises(AssertionError, match="Reduce the time step(\n|$)") as failed:
        pg.check(task)
    with pytest.raises(pg.Divergence, match="Reduce the time step$"):
        pg.losses(task, policy, task.starts(64))
    assert "learning rate" not in str(failed.value)
    with pytest.raises(pg.Divergence, match=r"Reduce the time step or the learning rate\)"):
        pg.train(task, policy, epochs=1)


def test_parameters_keep_their_meaning_in_other_tasks(tmp_path):
    task = pg.task("cart_pole", poles=1, horizon=10, precision="f64")
    integral = {
        "control": {"force": "-k * sum"},
        "next": {"sum": "sum + dt * x"},
        "parameters": {"k": {"start": 1.5, "max": 9.0, "min": 0.0}},
    }
    policy = pg.Policy(task, kind="equations", **integral)
    starts = task.starts(5)
    # The time step of a controller is that of the task in which it runs.
    slow = task.replace(dt=0.2)
    again = pg.Policy(slow, kind="equations", **integral)
    np.testing.assert_array_equal(pg.losses(slow, policy, starts), pg.losses(slow, again, starts))
    assert (pg.losses(slow, policy, starts) != pg.losses(task, policy, starts)).all()
    # Other bounds of a trained gain would change its value.
    policy.save(tmp_path / "policy.safetensors")
    integral["parameters"]["k"]["max"] = 50.0
    other = pg.Policy(task, kind="equations", **integral)
    with pytest.raises(ValueError, match="`parameters.k.max` is 9.0, but 50.0 in the scene"):
        other.load(tmp_path / "policy.safetensors")
    # A sequence of controls has the horizon of its task.
    sequence = pg.Policy(task, kind="open_loop")
    with pytest.raises(ValueError, match="10 parameters, but needs 30"):
        pg.losses(task.replace(horizon=30), sequence, starts)
    # Another kind drops the settings of the kind before it.
    gru = task.replace(policy={"kind": "gru", "units": 3})
    assert "linear" in repr(pg.Policy(gru, kind="linear"))


def test_gradients_that_are_not_finite_are_an_error():
    task = pg.task("cart_pole", poles=1, horizon=5)
    policy = pg.Policy(task, kind="equations", control={"force": "sqrt(a) * x"}, parameters={"a": {"start": 0.0}})
    with pytest.raises(pg.Divergence):
        pg.gradients(task, policy, task.starts(3), ["R"])


def test_a_policy_has_the_values_of_its_trained_numbers():
    task = pg.task("cart_pole", poles=1, horizon=20, fit={"pole_mass": pg.trained(0.2, 0.1, 0.5)})
    gains = {"kp": {"start": 2.0, "min": 0.0, "max": 10.0}, "kd": {"start": -1.0}, "fixed": 3.0}
    policy = pg.Policy(task, kind="equations", control={"force": "kp * theta_1 + kd * omega_1 + fixed"}, parameters=gains)
    expected = {"system.pole_mass": 0.2, "policy.parameters.kd": -1.0, "policy.parameters.kp": 2.0}
    assert policy.numbers.keys() == expected.keys()
    assert policy.numbers == pytest.approx(expected, rel=1e-6)
    policy.theta = policy.theta + 100.0
    assert policy.numbers["policy.parameters.kp"] == pytest.approx(10.0)
    assert policy.numbers["system.pole_mass"] == pytest.approx(0.5)
    assert pg.Mlp(pg.task("cart_pole"), [4]).numbers == {}
