"""Wrong calls: the class of the error, and a message that names the argument, its value and what is allowed."""

import re
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import physgrad as pg
import pytest


class Tensor:
    """What a NumPy function sees of a tensor of PyTorch."""

    __module__ = "torch"

    def __array__(self, dtype=None, copy=None):
        return np.zeros((2, 4))


class JVPTracer:
    """What a NumPy function sees of an array that JAX traces."""

    __module__ = "jax._src.interpreters.ad"

    def __array__(self, dtype=None, copy=None):
        raise TypeError("The numpy.ndarray conversion method __array__() was called on traced array")


@pytest.fixture(scope="module")
def names(tmp_path_factory):
    """Names that the calls of the table use."""
    folder = tmp_path_factory.mktemp("errors")
    (folder / "empty").mkdir()
    task = pg.task("cart_pole", poles=1, horizon=5)
    policy = pg.Mlp(task, [4])
    fast = {"train_samples": 4, "test_samples": 4}
    run = pg.train(task, policy, epochs=1, out=folder / "run", **fast)
    (folder / "run" / "notes.txt").write_text("of the user")
    shell = SimpleNamespace(folder=folder)
    return {
        "__file__": __file__, "pg": pg, "np": np, "Path": Path, "task": task, "policy": policy, "run": run, "fast": fast, "folder": shell.folder,
        "starts": task.starts(2), "x": np.zeros((2, 4)), "u": np.zeros((2, 1)), "Tensor": Tensor, "JVPTracer": JVPTracer,
        "rate": lambda x, u: [u[0] - x[0]], "drawn": pg.task("cart_pole", poles=1, pole_mass=pg.uniform(0.1, 0.2)),
        "data": [(np.zeros((3, 4)), np.zeros((3, 1)))],
    }  # fmt: skip


V, T, F = ValueError, TypeError, FileNotFoundError
OWN = "pg.system(rate, **{'states': 1, 'controls': 1, 'dt': 0.1, **%s})"

