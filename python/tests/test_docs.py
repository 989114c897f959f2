"""Runs the code of the pages about Python."""

import os
import re
from pathlib import Path

import numpy as np
import pytest

DOCS = Path(__file__).parents[2] / "docs"
# Libraries that a program of the guide imports in its first line, and that need not be installed.
OTHERS = ["casadi", "gymnasium", "jax"]


def programs(page):
    """The programs of a page, in order."""
    if not DOCS.exists():
        pytest.skip("the guide is not beside the package")
    text = (DOCS / page).read_text(encoding="utf-8")
    return re.findall(r"^```python\n(.*?)^```$", text, re.DOTALL | re.MULTILINE)


def run(page, blocks):
    """Runs programs of a page in one namespace, and returns its names."""
    names: dict = {}
    for block in blocks:
        exec(compile(block, page, "exec"), names)
    return names


def of_another_library(block):
    return block.split("\n")[0].removeprefix("import ") in OTHERS


def test_code_of_the_guide_runs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    blocks = programs("python.md")
    assert len(blocks) >= 4
    run("python.md", [block for block in blocks if not of_another_library(block)])
    assert os.path.exists("report.html") and os.path.exists("policy.safetensors")


@pytest.mark.parametrize("package", OTHERS)
def test_code_of_the_guide_beside_other_libraries_runs(package):
    (block,) = [block for block in programs("python.md") if block.startswith(f"import {package}\n")]
    pytest.importorskip(package, reason=f"{package} is not installed")
    names = run("python.md", ["import physgrad as pg", block])
    if package == "jax":
        assert names["uphill"].shape == (16, 20, 6) and np.abs(names["uphill"]).min() > 0
    elif package == "gymnasium":
        assert names["observation"].shape == (17,) and names["env"].unwrapped.task.horizon == 1000
    else:
        state = np.array([[0.3, -0.2]])
        rate = (names["swing"].step(state, np.array([[0.5]]))[0] - state[0]) / 0.1
        assert np.allclose(rate, [-0.2, 0.5 - np.sin(0.3)], atol=0.05)


def test_code_of_the_frameworks_runs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for package in ("torch", "jax", "gymnasium", "moviepy", "stable_baselines3"):
        pytest.importorskip(package, reason=f"{package} is not installed")
    names = run("frameworks.md", programs("frameworks.md"))
    assert [loss.grad is not None for loss in names["network"].parameters()] == [True] * 4
    assert names["gradients"].shape == (64, 4) and names["observations"].shape == (16, 4)
