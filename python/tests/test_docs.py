"""Runs the code of ``docs/python.md``, in one namespace for each of its two parts."""

import os
import re
from pathlib import Path

import pytest

PAGE = Path(__file__).parents[2] / "docs" / "python.md"
FRAMEWORKS = "## PyTorch, JAX and Gymnasium\n"


def run(part):
    """Runs the code of the part before (0) or after (1) the heading of the frameworks."""
    if not PAGE.exists():
        pytest.skip("the guide is not beside the package")
    text = PAGE.read_text(encoding="utf-8").split(FRAMEWORKS)
    assert len(text) == 2, "the heading of the frameworks does not occur once"
    blocks = re.findall(r"^```python\n(.*?)^```$", text[part], re.DOTALL | re.MULTILINE)
    assert len(blocks) >= 4
    names: dict = {}
    for block in blocks:
        exec(compile(block, PAGE.name, "exec"), names)
    return names


def test_code_of_the_guide_runs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    run(0)
    assert os.path.exists("report.html") and os.path.exists("policy.safetensors")


def test_code_of_the_frameworks_runs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for package in ("torch", "jax", "gymnasium", "moviepy", "stable_baselines3"):
        pytest.importorskip(package, reason=f"{package} is not installed")
    names = run(1)
    assert [loss.grad is not None for loss in names["network"].parameters()] == [True] * 4
    assert names["gradients"].shape == (64, 4) and names["observations"].shape == (16, 4)
