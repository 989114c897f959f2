"""Checkers of types accept a correct script of a user, and find its mistakes."""

import importlib.util
import re
import subprocess
import sys
from pathlib import Path

import pytest
import typed_script

SCRIPT = Path(__file__).with_name("typed_script.py")
HEAD = """
import numpy as np
import physgrad as pg
task = pg.task("cart_pole", poles=1)
policy = pg.Mlp(task, [8])
run = pg.train(task, epochs=1)
starts, u = task.starts(2), np.zeros((2, 1))
"""
MISTAKES = [
    "task.state_dims",
    'task.starts("4")',
    'task.starts(4, split="tests")',
    "task.step(starts)",
    "task.step(starts, u, time=3)",
    "count: int = task.observe(starts)",
    "pg.task(3, poles=1)",
    'pg.task("cart_pole", horizon="5")',
    'pg.task("cart_pole", precision="float32")',
    'task.replace(effects=["bumpers"])',
    "pg.Mlp(task, widths=32)",
    'pg.Mlp("cart_pole", [32])',
    "pg.rollout(task, starts, policy)",
    'pg.gradients(task, policy, starts, fields="C")',
    'pg.gradients(task, policy, starts, fields=["X"])',
    "pg.train(task, learning_rat=0.1)",
    'pg.train(task, field="X")',
    'pg.train(task, epochs="3")',
    "pg.train(task, policy, callback=3)",
    'pg.train(task, optimizer="sdg")',
    "run.history.test_loss",
    "run.train(epoch=4)",
    "run.policy.thetas",
    "folder: str = run.folder",
    "pg.load(3)",
    'pg.uniform("a", 1)',
    "pg.system(lambda x, u: x, states=1, controls=1)",
    "pg.system(lambda x, u: x, states=1.5, controls=1, dt=0.1)",
    "pg.tasks",
]
CHECKERS = {
    "mypy": ["--strict", "--python-executable", sys.executable, "--cache-dir"],
    "pyright": ["--pythonpath", sys.executable],
}


def lines_with_errors(checker, path, tmp_path):
    """Numbers of the lines of a script in which a checker finds an error, and its output."""
    if importlib.util.find_spec(checker) is None:
        pytest.skip(f"{checker} is not installed")
    options = [*CHECKERS[checker], *([tmp_path / "cache"] if checker == "mypy" else [])]
    ran = subprocess.run(
        [sys.executable, "-m", checker, *options, path],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        timeout=600,
    )
    if checker == "pyright" and "error" not in ran.stdout:
        pytest.skip(f"pyright cannot run: {ran.stdout}{ran.stderr}"[:500])
    found = re.findall(rf"{re.escape(path.name)}:(\d+)(?::\d+)?(?: -)?:? error", ran.stdout)
    return {int(line) for line in found}, ran.stdout + ran.stderr


@pytest.mark.parametrize("checker", CHECKERS)
def test_a_correct_script_is_accepted(checker, tmp_path):
    found, output = lines_with_errors(checker, SCRIPT, tmp_path)
    assert not found and ("0 errors" in output or "no issues found" in output), output


@pytest.mark.parametrize("checker", CHECKERS)
def test_every_mistake_is_found(checker, tmp_path):
    path = tmp_path / "mistakes.py"
    path.write_text(HEAD + "\n".join(MISTAKES) + "\n")
    found, output = lines_with_errors(checker, path, tmp_path)
    first = HEAD.count("\n") + 1
    missed = [mistake for line, mistake in enumerate(MISTAKES, first) if line not in found]
    assert not missed and min(found) >= first, f"{missed}\n{output}"


def test_the_script_runs(capsys):
    typed_script.main()
    assert "0.1.0" in capsys.readouterr().out
