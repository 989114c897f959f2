"""The notebook runs, and its numbers show what its text says."""

import re
from pathlib import Path

import pytest

nbclient = pytest.importorskip("nbclient", reason="nbclient is not installed")
nbformat = pytest.importorskip("nbformat", reason="nbformat is not installed")
pytest.importorskip("ipykernel", reason="ipykernel is not installed")
pytest.importorskip("matplotlib", reason="matplotlib is not installed")

PATH = Path(__file__).parents[1] / "examples" / "ten_minutes.ipynb"


def text(cell):
    """All outputs of a cell as text."""
    parts = []
    for output in cell.get("outputs", []):
        parts.append(output.get("text", ""))
        parts += [part for kind, part in output.get("data", {}).items() if kind.startswith("text/")]
    return "\n".join(parts)


def test_the_notebook_runs_and_shows_results(tmp_path):
    notebook = nbformat.read(PATH, as_version=4)
    client = nbclient.NotebookClient(notebook, timeout=600, resources={"metadata": {"path": str(tmp_path)}})
    client.execute()
    cells = [cell for cell in notebook.cells if cell.cell_type == "code"]
    outputs = [text(cell) for cell in cells]
    everything = "\n".join(outputs)
    assert "<table" in everything and "<svg" in everything, "tasks and runs show tables and curves"
    without, with_policy = (
        float(re.search(f"{label}:\\s+([0-9.]+)", everything)[1]) for label in ("without control", "of the policy")
    )
    assert with_policy < 0.5 * without
    policy, optimum = (float(re.search(f"{label}: ([0-9.]+)", everything)[1]) for label in ("policy", "optimum"))
    assert optimum <= policy
    assert re.search(r"rope\D*1\.[67]", everything) and re.search(r"friction\D*1\.[56]", everything), outputs[-1]
