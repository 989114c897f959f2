"""Functions that cannot become equations are refused, with the line and what to write."""

import functools
import math
import re
import sys
import threading
from pathlib import Path

import numpy as np
import pytest
from equations import Case, trace
from equations import distributions as pg

BUFFER = np.zeros(2)
MATRIX = np.array([[0.0, 1.0], [-1.0, 0.0]])
STORED: dict = {}


def opened(function=lambda x: x, states=2, controls=1, dt=0.1, **options):
    return trace.trace_settings(function, states=states, controls=controls, dt=dt, **options)


def branch(x, u):
    return [x[1], -x[0] if x[0] > 0 else x[0]]


def branch_statement(x):
    if x[0] > 0:
        return x
    return -x


def loop(x):
    while x[0] < 1:
        x = x + 1
    return x


def truth(x):
    return x * bool(x[0])


def nearest(x):
    best = np.inf
    for a in x:
        if a < best:
            best = a
    return x * best


def filled(x):
    import numpy

    out = numpy.zeros(2)
    out[0] = x[1]
    return out


def outside(x):
    BUFFER[0] = x[0]
    return BUFFER


def outside_sum(x):
    BUFFER[:] = 0.0
    total = BUFFER
    total += x
    return total


def missing_return(x):
    x[0] = x[1]


def caught(x):
    try:
        gain = float(x[0])
    except TypeError:
        gain = 1.0
    return x * gain


def stored(x):
    previous = STORED.get("x", 0.0)
    STORED["x"] = x[0]
    return x + previous


def counter(x, memory=[0]):  # noqa: B006
    memory[0] += 1
    return x * memory[0]


def changing(x):
    STORED["gain"] = STORED.get("gain", 1.0) + 1.0
    return x * STORED["gain"]


def masked(x):
    x[x < 0] = 0.0
    return x


def generator(x):
    yield x[0]


def conditions_of_numbers(x):
    over = x > 0
    over[0] = x[0]
    return np.where(over, x, -x)


def asserted(x):
    assert x[0] > 0
    return x


def filled_integers(x):
    out = np.array([0, 0])
    out[0] = x[0]
    return out


def unknown_assignment(x):
    next = x.copy()
    next.x3 = 1.0
    return next


def caught_lookup(x):
    try:
        return x * {1.0: 10.0}.get(x[0], 1.0)
    except TypeError:
        return x


def assigned_argument(x):
    x.x2 = 1.0
    return x


def caught_assignment(x):
    try:
        x.x3 = 1.0
    except AttributeError:
        pass
    return x


@functools.lru_cache
def remembered(a):
    return 2 * a


LOOKED_UP = r"looked up in a dict or a set, .*`np\.where\(condition, a, b\)`"

