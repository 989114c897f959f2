"""What completion, notebooks, `help` and terminals show, and when a training stops."""

import inspect
import os
import re
import struct
import subprocess
import sys
import xml.etree.ElementTree as ElementTree

import numpy as np
import physgrad as pg
import pytest
from physgrad import _notebook, _progress, _types

FAST = {"train_samples": 4, "test_samples": 4}


def small(**settings):
    return pg.task("cart_pole", poles=1, horizon=5, **settings)


def test_completion_shows_the_modules_of_frameworks_and_all_names():
    names = dir(pg)
    assert {"torch", "jax", "gym", "train", "__version__"} <= set(names) and set(pg.__all__) <= set(names)
    ran = subprocess.run(
        [sys.executable, "-c", "from physgrad import *; import sys; print('torch' in sys.modules)"],
        capture_output=True,
        text=True,
    )
    assert ran.stdout == "False\n", "an import of all names imports the frameworks"
    completer = pytest.importorskip("IPython.core.completer", reason="IPython is not installed")
    shell = completer.IPCompleter(shell=None, namespace={"pg": pg}, global_namespace={})
    shell.use_jedi = False
    found = shell.complete("pg.t")[1]
    assert {"pg.torch", "pg.task", "pg.train"} <= {
        text if text.startswith("pg") else f"pg{text}" for text in found
    }


def test_help_has_shapes_and_arguments():
    array_methods = [
        name for name in dir(pg.Task) if name.split("_")[0] in ("step", "observe", "running", "terminal")
    ]
    for method in [getattr(pg.Task, name) for name in array_methods if "cost" in name or "step" in name]:
        assert re.search(r"\(B,", method.__doc__), method
    for name in pg.__all__:
        assert getattr(pg, name).__doc__, name
    for function in (pg.task, pg.train, pg.system, pg.rollout, pg.gradients):
        assert str(inspect.signature(function)) != "(*args, **kwargs)"


def test_annotations_have_all_settings_of_a_training():
    with pytest.raises(ValueError) as error:
        pg.train(small(), unknown_setting=1)
    allowed = set(re.findall(r"`(\w+)`", str(error.value).split("allowed:")[1].split(";")[0]))
    assert allowed == set(_types.TrainingSettings.__annotations__)
    top = set(_types.RunSettings.__annotations__) - allowed
    with pytest.raises(ValueError) as error:
        small(settings={"unknown": 1})
    known = set(re.findall(r"`(\w+)`", str(error.value).split("allowed:")[1].split(";")[0]))
    assert top - {"settings", "vary", "fit"} == known - {
        "scene",
        "physgrad",
        "task",
        "initial_policy",
        "policy",
    }


def html(value):
    """The page of a notebook as a tree, which must be well-formed."""
    return ElementTree.fromstring(f"<div>{value._repr_html_()}</div>")


def cells(tree):
    return {row[0].text: row[1].text for row in tree.iter("tr")}


def test_notebooks_show_tables_and_curves():
    task = small(
        effects={"steady_wind": {"speed": 1.5}},
        cart_mass=pg.uniform(0.5, 1.5),
        actuator={"limit": {"bound": 9.0}},
    )
    found = cells(html(task))
    assert found["states"] == "4: x, x_dot, theta_1, omega_1" and found["horizon"].startswith(
        "5 steps of 0.01"
    )
    assert "steady_wind (speed 1.5" in found["effects"] and "limit (bound 9" in found["actuator"]
    assert "cart_mass uniform [0.5, 1.5]" in found["system"] and found["parameters"] == "1: system.cart_mass"
    policy = pg.Mlp(task, [7, 5])
    found = cells(html(policy))
    assert (
        found["parameters"] == str(len(policy))
        and found["widths"] == "[7, 5]"
        and found["task"] == "cart_pole"
    )
    run = pg.Run(task, policy, epochs=2, seed=3, **FAST)
    assert cells(html(run))["epochs"] == "0 of 2" and not list(
        html(run).iter("{http://www.w3.org/2000/svg}svg")
    )
    run.train()
    tree = html(run)
    assert (
        cells(tree)["test loss"].startswith(f"{run.history['test_loss'][-1]:.4g}")
        and cells(tree)["seed"] == "3"
    )
    (chart,) = tree.iter("{http://www.w3.org/2000/svg}svg")
    curves = [line.get("stroke") for line in chart.iter() if line.tag.endswith(("path", "polyline"))]
    assert len(list(chart.iter())) > 20 and set(_notebook.CURVES.values()) <= set(curves)


