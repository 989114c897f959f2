"""Runs every example with ``--quick``."""

import importlib.util
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

EXAMPLES = Path(__file__).parents[1] / "examples"
# Packages besides NumPy.
NEEDS = {
    "first_hour": [],
    "which_field": ["matplotlib"],
    "own_network_torch": ["torch"],
    "own_system": [],
    "ppo_beside_c": ["stable_baselines3", "gymnasium", "matplotlib"],
    "sim_to_sim": ["gymnasium", "mujoco"],
    "speed": [],
    "speed_of_frameworks": [],
    "speed_of_graphs": [],
    "speed_of_small_systems": ["jax"],
}
slow = pytest.mark.skipif(os.environ.get("PHYSGRAD_PYTHON_ALL") != "1", reason="takes minutes; set PHYSGRAD_PYTHON_ALL=1")


def test_all_examples_are_listed():
    assert sorted(NEEDS) == sorted(path.stem for path in EXAMPLES.glob("*.py"))


@pytest.mark.parametrize("name", NEEDS)
def test_examples_run(name, tmp_path):
    for package in NEEDS[name]:
        pytest.importorskip(package, reason=f"{package} is not installed")
    # Does not treat warnings as errors: other packages emit them.
    command = [sys.executable, EXAMPLES / f"{name}.py", "--quick"]
    ran = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, timeout=600)
    assert ran.returncode == 0, ran.stderr
    pictures = [line.split(": ")[1] for line in ran.stdout.splitlines() if line.startswith("picture: ")]
    assert all((tmp_path / picture).stat().st_size > 1000 for picture in pictures)
    assert ran.stdout


def loaded(name):
    """An example as a module, of which nothing has run."""
    spec = importlib.util.spec_from_file_location(name, EXAMPLES / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize(
    ("arguments", "trainings", "lengths", "episodes"),
    [
        (["half_cheetah"], [{"epochs": 60, "seed": 0}], [32, 128, 1000], 10),
        (["hopper", "--seed", "3"], [{"epochs": 60, "seed": 3}], [64, 256, 1000], 10),
        (["--quick"], [{"epochs": 2, "seed": 0}], [32], 2),
    ],
)
def test_a_robot_is_trained_as_long_as_its_preset_says(monkeypatch, capsys, arguments, trainings, lengths, episodes):
    """Runs the whole example, with trainings of one epoch and without the episodes of MuJoCo."""
    import physgrad as pg

    example, train, asked, evaluated = loaded("sim_to_sim"), pg.train, [], []

    def one_epoch(task, *, epochs, seed, progress):
        asked.append({"epochs": epochs, "seed": seed})
        return train(task, epochs=1, seed=seed, progress=progress)

    def evaluate(policy, name, inputs, steps, episodes):
        assert policy(np.zeros((1, inputs))).shape[0] == 1
        evaluated.append((steps, episodes))
        return np.zeros(episodes), np.zeros(episodes)

    monkeypatch.setattr(example.pg, "train", one_epoch)
    monkeypatch.setattr(example, "evaluate", evaluate)
    monkeypatch.setattr(sys, "argv", ["sim_to_sim.py", *arguments])
    example.main()
    assert asked == trainings
    assert evaluated == [(steps, episodes) for steps in lengths] * 2, "for the last and the best policy"
    assert capsys.readouterr().out.count("with the contacts of the file") == 2


@pytest.mark.parametrize("name", ["guidance", "multi_pendulum", "pole_chain", "quadrotor"])
def test_own_systems_run(name, tmp_path):
    command = [sys.executable, EXAMPLES / "own_system.py", name, "--quick"]
    ran = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, timeout=600)
    assert ran.returncode == 0, ran.stderr
    assert name == "quadrotor" or "after one step: 0.0e+00" in ran.stdout


@slow
def test_ppo_learns_one_pole():
    """PPO reaches a loss below 0.5. Without control, the loss is 1.9."""
    pytest.importorskip("stable_baselines3", reason="stable-baselines3 is not installed")
    import physgrad as pg

    curve = loaded("ppo_beside_c").train_ppo(pg.task("cart_pole", poles=1), seconds=600.0, steps=2_000_000)
    assert min(loss for _, loss in curve) < 0.5
