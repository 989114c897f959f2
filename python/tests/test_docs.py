"""Runs the Python code of the guide, in one namespace."""

import os
import re
from pathlib import Path

import pytest

PAGE = Path(__file__).parents[2] / "docs" / "python.md"


def test_code_of_the_guide_runs(tmp_path, monkeypatch):
    if not PAGE.exists():
        pytest.skip("the guide is not beside the package")
    monkeypatch.chdir(tmp_path)
    blocks = re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.DOTALL)
    assert len(blocks) >= 6
    names = {}
    for block in blocks:
        exec(compile(block, str(PAGE), "exec"), names)
    assert os.path.exists("report.html") and os.path.exists("policy.safetensors")