# Call, class of the error, and words of the message, in this order.
TABLE = [
    # Lists.
    ('pg.gradients(task, policy, starts, fields="C")', T, "`fields` is of type str", "a list"),
    ('pg.gradients(task, policy, starts, fields=["X"])', V, "field `X`", "C, R, M"),
    ("pg.gradients(task, policy, starts, fields=[1])", T, "`fields[0]`", "int", "str"),
    ("pg.gradients(task, policy, starts, fields={'C'})", T, "`fields` is of type set", "list"),
    ("pg.Mlp(task, widths=32)", V, "`policy.widths` is integer `32`", "a list"),
    ("pg.Mlp(task, widths=[-3])", V, "`policy.widths[0]` is integer `-3`", "0 or more"),
    ("pg.Mlp(task, widths=[3.5])", V, "`policy.widths[0]` is", "3.5", "whole number"),
    ("pg.optimize(task, starts[0], bounds=20)", T, "`bounds` is of type int", "pairs"),
    ("pg.optimize(task, starts[0], bounds=[20])", T, "`bounds[0]`", "int"),
    ("pg.optimize(task, starts[0], bounds=(-20, 20))", V, "`bounds` has 2 elements", "one pair"),
    ("pg.optimize(task, starts[0], bounds=[[20, -20]])", V, "bounds of control 0 are [20, -20]", "low <= high"),
    ("pg.identify(task, data, params='system.cart_mass')", T, "`params` is of type str", "list"),
    ("pg.identify(task, data, params=[3])", T, "`params[0]`", "int", "str"),
    ("pg.identify(task, None, params=['system.cart_mass'])", T, "`data`", "None"),
    ("pg.choice(3)", T, "pg.choice", "3", "list"),
    ("pg.choice('ab')", T, "pg.choice", "'ab'", "list"),
    ("pg.table('abc')", T, "pg.table", "'abc'", "list"),
    ("pg.table(3)", V, "pg.table", "list of numbers", "shape ()"),
    # Counts and other whole numbers.
    ("task.starts(-1)", V, "`count` is -1", "not negative"),
    ("task.starts(2.5)", T, "`count` is of type float", "whole number"),
    ("task.starts('3')", T, "`count` is of type str", "whole number"),
    ("task.starts(None)", T, "`count` is of type NoneType", "whole number"),
    ("task.starts(True)", T, "`count` is of type bool", "whole number"),
    ("task.starts(10**30)", V, "`count` is 1000", "below 2^64"),
    ("task.starts(2, seed=-1)", V, "`seed` is -1", "not negative"),
    ("task.starts(2, seed=2**70)", V, "`seed` is", "below 2^64"),
    ("pg.Mlp(task, seed=-1)", V, "`seed` is -1", "not negative"),
    ("pg.Mlp(task, seed=1.5)", T, "`seed` is of type float", "whole number"),
    ("pg.Mlp(task, seed=None)", T, "`seed` is of type NoneType", "whole number"),
    ("task.step(x, u, t=-1)", V, "`t` is -1", "not negative"),
    ("task.step(x, u, t=1.5)", T, "`t` is of type float", "whole number"),
    ("task.step(x, u, t=np.array([0, 1]))", T, "`t` is of type ndarray", "whole number"),
    ("task.params_at(starts, -1)", V, "`t` is -1", "not negative"),
    ("run.train(epochs=-1)", V, "`epochs` is -1", "not negative"),
    ("run.train(epochs='3')", T, "`epochs` is of type str", "whole number"),
    ("run.train(epochs=1.5)", T, "`epochs` is of type float", "whole number"),
    ("pg.train(task, epochs=-1)", V, "`epochs` is integer `-1`", "0 to"),
    ("pg.train(task, epochs=1.5)", V, "`epochs` is", "1.5", "whole number"),
    ("pg.train(task, threads=-1)", V, "`threads` is -1", "not negative"),
    ("pg.train(task, threads=0)", V, "`threads` is 0", "1 to"),
    ("pg.train(task, threads='2')", T, "`threads` is of type str", "whole number"),
    ("pg.train(task, train_samples=-1)", V, "`training.train_samples` is integer `-1`", "1 to"),
    ("pg.train(task, train_samples=0)", V, "`training.train_samples` is 0", "1 to"),
    ("pg.train(task, seed=-1)", V, "`seed` is integer `-1`", "0 or more"),
    ("pg.optimize(task, starts[0], iterations=-1)", V, "`iterations` is -1", "not negative"),
    ("pg.optimize(task, starts[0], iterations=2.5)", T, "`iterations` is of type float", "whole number"),
    ("pg.accuracy(task, rounds=-1)", V, "`rounds` is -1", "not negative"),
    ("pg.accuracy(task, rounds=0)", V, "`rounds` is 0", "1 to 1000"),
    ("pg.task('cart_pole', poles=-1)", V, "`system.poles` is integer `-1`", "1 to 64"),
    ("pg.task('cart_pole', horizon=-3)", V, "`horizon` is integer `-3`", "1 to"),
    ("pg.task('cart_pole', horizon='5')", V, "`horizon` is string", "5", "1 to"),
    ("pg.noise(1, hold=0)", V, "pg.noise", "hold=0", "1 or more"),
    (OWN % "{'states': -1}", V, "`states` is -1", "0 or more"),
    (OWN % "{'controls': -1}", V, "`controls` is -1", "0 or more"),
    (OWN % "{'states': 1.5}", T, "`states` is of type float", "a list of names"),
    (OWN % "{'states': True}", T, "`states` is of type bool", "a list of names"),
    (OWN % "{'states': None}", T, "`states` is of type NoneType", "a list of names"),
    (OWN % "{'states': 'x'}", T, "`states` is the text 'x'", "a list of names"),
    (OWN % "{'horizon': -1}", V, "`horizon` is integer `-1`", "1 to"),
    (OWN % "{'substeps': -1}", V, "`integrator.substeps` is integer `-1`", "1 to"),
    # Dicts.
    (OWN % "{'params': [1]}", T, "`params` is of type list", "a dict"),
    (OWN % "{'params': 3}", T, "`params` is of type int", "a dict"),
    (OWN % "{'tables': [1]}", T, "`tables` is of type list", "a dict"),
    (OWN % "{'units': 'm'}", T, "`units` is of type str", "a dict"),
    (OWN % "{'start': 3}", T, "`start` is of type int", "a dict"),
    (OWN % "{'angles': 1}", T, "`angles` is 1", "names of states"),
    (OWN % "{'controls': {'u': 5}}", V, "control `u` are 5", "(low, high)"),
    (OWN % "{'dt': -0.1}", V, "`dt` is -0.1", "positive"),
    (OWN % "{'dt': '0.1'}", V, "`dt`", "'0.1'", "finite number"),
    (OWN % "{'method': 'rk5'}", V, "`integrator.method` is `rk5`", "rk4"),
    ("pg.system(rate, states=1, controls=1)", T, "system()", "dt"),
    ("pg.system(lambda x: -x, states=1, dt=0.1)", V, "`controls` is empty", "at least one"),
    ("pg.system('f', states=1, controls=1, dt=0.1)", T, "`rate` is of type str", "function"),
    ("pg.task('cart_pole', effects='steady_wind')", V, "`effects` is string", "steady_wind", "a section"),
    ("pg.task('cart_pole', effects=['steady_wind'])", V, "`effects` is a list", "a section"),
    ("pg.task('cart_pole', effects={'stedy_wind': {}})", V, "`effects.stedy_wind` is unknown", "`effects.steady_wind`"),
    ("pg.task('cart_pole', effects={1: {}})", T, "`effects` has a key of type int", "1", "text"),
    ("pg.task('cart_pole', settings=3)", T, "`settings` is of type int", "a dict"),
    ("pg.task('cart_pole', settings={2: 2})", T, "`settings` has a key of type int", "2", "text"),
    ("pg.task('cart_pole', settings={'poles': 2})", V, "`poles` is unknown", "`system.poles`"),
    ("pg.task('cart_pole', **{'system..poles': 2})", V, "`system..poles` is no key", "`system.poles`"),
    ("pg.task('cart_pole', **{'': 2})", V, "`system.` is no key", "`system.poles`"),
    ("pg.task('cart_pole', vary={'': pg.uniform(1, 2)})", V, "`system.` is no key", "`system.poles`"),
    ("pg.task('cart_pole', cart_mass=10**400)", V, "`system.cart_mass` is too large an integer"),
    ("pg.task('cart_pole', system={'cart_mass': {2: 2}})", T, "`system.cart_mass` has a key of type int", "text"),
    # Numbers that vary.
    ("pg.task('cart_pole', vary=['cart_mass'])", T, "`vary` is of type list", "a dict"),
    ("pg.task('cart_pole', vary={'cart_mass': 1.0})", V, "`vary`: `system.cart_mass` is 1.0", "uniform"),
    ("pg.task('cart_pole', vary={'cart_mass': [0.1, 0.2]})", V, "`vary`: `system.cart_mass` is [0.1, 0.2]", "uniform"),
    ("pg.task('cart_pole', vary={'cart_mas': pg.uniform(1, 2)})", V, "`system.cart_mas` is unknown", "`system.cart_mass`"),
    ("pg.task('cart_pole', vary={'cart_mass': pg.trained(1)})", V, "`vary`: `system.cart_mass`", "uniform"),
    ("pg.task('cart_pole', vary={3: pg.uniform(1, 2)})", T, "`vary` has a key of type int", "text"),
    ("pg.task('cart_pole', vary={'poles': pg.uniform(1, 2)})", V, "`system.poles` cannot vary", "`system.cart_mass`"),
    ("pg.task('cart_pole', fit=['cart_mass'])", T, "`fit` is of type list", "a dict"),
    ("pg.task('cart_pole', fit={'cart_mass': '1'})", V, '`fit`: `system.cart_mass` is "1"', "initial value"),
    ("pg.task('cart_pole', fit={'cart_mass': {'min': 1}})", V, "`fit`: `system.cart_mass`", "start"),
    ("task.replace(fit={'cart_mass': pg.uniform(1, 2)})", V, "`fit`: `system.cart_mass`", "start"),
    # Paths.
    ("pg.task('nofile.toml')", F, "nofile.toml"),
    ("pg.task(Path('nofile.toml'))", F, "nofile.toml"),
    ("pg.scene(folder / 'a.toml')", F, "a.toml"),
    ("pg.task('cart_pol')", V, "no preset `cart_pol`", "cart_pole"),
    ("pg.task('.')", V, ". is a folder", ".toml"),
    ("pg.task(5)", T, "`name` is of type int", "text or a path"),
    ("pg.task(task)", T, "`name` is of type Task", "text or a path"),
    ("pg.load('nofolder')", F, "nofolder"),
    ("pg.load(folder / 'nofolder')", F, "nofolder"),
    ("pg.load(folder / 'empty')", F, "no run in", "run.toml"),
    ("pg.load(__file__)", NotADirectoryError, "no folder", "only a file of this name"),
    ("pg.load(3)", T, "`folder` is of type int", "text or a path"),
    ("policy.load('nofile.safetensors')", F, "nofile.safetensors"),
    ("policy.load(folder / 'nofile')", F, "nofile"),
    ("policy.load(folder)", V, "is not a file"),
    ("policy.load(3)", T, "path", "int"),
    ("policy.save(folder / 'no' / 'p.safetensors')", F, "no folder"),
    ("policy.save(3)", T, "path", "int"),
    ("run.report(folder / 'no' / 'r.html')", F, "no folder"),
    ("run.report(folder)", V, "not a regular file", "choose another"),
    ("run.save(3)", T, "folder", "int"),
    ("run.save('/proc/nope/run')", OSError, "/proc/nope/run", "choose another"),
    ("pg.train(task, epochs=1, out=3, **fast)", T, "`out` is of type int", "text or a path"),
    ("pg.train(task, epochs=1, seed=5, out=folder / 'run', **fast)", RuntimeError, "notes.txt", "choose another folder"),
    # Tensors and arrays.
    ("task.step(Tensor(), u)", T, "`x` is a tensor of PyTorch", "`physgrad.torch`", "`x.detach().cpu().numpy()`"),
    ("task.step(x, Tensor())", T, "`u` is a tensor of PyTorch", "`physgrad.torch`"),
    ("pg.rollout(task, policy, Tensor())", T, "`starts` is a tensor of PyTorch", "`starts.detach()"),
    ("policy(Tensor())", T, "`y` is a tensor of PyTorch", "`y.detach()"),
    ("setattr(policy, 'theta', Tensor())", T, "`theta` is a tensor of PyTorch", "`theta.detach()"),
    ("task.step(JVPTracer(), u)", T, "`x` is traced by JAX", "`physgrad.jax`"),
    ("task.step(x + 1j, u)", T, "`x` is an array of complex128", "real numbers"),
    ("task.step([[1j] * 4] * 2, u)", T, "`x` is an array of complex128", "real numbers"),
    ("task.step(x > 0, u)", T, "`x` is an array of bool", "real numbers"),
    ("task.step(x.astype(str), u)", T, "`x` is an array of <U", "real numbers"),
    ("task.step('a', u)", T, "`x`", "real numbers"),
    ("task.step(None, u)", V, "`x` has the shape ()", "(B, 4)"),
    ("task.step(x[0], u)", V, "`x` has the shape (4,)", "(B, 4)"),
    ("task.step(x, u, u)", V, "`p` has the shape (2, 1)", "(2, 0)"),
    ("task.step([[1, 2], [3]], u)", V, "`x` is no array of numbers"),
    ("task.step({'x': 1}, u)", T, "`x` is of type dict", "an array"),
    ("drawn.step(x, u)", V, "pass `p` of shape (2, 1)"),
    ("task.step_vjp(x, u, u)", V, "`next_bar` has the shape (2, 1)", "(2, 4)"),
    ("task.starts(2, dtype='float16')", V, "`dtype` is float16", "float32, float64"),
    ("task.starts(2, dtype=3)", V, "`dtype` is 3", "float32, float64"),
    ("task.starts(2, split='tes')", V, '`split` is "tes"', "new"),
    ("pg.rollout(task, policy, starts[0])", V, "`starts` has the shape (4,)", "(B, 4)"),
    ("pg.gradients(task, policy, starts[:0])", V, "`starts` has no rows", "at least one"),
    ("setattr(policy, 'theta', np.zeros(3))", V, "`theta` has 3 numbers", "expected"),
    ("setattr(policy, 'theta', policy.theta + np.nan)", V, "`theta[0]` is NaN", "finite"),
    # Other objects.
    ("pg.train('cart_pole', epochs=1)", T, "'str' object", "'Task'", "'task'"),
    ("pg.train(task, 'mlp', epochs=1)", T, "'str' object", "'Policy'", "'policy'"),
    ("pg.Mlp([32])", T, "'list' object", "'Task'", "'task'"),
    ("pg.losses(policy, task, starts)", T, "`policy` is of type Task", "a `Policy`"),
    ("pg.check(task, 3)", T, "'int' object", "'Policy'", "'policy'"),
    ("pg.train(task, callback='print', epochs=1)", T, "`callback` is of type str", "a function"),
    ("run.train(3)", T, "`callback` is of type int", "a function"),
    ("pg.train(task, lr=0.1)", V, "`training.lr` is unknown", "`learning_rate`"),
    ("pg.train(task, field='X')", V, "`field`", "`X`", "C, R, M"),
    ("pg.train(task, learning_rate=-1)", V, "`training.learning_rate` is -1", "positive"),
    ("pg.train(task, optimizer='sdg')", V, "`training.optimizer` is `sdg`", "`adam`"),
    ("pg.task('cart_pole', precision='float32')", V, "`precision` is `float32`", "`f32`"),
    ("pg.task('cart_pole', precision=np.float32)", T, "`precision` is of type type", "str"),
    ("pg.task('cart_pole', dt=float('nan'))", V, "`system.dt` is NaN", "positive"),
    ("pg.task('cart_pole', cart_mass=1j)", T, "`system.cart_mass` is of type complex", "float"),
    ("task.replace(poles=None)", V, "`system.poles` is None", "give a value"),
    ("pg.accuracy(task, metric='X')", V, '`metric` is "X"', "trajectory"),
    ("pg.uniform(2, 1)", V, "pg.uniform", "2.0", "1.0"),
    ("pg.from_jax(3)", T, "from_jax", "function", "int"),
    ("pg.trch", AttributeError, "physgrad", "trch"),
]  # fmt: skip