def test_notebooks_escape_text_and_leave_out_expressions():
    own = pg.system(
        lambda x, u, p: [u.push - p.k * x.a], states=["a"], controls=["push"], dt=0.1, params={"k": 2.0}
    )
    assert cells(html(own))["system"] == "k 2"
    law = "where(a < 1, 1, 0)"
    policy = pg.Policy(own, kind="equations", control={"push": law})
    assert cells(html(policy))["control"] == f"push {law}"


def test_a_callback_that_returns_false_stops_after_its_epoch_and_the_run_continues(tmp_path):
    task, seen = small(), []

    def callback(record):
        seen.append(record["epoch"])
        return record["epoch"] < 2

    run = pg.train(task, callback=callback, epochs=4, seed=1, out=tmp_path / "run", **FAST)
    assert seen == [1, 2] and not run.is_done and len(run.history["epoch"]) == 2
    assert len(pg.load(tmp_path / "run").history["epoch"]) == 2
    run.train()
    whole = pg.train(task, epochs=4, seed=1, **FAST)
    assert run.is_done and np.array_equal(run.policy.theta, whole.policy.theta)
    # Other false values do not stop: functions without a result return None.
    for result in (None, 0, "", [], True):
        assert pg.train(task, callback=lambda _, result=result: result, epochs=2, **FAST).is_done
    assert not pg.train(task, callback=lambda _: np.False_, epochs=2, **FAST).is_done


TERMINAL = """
import sys
import physgrad as pg
{}
pg.train(pg.task("cart_pole", poles=1, horizon=5), epochs=3, train_samples=4, test_samples=4, {})
"""


def on_terminal(before="", arguments=""):
    """What a training writes to standard error if it is a terminal."""
    pty = pytest.importorskip("pty", reason="the system has no terminals of this kind")
    import fcntl
    import termios

    parent, child = pty.openpty()
    # 24 rows of 100 columns.
    fcntl.ioctl(child, termios.TIOCSWINSZ, struct.pack("HHHH", 24, 100, 0, 0))
    code = TERMINAL.format(before, arguments)
    subprocess.run(
        [sys.executable, "-c", code], stderr=child, stdout=subprocess.DEVNULL, check=True, timeout=120
    )
    os.close(child)
    text = b""
    try:
        while chunk := os.read(parent, 65536):
            text += chunk
    except OSError:
        # The end of the text of a closed terminal.
        pass
    os.close(parent)
    return text.decode()


IN_A_THREAD = """
from concurrent.futures import ThreadPoolExecutor
train = pg.train
pg.train = lambda *a, **k: ThreadPoolExecutor(1).submit(train, *a, **k).result()
"""
WITHOUT_TQDM = "sys.modules['tqdm'] = sys.modules['tqdm.auto'] = None"


@pytest.mark.skipif(sys.platform == "win32", reason="the system has no terminals of this kind")
def test_a_terminal_shows_the_progress():
    text = on_terminal(WITHOUT_TQDM)
    assert "\repoch 1/3, test loss " in text and re.search(
        r"\repoch 3/3, test loss \S+, 0 s *\r?\n$", text
    ), repr(text)
    assert on_terminal(WITHOUT_TQDM, "progress=False") == ""
    # Several threads would write over each other.
    assert on_terminal(f"{WITHOUT_TQDM}\n{IN_A_THREAD}") == ""


@pytest.mark.skipif(sys.platform == "win32", reason="the system has no terminals of this kind")
def test_tqdm_shows_the_progress_if_it_is_installed():
    pytest.importorskip("tqdm", reason="tqdm is not installed")
    text = on_terminal()
    assert "3/3" in text and "test loss" in text and "%|" in text, repr(text)


def test_without_a_terminal_there_is_no_progress_unless_it_is_asked_for(capfd, monkeypatch):
    pg.train(small(), epochs=2, **FAST)
    assert capfd.readouterr().err == ""
    monkeypatch.setitem(sys.modules, "tqdm.auto", None)
    seen = []
    pg.train(small(), epochs=2, progress=True, callback=lambda record: seen.append(record["epoch"]), **FAST)
    assert "epoch 2/2" in capfd.readouterr().err and seen == [1, 2]
    assert not pg.train(small(), epochs=2, progress=True, callback=lambda _: False, **FAST).is_done


def test_a_line_covers_a_longer_one(capfd):
    line = _progress.Line(10)
    line.set_postfix_str("test loss 123456")
    line.show("")
    line.set_postfix_str("test loss 1")
    line.close()
    first, second = capfd.readouterr().err.split("\r")[1:]
    assert len(second.rstrip("\n")) == len(first)
