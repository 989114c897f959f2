"""Refusals of a traced function: each names the file and the line of the user and what to write."""

from __future__ import annotations

import contextlib
import difflib
import linecache
import os
import re
import sys
from collections.abc import Iterable, Iterator
from typing import NoReturn

# Frames of these packages are not code of the user.
PACKAGES = ("numpy", "jax", "jaxlib", "casadi", __name__.split(".")[0])
# Places of operations in imported functions, which do not run as lines of Python. The last counts.
PLACES: list[str] = []

BRANCH = (
    "The value of {what} is not known while the function is traced, so Python cannot branch on it. {hint}"
)
WHERE = "Write `np.where(condition, a, b)` in place of `if` and of `a if condition else b`"
INDEX = "An index that depends on values is not possible. "
SELECT = INDEX + "Write `np.minimum`, `np.where` or `np.interp` for the number that it selects"
SEARCH = INDEX + "Write `np.interp(x, places, values)` in place of the search and the lookup"
ORDER = "Of two numbers, `np.minimum(a, b)` is the first and `np.maximum(a, b)` the second"
LOOP = "A loop needs a fixed number of turns, as `for _ in range(10)`, with `np.where` inside"
# Hints for a branch, by the line of the user. The first that matches is given.
BRANCHES = [
    (r"\bassert\b", "Leave the assertion out"),
    (r"\barg(min|max)\(", SELECT),
    (r"\b(searchsorted|digitize|bisect\w*)\(", SEARCH),
    (r"(?<![\w.])sorted\(|\.sort\(", f"Their order is not known either. {ORDER}"),
    (r"(?<![\w.])(any|all)\(", "Write `np.any(np.array([...]))` or `np.all(np.array([...]))`"),
    (
        r"(?<![\w.])(max|min)\(",
        "Write `np.maximum(a, b)` or `np.minimum(a, b)` in place of Python's `max` and `min`",
    ),
    (r"\b(and|or|not)\b", "Write `(a < x) & (x < b)`, `|` and `~` in place of `and`, `or` and `not`"),
    (r"[<>]=?[^<>()&|,]+[<>]=?", "Write `(a < x) & (x < b)` in place of `a < x < b`"),
    (r"\bwhile\b", LOOP),
    (r"\bif\b", WHERE),
]
# Functions of the module `math` that have another name in NumPy.
OF_MATH = {"pow": "power", "asin": "arcsin", "acos": "arccos", "atan": "arctan", "atan2": "arctan2"}
LIST = "; if there is no `if`, NumPy needs `np.array([...])` in place of a list of traced numbers"


def user_frame():
    """The innermost frame that runs code of the user."""
    frame = sys._getframe(1)
    while frame.f_back and frame.f_globals.get("__name__", "").split(".")[0] in PACKAGES:
        frame = frame.f_back
    return frame


def name_of(path: str) -> str:
    """The path of a file, relative if it is below the working directory."""
    below = os.path.join(os.getcwd(), "")
    return path[len(below) :] if path.startswith(below) else path


def place() -> str:
    """File and line of the user that runs now, as `tanks.py:12`."""
    if PLACES:
        return PLACES[-1]
    frame = user_frame()
    return f"{name_of(frame.f_code.co_filename)}:{frame.f_lineno}"


@contextlib.contextmanager
def at_place(text: str) -> Iterator[None]:
    """Gives errors another place than the line that runs."""
    PLACES.append(text)
    try:
        yield
    finally:
        PLACES.pop()


def line() -> str:
    """The text of the line of the user that runs now. Empty without a file."""
    frame = user_frame()
    return linecache.getline(frame.f_code.co_filename, frame.f_lineno, frame.f_globals)


def begin(function) -> str:
    """File and first line of a function, and its name."""
    code = getattr(getattr(function, "__func__", function), "__code__", None)
    name = getattr(function, "__name__", type(function).__name__)
    return f"{name_of(code.co_filename)}:{code.co_firstlineno}: `{name}`" if code else f"`{name}`"


def branch_hint() -> str:
    """What to write in place of a branch, judged by the line of the user."""
    text = line()
    # Functions of NumPy compare the elements of a list.
    other = WHERE + LIST if re.search(r"\bn(p|umpy)\.", text) else WHERE
    return next((hint for pattern, hint in BRANCHES if re.search(pattern, text)), other)


LOOKUP = (
    f"{INDEX}Write `np.interp(a, places, values)` or `np.where(a < 1, b, c)` in place of a lookup, and "
    "`pg.table(values)` for values over time"
)
# Hints for a value, by the line of the user. The first that matches is given.
VALUES = [
    (r"(?<![\w.])round\(", "Rounding has no useful derivative; leave it out"),
    (r"float(32|16)", "Leave out the dtype: the setting `precision` selects it"),
    (r"[\w\])]\[[^\]]*\bint\(", LOOKUP),
    (r"(?<![\w.])int\(", "Rounding has no useful derivative; leave out `int`"),
    (
        r"(?<![\w.])float\(",
        "Keep the number traced: leave out `float`, and compute with functions of NumPy",
    ),
    (
        r"\][^=]*=[^=]",
        "The array holds fixed numbers only, as those from outside of the function and those of integers do. "
        "Create it by `np.zeros(n)` inside of the function, with NumPy imported at the top of the file",
    ),
]


def value_hint(index: bool) -> str:
    """What to write in place of `float(x)` and its like, judged by the line of the user."""
    text = line()
    if re.search(r"(?<![\w.])range\(", text):
        return LOOP
    called = re.search(r"\bmath\.(\w+)", text)
    if called and called[1] in ("floor", "ceil", "trunc", "fmod", "remainder"):
        return f"`math.{called[1]}` jumps and has no useful derivative. Leave it out, or write `np.where`"
    if called:
        return f"Write `np.{OF_MATH.get(called[1], called[1])}` in place of `math.{called[1]}`"
    if index:
        return LOOKUP
    other = "Use functions of NumPy, and leave out `float`, `int` and `astype`"
    return next((hint for pattern, hint in VALUES if re.search(pattern, text)), other)


def place_of(error: BaseException) -> str | None:
    """The last place of an error in code of the user."""
    found, step = None, error.__traceback__
    while step is not None:
        frame = step.tb_frame
        if frame.f_globals.get("__name__", "").split(".")[0] not in PACKAGES:
            found = f"{name_of(frame.f_code.co_filename)}:{step.tb_lineno}"
        step = step.tb_next
    return found


def near(name: str, names: Iterable[str], likeness: float = 0.5) -> str:
    """`; did you mean ...?` for a wrong name, with all names if there are few."""
    names = [str(known) for known in names]
    found = difflib.get_close_matches(str(name), names, 3, likeness)
    if found:
        return f"; did you mean {' or '.join(f'`{known}`' for known in found)}?"
    return f"; there are {', '.join(names)}" if 0 < len(names) <= 12 else ""


def fail(kind: type[Exception], message: str) -> NoReturn:
    """Raises an error with the file and the line of the user."""
    raise kind(f"{place()}: {message}")
