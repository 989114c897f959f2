"""Runs the code of ``docs/python_frameworks.md``."""

import re
from pathlib import Path

import pytest

PAGE = Path(__file__).parents[2] / "docs" / "python_frameworks.md"


def test_code_of_the_page_runs(capsys):
    for package in ("torch", "jax", "gymnasium"):
        pytest.importorskip(package, reason=f"{package} is not installed")
    blocks = re.findall(r"^```python\n(.*?)^```$", PAGE.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE)
    assert len(blocks) == 4
    names: dict = {}
    for block in blocks:
        exec(compile(block, PAGE.name, "exec"), names)
    assert [loss.grad is not None for loss in names["network"].parameters()] == [True] * 4
    assert names["gradients"].shape == (64, 4) and names["observations"].shape == (16, 4)
