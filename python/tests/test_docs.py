"""Runs the code of the pages about Python."""

import os
import re
from pathlib import Path

import pytest

DOCS = Path(__file__).parents[2] / "docs"


def run(page):
    """Runs the code of a page in one namespace, and returns its names."""
    if not DOCS.exists():
        pytest.skip("the guide is not beside the package")
    text = (DOCS / page).read_text(encoding="utf-8")
    blocks = re.findall(r"^```python\n(.*?)^```$", text, re.DOTALL | re.MULTILINE)
    assert len(blocks) >= 4
    names: dict = {}
    for block in blocks:
        exec(compile(block, page, "exec"), names)
    return names


def test_code_of_the_guide_runs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    run("python.md")
    assert os.path.exists("report.html") and os.path.exists("policy.safetensors")


def test_code_of_the_frameworks_runs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for package in ("torch", "jax", "gymnasium", "moviepy", "stable_baselines3"):
        pytest.importorskip(package, reason=f"{package} is not installed")
    names = run("frameworks.md")
    assert [loss.grad is not None for loss in names["network"].parameters()] == [True] * 4
    assert names["gradients"].shape == (64, 4) and names["observations"].shape == (16, 4)