@pytest.mark.parametrize(
    "call, kind, words",
    [(call, kind, words) for call, kind, *words in TABLE],
    ids=[call for call, *_ in TABLE],
)
def test_wrong_calls(call, kind, words, names, tmp_path, monkeypatch):
    # A call that is not refused may write a file.
    monkeypatch.chdir(tmp_path)
    with pytest.raises(kind) as error:
        eval(call, names)
    # `FileNotFoundError` is an `OSError`, which would hide another class.
    assert error.type is kind or kind is OSError
    # The compiled module adds the name of an argument of a wrong class as a note.
    text = "\n".join(
        [
            str(error.value),
            *getattr(error.value, "__notes__", ["while processing 'task' 'policy' folder path"]),
        ]
    )
    places = [text.find(word) for word in words]
    assert -1 not in places, f"{text!r} has not all of {words}"
    assert not re.search(r"(^|\s)(--[a-z]|-[a-z]\b)|`train |internal error|panic", text), (
        f"{text!r} is no message for Python"
    )


def test_numbers_vary_and_fit_by_keyword():
    task = pg.task(
        "cart_pole",
        poles=1,
        vary={"cart_mass": pg.uniform(0.5, 1.5)},
        fit={"effects.pole_damping.damping": {"start": 0.1, "min": 0.0}, "pole_mass": 0.2},
    )
    assert task == pg.task(
        "cart_pole",
        poles=1,
        cart_mass=pg.uniform(0.5, 1.5),
        pole_mass=pg.trained(0.2),
        effects={"pole_damping": {"damping": pg.trained(0.1, min=0.0)}},
    )
    assert task == pg.task("cart_pole", poles=1).replace(
        vary={"system.cart_mass": pg.uniform(0.5, 1.5)},
        fit={"pole_mass": 0.2, "effects.pole_damping.damping": pg.trained(0.1, 0)},
    )
    assert set(task.param_names) == {"system.cart_mass", "system.pole_mass", "effects.pole_damping.damping"}
    own = pg.system(lambda x, u, p: [p.k * u[0] - x[0]], states=1, controls=1, dt=0.1, params={"k": 1.0})
    assert own.replace(vary={"k": pg.uniform(1, 2)}) == own.replace(k=pg.uniform(1, 2))
    assert own.replace(fit={"k": 2.0}) == own.replace(k=pg.trained(2.0))