# Name, function, type of the error, words of the message.
WRONG = [
    ("lookup", lambda x, p: x * {1.0: 10.0}.get(p.gain, 1.0), TypeError, LOOKED_UP),
    ("set", lambda x, p: x if p.gain in {1.0, 2.0} else -x, TypeError, LOOKED_UP),
    ("lookup of a condition", lambda x: x * {True: 2.0}.get(x[0] > 0, 1.0), TypeError, LOOKED_UP),
    ("key of a number", lambda x: list({x[0]: 1.0, x[1]: 2.0}), TypeError, LOOKED_UP),
    ("cache", lambda x: [remembered(x[0]), x[1]], TypeError, "leave the cache out"),
    ("caught lookup", caught_lookup, TypeError, LOOKED_UP),
    ("full of integers", lambda x: np.full(2, x[0], dtype=int), TypeError, "Leave out the dtype"),
    ("like integers", lambda x: np.full_like([1, 2], x[0]), TypeError, "Leave out the dtype"),
    ("like float32", lambda x: np.full_like(x, x[0], dtype=np.float32), TypeError, "Leave out the dtype"),
    ("full of three", lambda x: np.full(3, x), ValueError, "broadcast"),
    ("uint8 of conditions", lambda x: (x > 0).astype(np.uint8) - 1, TypeError, "not a uint8"),
    ("int8 of a condition", lambda x: [(x[0] > 0).astype("i1") * 2, x[1]], TypeError, "not a int8"),
    ("small integers", lambda x: ((x > 0) - np.uint8(200)) * x, TypeError, "constants in uint8; make"),
    ("small choices", lambda x: np.where(x > 0, np.int8(100), np.int8(1)) * x, TypeError, "constants in int8"),
    ("joined small integers", lambda x: np.array([x[0] > 0, np.uint8(9)]) - 1, TypeError, "constants in uint8"),
    ("joined float32", lambda x: np.append(x[:1] > 0, np.float32(0.1)), TypeError, "constants in float32"),
    ("float16", lambda x: np.exp(x > 0) * x, TypeError, r"np\.exp of conditions in float16; multiply"),
    ("int8 of squares", lambda x: np.square(x[0] > 0) * x, TypeError, r"np\.square of conditions in int8"),
    ("product of conditions", lambda x: (x > 0) @ (x < 1) * x, TypeError, "sum of products of conditions"),
    ("array of nothing", lambda x: np.array(dtype=float) + x, TypeError, "missing|required"),
    ("if", branch, TypeError, r"np\.where"),
    ("if statement", branch_statement, TypeError, r"np\.where\(condition"),
    ("if of an infinite bound", nearest, TypeError, "in place of `if`"),
    ("while", loop, TypeError, "fixed number of turns"),
    ("math.sin", lambda x: [math.sin(x[0]), x[1]], TypeError, r"`np\.sin` in place of `math\.sin`"),
    (
        "math.atan2",
        lambda x: [math.atan2(x[0], 1), x[1]],
        TypeError,
        r"`np\.arctan2` in place of `math\.atan2`",
    ),
    ("math.floor", lambda x: [math.floor(x[0]), x[1]], TypeError, "jumps and has no useful derivative"),
    (
        "small constants",
        lambda x: np.where(x > 0, np.float32(0.1), 1e-3),
        TypeError,
        "make the constants float64",
    ),
    ("array of a local import", filled, TypeError, r"np\.zeros\(n\)"),
    ("array outside", outside, TypeError, r"fixed numbers only.*`np\.zeros\(n\)` inside of the function"),
    ("sum in an array outside", outside_sum, TypeError, r"a = a \+ b"),
    (
        "shape",
        lambda x: [x[0]],
        ValueError,
        r"list of 1 elements; `rate` returns one number per state: x1, x2",
    ),
    ("scalar", lambda x: x[0] * 2, ValueError, "returned one number; `rate`"),
    ("matrix", lambda x: np.outer(x, x), ValueError, r"shape \(2, 2\)"),
    ("empty", lambda x: [], ValueError, "list of 0 elements"),
    ("none", lambda x: None, TypeError, "is a `return` missing"),
    ("missing return", missing_return, TypeError, "missing_return.*is a `return` missing"),
    ("generator", generator, TypeError, "of type generator"),
    ("text returned", lambda x: "x1", TypeError, "of type str"),
    ("texts returned", lambda x: ["x1", x[0]], TypeError, "of type str"),
    ("chained", lambda x: np.where(0 < x[0] < 1, x, -x), TypeError, r"\(a < x\) & \(x < b\)"),
    ("and", lambda x: np.where(x[0] > 0 and x[1] > 0, x, -x), TypeError, "in place of `and`"),
    ("not", lambda x: np.where(not x[0], x, -x), TypeError, "`~`"),
    ("eigenvalues", lambda x: np.linalg.eigvals(np.outer(x, x)), TypeError, r"np\.eigvals is not supported"),
    ("matmul", lambda x, u: MATRIX @ u, ValueError, r"product of shapes \(2, 2\) and \(1,\)"),
    (
        "large matrix",
        lambda x: np.linalg.solve(np.outer(np.tile(x, 3), np.ones(6)), np.ones(6)),
        TypeError,
        "limited to 4 rows",
    ),
    ("not square", lambda x: np.linalg.inv(np.stack([x])), ValueError, "square matrix"),
    ("singular", lambda x: np.linalg.solve(np.ones((2, 2)), x), ValueError, "singular"),
    ("broadcast", lambda x: x + np.ones(3), ValueError, "do not broadcast"),
    ("floor", lambda x: np.floor(x), TypeError, "constant between jumps"),
    ("round", lambda x: np.round(x), TypeError, "constant between jumps"),
    ("Python round", lambda x: [round(x[0]), x[1]], TypeError, "Rounding has no useful derivative"),
    ("//", lambda x: x // 2, TypeError, "constant between jumps"),
    ("%", lambda x: x % 2.0, ValueError, r"np\.arctan2\(np\.sin\(a\), np\.cos\(a\)\)"),
    ("% of time", lambda x, t: [x[0] + t % 1.0, x[1]], ValueError, r"pg\.table"),
    ("fmod", lambda x: np.fmod(x, 1.0), TypeError, "constant between jumps"),
    ("equal", lambda x: np.where(x[0] == 0, x, -x), TypeError, "whether numbers are equal"),
    ("unequal", lambda x: np.where(x != 0, x, -x), TypeError, "whether numbers are equal"),
    (
        "array equal",
        lambda x: np.where(np.array_equal(x, [0, 0]), x, -x),
        TypeError,
        "whether numbers are equal|array_equal",
    ),
    ("in", lambda x: x if 0.0 in list(x) else -x, TypeError, "whether numbers are equal"),
    ("python max", lambda x: [max(x[0], 0.0), x[1]], TypeError, r"np\.maximum\(a, b\)"),
    ("python min", lambda x: [min(x), x[1]], TypeError, r"np\.minimum\(a, b\)"),
    ("sorted", lambda x: sorted(x), TypeError, r"`np\.minimum\(a, b\)` is the first"),
    ("any", lambda x: x if any(x > 0) else -x, TypeError, r"`np\.any\(np\.array\("),
    ("sort", lambda x: np.sort(x), TypeError, "np.sort is not supported"),
    ("argmax", lambda x: x * np.argmax(x), TypeError, "np.argmax is not.*`np.minimum`, `np.where`"),
    ("method argmin", lambda x: x * x.argmin(), TypeError, "np.argmin is not.*index that depends on values"),
    ("argmin of a list", lambda x: x * np.argmin([x[0], x[1]]), TypeError, "index that depends on values"),
    ("argsort", lambda x: x[np.argsort(x)], TypeError, "order of traced numbers is not known"),
    ("searchsorted", lambda x: x * np.searchsorted(BUFFER, x[0]), TypeError, r"`np\.interp\(x, places"),
    ("method searchsorted", lambda x: x * BUFFER.searchsorted(x[0]), TypeError, r"`np\.interp\(x, places"),
    ("method sort", lambda x: x.sort() or x, TypeError, "not known"),
    ("float", lambda x: [float(x[0]), x[1]], TypeError, "Keep the number traced: leave out `float`"),
    ("int", lambda x: [int(x[0]), x[1]], TypeError, "Rounding has no useful derivative; leave out `int`"),
    ("index of int", lambda x: x * BUFFER[int(x[0])], TypeError, r"`np\.interp\(a, places, values\)` or"),
    ("range", lambda x: [sum(range(x[0])), x[1]], TypeError, "fixed number of turns"),
    ("format", lambda x: [float(f"{x[0]:.3f}"), x[1]], ValueError, "could not convert"),
    ("list index", lambda x, t: [x[0] * [1, 2][t], x[1]], TypeError, "not known"),
    ("array index", lambda x, t: [x[0] * np.arange(3.0)[t], x[1]], TypeError, r"`pg\.table"),
    ("vector index", lambda x, t: [x[t], x[1]], IndexError, r"pg\.table"),
    ("mask", masked, IndexError, r"np\.where\(condition, a, b\)"),
    ("where places", lambda x: np.where(x > 0), TypeError, "give both values"),
    ("number as condition", lambda x: np.where(x, 1.0, 2.0), TypeError, "compare it"),
    ("number in logic", lambda x: np.where((x[0] > 0) & x[1], x, -x), TypeError, "need comparisons"),
    ("negated number", lambda x: np.where(~x[0], x, -x), TypeError, "need comparisons"),
    ("difference of conditions", lambda x: (x[0] > 0) - (x > 1), TypeError, "NumPy does not subtract"),
    ("list of numbers", lambda x: np.maximum([x[0], x[1]], 0.0), TypeError, r"np\.array\(\[\.\.\.\]\)"),
    ("float32", lambda x: np.array([x[0], x[1]], dtype=np.float32), TypeError, "Leave out the dtype"),
    ("astype", lambda x: x.astype(int), TypeError, "Leave out the dtype"),
    ("infinite", lambda x: np.where(x > 0, x, np.inf), ValueError, "Constants must be finite"),
    ("nan", lambda x: x + np.nan, ValueError, "Constants must be finite"),
    ("infinite result", lambda x: [np.inf, x[0]], ValueError, "not finite"),
    ("empty array", lambda x: x + np.full(2, np.nan), ValueError, r"np\.empty"),
    ("complex", lambda x: x * 1j, TypeError, "not with complex number"),
    ("text", lambda x: [x[0] + "a", x[1]], TypeError, "not with str"),
    ("missing value", lambda x: [x[0] * None, x[1]], TypeError, "not with NoneType"),
    ("isnan", lambda x: np.where(np.isnan(x), 0.0, x), TypeError, "Leave np.isnan out"),
    ("attribute", lambda x: [x.x3, x.x1], AttributeError, "no `x3`; did you mean"),
    ("assigned attribute", unknown_assignment, AttributeError, "no `x3`; did you mean"),
    ("assigned argument", assigned_argument, AttributeError, r"`x2` is assigned.*`y = x\.copy\(\)`"),
    ("caught assignment", caught_assignment, AttributeError, "no `x3`"),
    ("assigned number", lambda x: setattr(x[0], "x1", 1.0) or x, AttributeError, "x1"),
    ("key", lambda x: [x["y1"], x[0]], LookupError, "no `y1`"),
    ("parameter", lambda x, p: x * p.gian, AttributeError, "no parameter `gian`; did you mean `gain`"),
    ("parameter key", lambda x, p: x * p["mass"], LookupError, "no parameter `mass`"),
    ("slice", lambda x: [x[:1].x1, x[0]], AttributeError, "this array has no `x1`"),
    ("long index", lambda x: [x[2], x[1]], IndexError, "out of bounds"),
    ("random", lambda x: x + np.random.normal(), ValueError, "must not draw random numbers"),
    ("counter", counter, ValueError, "count its calls"),
    ("changing", changing, ValueError, "change variables"),
    ("caught", caught, TypeError, "not known"),
    ("stored", stored, RuntimeError, "of another call"),
    ("huge power", lambda x: x**5000, ValueError, "largest is 1024"),
    (
        "endless",
        lambda x: x * sum(np.sin(x[0] * k) for k in range(10**6)),
        ValueError,
        "loops of Python are unrolled",
    ),
    ("parameter changed", lambda x, p: setattr(p, "gain", 2.0) or x, AttributeError, "does not change"),
    ("constant changed", lambda x, p: p.A.fill(x[0]) or x, (TypeError, ValueError), "read-only|not known"),
    ("spectral norm", lambda x: x * np.linalg.norm(np.outer(x, x), 2), TypeError, "not supported"),
    ("dot option", lambda x: np.sum(x, where=[True, False]) * x, TypeError, "not supported"),
    ("ragged", lambda x: np.array([x, x[0]])[0], ValueError, "rows of different lengths"),
    ("sum of conditions", lambda x: ((x > 0) + (x > 1)) * x, TypeError, "a count for Python"),
    (
        "sum of a list of conditions",
        lambda x: np.sum([x[0] > 0, x[1] > 0]) * x,
        TypeError,
        "a count for Python",
    ),
    ("condition and number", conditions_of_numbers, TypeError, "assign a comparison"),
    ("copyto", lambda x: np.copyto(x, 1.0) or x, TypeError, "in place"),
    ("fill_diagonal", lambda x: np.fill_diagonal(np.zeros((2, 2)), 1.0) or x, TypeError, "in place"),
    ("at", lambda x: np.add.at(x, [0], 1.0) or x, TypeError, "np.add.at is not supported"),
    ("out by position", lambda x: np.clip(x, 0, 1, x), TypeError, "by its name"),
    (
        "function of another package",
        lambda x: np.frompyfunc(lambda a: a, 1, 1)(x),
        TypeError,
        "for each element",
    ),
    ("vectorize", lambda x: np.vectorize(lambda a: 2 * a)(x), TypeError, "for each element"),
    ("einsum", lambda x: np.einsum("i->ii", x)[0], ValueError, "index twice"),
    ("assertion", asserted, TypeError, "Leave the assertion out"),
    ("filled integers", filled_integers, TypeError, "fixed numbers only"),
    ("buffer", lambda x: np.frombuffer(x) + x, (ValueError, TypeError, BufferError), "."),
    ("axis", lambda x: np.sum(x, axis=1) * x, ValueError, "axis 1 is out of range"),
    ("interp of traced places", lambda x: np.interp(0.5, x, [1.0, 2.0]) * x, TypeError, "constant places"),
    ("interp falls", lambda x: np.interp(x, [1.0, 0.0], [1.0, 2.0]), ValueError, "increase"),
    ("element of array", lambda x: [x.__setitem__(0, x), x][1], ValueError, "assigned an array of shape"),
    ("near name", lambda x: np.sinc(x), TypeError, r"not supported|equal"),
    ("unknown ufunc", lambda x: np.arcsinh(x), TypeError, "did you mean"),
    ("string", lambda x: np.linalg.norm(x, ord="nuc") * x, TypeError, "not supported"),
    ("builtin", min, TypeError, "arguments among"),
    ("order of scipy", lambda t, y: y, TypeError, "an argument `y` that does not fit; rename it `x`"),
    ("words out of order", lambda y, params: y, TypeError, "`y` that does not fit; rename it `x`"),
    ("too many arguments", lambda a, b, c, d, e: a, TypeError, "`rate` receives x, u, p, t"),
    ("next in the rate", lambda x, next: x, TypeError, "`next` that does not fit"),
    ("keyword", lambda x, *, gain: x, TypeError, "`gain` that does not fit"),
    ("no function", 3.0, TypeError, "give a function"),
]


@pytest.fixture(autouse=True)
def restored():
    BUFFER[:] = 0.0
    STORED.clear()
    yield
    assert np is sys.modules["numpy"]
    assert not trace.CALLS


@pytest.mark.parametrize("function, error, words", [row[1:] for row in WRONG], ids=[row[0] for row in WRONG])
def test_wrong_functions_are_refused(function, error, words):
    options = {"params": {"gain": 2.0, "A": np.ones(2)}}
    with pytest.raises(error, match=words):
        opened(function, **options)


def test_errors_name_the_file_and_the_line():
    lines = Path(__file__).read_text(encoding="utf-8").splitlines()
    for function, text in [
        (branch, "x[0] > 0 else"),
        (loop, "while x[0]"),
        (filled, "out[0] = x[1]"),
        (masked, "x[x < 0]"),
        (caught, "gain = float"),
        (outside_sum, "total += x"),
    ]:
        with pytest.raises(Exception) as caught_error:  # noqa: PT011
            opened(function)
        place = re.match(rf"\S*{Path(__file__).name}:(\d+): ", str(caught_error.value))
        assert place, caught_error.value
        assert text in lines[int(place[1]) - 1]
    with pytest.raises(TypeError, match=rf"{Path(__file__).name}:\d+: `missing_return`"):
        opened(missing_return)


def test_only_lists_are_told_to_be_arrays():
    functions = (branch, branch_statement, nearest, loop, truth, lambda x: [max(x[0], 0.0), x[1]])
    for function in functions:
        with pytest.raises(TypeError) as error:
            opened(function)
        assert "list of traced numbers" not in str(error.value)


def test_errors_of_other_packages_have_a_note_with_the_line():
    with pytest.raises(IndexError) as error:
        opened(lambda x: [x[2], x[1]])
    if hasattr(error.value, "__notes__"):
        assert re.match(rf"\S*{Path(__file__).name}:\d+: raised in `rate`", error.value.__notes__[0])
    with pytest.raises(TypeError) as error:
        opened(lambda x: np.linalg.det([[x[0], 1.0], [1.0, x[1]]]) * x)
    if hasattr(error.value, "__notes__"):
        assert "write `np.array([...])`" in error.value.__notes__[0]


def test_errors_in_helpers_name_the_line_of_the_helper():
    def helper(a):
        return a if a > 0 else -a

    with pytest.raises(TypeError, match=rf"{Path(__file__).name}:{helper.__code__.co_firstlineno + 1}: "):
        opened(lambda x: [helper(x[0]), helper(x[1])])


# Name, arguments besides a right function, words of the message.
SETTINGS = [
    ("same name", {"states": ["a", "b"], "controls": ["a"]}, "`a` is in `states` and in `controls`"),
    ("twice", {"states": ["a", "a"]}, "`a` is twice"),
    ("time", {"states": ["t", "v"]}, "`t` in `states` has a meaning"),
    ("pi", {"params": {"pi": 3.0}}, "`pi` in `params` has a meaning"),
    ("next", {"controls": ["next"]}, "`next` in `controls` has a meaning"),
    ("function name", {"params": {"sin": 1.0}}, "`sin` in `params` has a meaning"),
    ("letters", {"states": ["θ", "v"]}, "is not a name"),
    ("blank", {"states": ["a b", "v"]}, "is not a name"),
    ("text", {"states": "xy"}, "give a list of names"),
    ("no states", {"states": []}, "at least one state"),
    ("start", {"start": {"x3": 1.0}}, "`start` has no `x3`; did you mean"),
    ("start list", {"start": [1.0]}, "has 1 values; expected 2"),
    ("start text", {"start": {"x1": "a"}}, "not a finite number"),
    ("units", {"units": {"y": "m"}}, "`units` has no `y`"),
    ("angles", {"angles": ["y"]}, "`angles` has no `y`"),
    ("bounds", {"controls": {"f": (1, 0)}}, "low must be below high"),
    ("bounds shape", {"controls": {"f": 1.0}}, "expected \\(low, high\\)"),
    ("flag", {"params": {"flag": True}}, "not a finite number"),
    ("infinite", {"params": {"a": np.inf}}, "not a finite number"),
    ("complex", {"params": {"a": np.ones(2) * 1j}}, "array of complex"),
    ("texts", {"params": {"a": ["b"]}}, "array of <U1"),
    ("dt", {"dt": 0.0}, "is positive"),
    ("both", {"step": lambda x: x}, "either the rate"),
    (
        "cost twice",
        {"running_cost": lambda x: x[0], "loss": {"running": "x1"}},
        "`loss.running` is given twice",
    ),
    ("section", {"loss": 3}, "give a dict"),
    ("cost of two numbers", {"running_cost": lambda x: x}, "`running_cost` returns one number"),
    ("cost dict", {"running_cost": lambda x: {"a": x[0]}}, "expected one number"),
    ("control in observe", {"observe": lambda x, u: x}, "`u` that does not fit"),
    ("time in terminal", {"terminal_cost": lambda x, t: x[0]}, "`t` that does not fit"),
    (
        "table in terminal",
        {"tables": {"wind": [1.0]}, "terminal_cost": lambda x, p: p.wind},
        "no parameter `wind`",
    ),
    ("table of tables", {"tables": {"wind": [[1.0]]}}, "needs a list of numbers"),
]


@pytest.mark.parametrize("options, words", [row[1:] for row in SETTINGS], ids=[row[0] for row in SETTINGS])
def test_wrong_arguments_are_refused(options, words):
    with pytest.raises((ValueError, TypeError, AttributeError), match=words):
        opened(**options)


def returned_pair(x, p):
    return [x[0] * p.speed, x[1]]


def broadcast_pair(x, p):
    return np.append(x, x[0]) * p["speed"]


def assigned_pair(x, p):
    next = x.copy()
    next[0] = p.speed
    return next


@pytest.mark.parametrize("function", [returned_pair, broadcast_pair, assigned_pair])
def test_a_pair_is_told_from_a_distribution(function):
    with pytest.raises(ValueError, match=r"`speed` is a tuple, .* `pg\.uniform\(8, 20\)`"):
        opened(function, params={"speed": (8, 20)})


def test_a_pair_that_is_not_read_is_not_mentioned():
    with pytest.raises(ValueError, match="one number per state: x1, x2$"):
        opened(lambda x: [x[0]], params={"speed": (8, 20)})
    assert opened(lambda x, p: x * p.speed, params={"speed": (8, 20)})["system"]["rate"]["x2"] == "x2 * 20"


@pytest.mark.parametrize(
    "cost",
    [lambda x, u, p, xn: xn[0], lambda x, xn, u: xn[0], lambda x, u, p, t, xn: xn[0], lambda p, xn: xn[0]],
)
def test_an_unknown_argument_is_to_blame(cost):
    with pytest.raises(TypeError, match="`xn` that does not fit; rename it `(next|x)`"):
        opened(running_cost=cost)


def test_a_system_needs_a_control():
    for controls in ({}, {"controls": []}, {"controls": 0}):
        with pytest.raises(ValueError, match=r"`controls` is empty; .* `controls=\[\"u\"\]`"):
            trace.system(lambda x: x, states=1, dt=0.1, **controls)


def test_a_step_has_no_method():
    with pytest.raises(TypeError, match="belong to a rate"):
        trace.trace_settings(step=lambda x: x, states=1, dt=0.1, method="rk4")
    with pytest.raises(TypeError, match="either the rate"):
        trace.trace_settings(states=1, dt=0.1)


def test_dict_results_need_the_states():
    with pytest.raises(ValueError, match="a dict with x1, y; expected the states x1, x2"):
        opened(lambda x: {"x1": x[0], "y": x[1]})


def test_numbers_of_the_rate_are_refused_in_the_cost():
    def rate(x):
        STORED["x"] = x[0]
        return x

    with pytest.raises(RuntimeError, match="of another call"):
        opened(rate, running_cost=lambda x: STORED["x"] ** 2)


def test_conditions_of_the_rate_are_refused_in_the_end():
    def rate(x):
        STORED["low"] = x[0] < 1.0
        return x

    with pytest.raises(RuntimeError, match="of another call"):
        opened(rate, end=lambda x: STORED["low"])


@pytest.mark.parametrize("period", [2, 3])
def test_a_variable_of_two_functions_is_noticed(period):
    def counted(x):
        STORED["calls"] = STORED.get("calls", 0) + 1
        return x * (1.0 + STORED["calls"] % period)

    with pytest.raises(ValueError, match="must not draw random numbers, count its calls"):
        opened(counted, observe=counted)


def test_functions_of_scipy_are_told_from_those_of_numpy():
    special = pytest.importorskip("scipy.special", reason="SciPy is not installed")
    with pytest.raises(TypeError, match=r"`log1p` of another package .*; write np\.log1p"):
        opened(lambda x: special.log1p(x))
    with pytest.raises(TypeError, match=r"`expit` of another package .*; write it with functions of NumPy"):
        opened(lambda x: special.expit(x))


def test_distributions_check_their_numbers():
    for call, words in [
        (lambda: pg.uniform(1, 0), "above high"),
        (lambda: pg.normal(0, -1), "negative"),
        (lambda: pg.log_uniform(0, 1), "0 < low"),
        (lambda: pg.choice([]), "no values"),
        (lambda: pg.trained(2.0, max=1.0), "outside of its bounds"),
        (lambda: pg.table([np.nan]), "not a finite"),
        (lambda: pg.uniform("a", 1), "not a finite"),
    ]:
        with pytest.raises(ValueError, match=words):
            call()


def test_other_threads_have_the_constructors_of_numpy():
    found = []

    def rate(x):
        thread = threading.Thread(target=lambda: found.append(type(np.zeros(2))))
        thread.start()
        thread.join()
        return x

    opened(rate)
    assert found == [np.ndarray, np.ndarray]


def test_compiled_code_has_the_constructors_of_numpy():
    """Compiled modules write to the memory of the arrays that they construct."""

    def rate(x):
        noise = np.random.default_rng(1).multivariate_normal(np.ones(2), np.eye(2))
        return x + noise + np.random.RandomState(0).multivariate_normal([0, 0], [[1, 0], [0, 1]])

    case = Case("rate", rate, 2)
    expected, found = case.both([0.1, 0.2], [], [0.0, 0.0], 0.0)
    assert expected == found
