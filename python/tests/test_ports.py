"""The systems in NumPy of `examples/systems` have the bits of the same systems in Rust."""

import importlib
import json
import sys
from pathlib import Path

import numpy as np
import pytest

pg = pytest.importorskip("physgrad", reason="needs the compiled module")
if not hasattr(pg, "Task"):
    pytest.skip("needs the compiled module", allow_module_level=True)

sys.path.insert(0, str(Path(__file__).parents[1] / "examples"))
PORTS = ["cart_pole", "guidance", "multi_pendulum", "pole_chain"]
PRECISIONS = {"f32": "float32", "f64": "float64"}


def port_of(name, **settings):
    return importlib.import_module(f"systems.{name}").make(**settings)


def both(name, **settings):
    """The system in NumPy, and the built-in task."""
    kind, own = importlib.import_module(f"systems.{name}").BUILT_IN
    return port_of(name, **settings), pg.task(kind, **own, **settings)


def inputs(task, dtype="float64", count=200):
    """States of the task and around them, controls, and cotangents."""
    rng = np.random.default_rng(7)
    x = task.starts(count, seed=3, dtype="float64")
    x = x + rng.normal(size=x.shape) * rng.choice([0.0, 0.1, 2.0], (count, 1))
    low, high = np.transpose(task.control_bounds)
    values = x, rng.uniform(low, high, (count, task.control_dim)), rng.normal(size=x.shape)
    return [value.astype(dtype) for value in values]


def test_all_systems_are_listed():
    files = {path.stem for path in (Path(__file__).parents[1] / "examples" / "systems").glob("*.py")}
    assert files == {*PORTS, "quadrotor", "elimination"}


@pytest.mark.parametrize("dtype", PRECISIONS.values())
@pytest.mark.parametrize("name", PORTS)
def test_steps_and_costs_have_the_bits_of_the_task(name, dtype):
    port, task = both(name)
    x, u, _ = inputs(task, dtype)
    next = task.step(x, u)
    assert np.array_equal(port.step(x, u), next)
    assert np.array_equal(port.running_cost(x, u, next), task.running_cost(x, u, next))
    assert np.array_equal(port.terminal_cost(x), task.terminal_cost(x))


def test_the_comparison_of_bits_notices_a_constant_that_differs_in_the_last_bit(monkeypatch):
    system = importlib.import_module("systems.cart_pole")
    monkeypatch.setattr(system, "MOMENT", system.MOMENT * (1 + 2**-52))
    with pytest.raises(AssertionError):
        test_steps_and_costs_have_the_bits_of_the_task("cart_pole", "float64")


@pytest.mark.parametrize("name", PORTS)
def test_derivatives_agree_with_those_by_hand_to_1e_14(name):
    port, task = both(name)
    x, u, bars = inputs(task)
    ones, next = np.ones(len(x)), task.step(x, u)
    calls = [
        lambda task: task.step_vjp(x, u, bars),
        lambda task: task.running_cost_vjp(x, u, next, ones),
        lambda task: task.terminal_cost_vjp(x, ones),
    ]
    for call in calls:
        for found, expected in zip(call(port), call(task), strict=True):
            # The cotangent of a single control is a sum that may cancel. A row may then have a larger
            # relative error, up to 4e-14, so errors are relative to the largest component of all rows.
            if expected.size and np.any(expected):
                assert relative(found, expected) <= 1e-14
            else:
                assert not np.any(found)


def relative(a, b):
    """The largest difference, relative to the largest component."""
    return np.abs(a - b).max() / np.abs(b).max()


def digits(losses):
    return [f"{loss:.4f}" for loss in losses]


def trained(task, change=0.0):
    """Test losses of ten epochs, from parameters that are changed by a relative number."""
    policy = pg.Mlp(task, [32, 32], seed=1)
    policy.theta = policy.theta * (1 + change)
    options = {"epochs": 10, "seed": 1, "train_samples": 64, "test_samples": 64}
    return digits(pg.train(task, policy, field="C", **options).history["test_loss"])


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("name", ["cart_pole", "multi_pendulum", "pole_chain"])
def test_trainings_print_the_digits_of_the_task(name, precision):
    port, task = both(name, precision=precision)
    found, expected = trained(port), trained(task)
    # The training of three arms amplifies rounding errors: in f32, those of two orders of adding
    # cotangents reach the printed digits after four epochs, as do those of the parameters.
    count = 4 if (name, precision) == ("multi_pendulum", "f32") else 10
    assert found[:count] == expected[:count]
    if count == 4:
        changed = trained(task, 2.0**-23)
        assert changed[:4] == expected[:4] and changed != expected


@pytest.mark.parametrize("precision", PRECISIONS)
def test_a_training_by_adam_of_the_port_of_guidance_prints_the_digits_of_the_task(precision):
    """The distribution of initial states of the task has no form in `start`, so both have its states."""

    def losses(task, starts):
        policy = pg.Mlp(task, [32, 32], seed=1)
        first, second, found = 0.0, 0.0, []
        for update in range(1, 81):
            batch = starts[8 * (update - 1) % 64 :][:8]
            gradient = pg.gradients(task, policy, batch, fields=["C"])["C"].astype(float)
            first = 0.9 * first + 0.1 * gradient
            second = 0.999 * second + 0.001 * gradient**2
            size = np.sqrt(second / (1 - 0.999**update)) + 1e-8
            policy.theta = policy.theta - 1e-3 * first / (1 - 0.9**update) / size
            if update % 8 == 0:
                found.append(pg.losses(task, policy, starts).mean())
        return digits(found)

    port, task = both("guidance", precision=precision)
    starts = task.starts(64, seed=1, dtype=PRECISIONS[precision])
    found = losses(port, starts)
    assert found == losses(task, starts) and len(set(found)) == 10


def numbers(text, dtype):
    return np.frombuffer(bytes.fromhex(text), dtype).astype(dtype[1:])


def test_the_quadrotor_has_the_numbers_of_the_example_in_rust():
    """The program has no such task; `tests/ports.rs` keeps its numbers up to date."""
    stored = json.loads((Path(__file__).parent / "quadrotor.json").read_text(encoding="utf-8"))
    port = port_of("quadrotor")
    x, u, next, bars, x_bar, u_bar = (
        np.array([numbers(row[key], ">f8") for row in stored["steps"]])
        for key in ("x", "u", "next", "bar", "x_bar", "u_bar")
    )
    next_f32 = np.array([numbers(row["next_f32"], ">f4") for row in stored["steps"]])
    assert np.array_equal(port.step(x, u), next)
    assert np.array_equal(port.step(x.astype("f4"), u.astype("f4")), next_f32)
    found = port.step_vjp(x, u, bars)
    assert max(relative(found[0], x_bar), relative(found[1], u_bar)) <= 1e-14
    for precision in PRECISIONS:
        assert trained(port_of("quadrotor", precision=precision)) == stored["losses"][precision]