def test_arrays_of_other_libraries_are_converted_or_refused():
    torch = pytest.importorskip("torch", reason="PyTorch is not installed")
    task = pg.task("cart_pole", poles=1)
    with pytest.raises(TypeError, match=r"`x` is a tensor of PyTorch; `physgrad.torch` has"):
        task.step(torch.zeros(2, 4, requires_grad=True), np.zeros((2, 1)))


def test_arrays_of_jax_are_converted_outside_of_functions_of_jax():
    jax = pytest.importorskip("jax", reason="JAX is not installed")
    task, u = pg.task("cart_pole", poles=1), np.zeros((2, 1))
    x = np.ones((2, 4), "float32")
    np.testing.assert_array_equal(task.step(jax.numpy.asarray(x), u), task.step(x, u))
    for transform in (jax.jit, jax.vmap, lambda f: jax.grad(lambda x: f(x).sum())):
        with pytest.raises(TypeError, match=r"`x` is traced by JAX; use the functions of `physgrad.jax`"):
            transform(lambda x: task.step(x, u))(x)


def test_the_message_about_a_folder_of_an_earlier_run_names_no_command(tmp_path, capfd):
    task, fast = (
        pg.task("cart_pole", poles=1, horizon=5),
        {"train_samples": 4, "test_samples": 4, "epochs": 1},
    )
    for seed in (1, 2):
        pg.train(task, seed=seed, out=tmp_path / "run", **fast)
    text = capfd.readouterr().err
    assert "moved the earlier run in" in text.replace("\n", " ") and "--" not in text and "resume" not in text
