"""Reads the expressions of the task ``equations``, and calls functions of NumPy on plain numbers.

The reader follows the grammar of the settings and is independent of the tracer. If the package is
not installed, the modules of Python are loaded without the compiled one.
"""

import ast
import importlib
import importlib.util
import sys
import types
from pathlib import Path

import numpy as np

if importlib.util.find_spec("physgrad") is None:
    package = types.ModuleType("physgrad")
    package.__path__ = [str(Path(__file__).parents[1] / "physgrad")]
    sys.modules["physgrad"] = package
trace = importlib.import_module("physgrad.trace")
distributions = importlib.import_module("physgrad._distributions")

FUNCTIONS = {
    "sin": np.sin,
    "cos": np.cos,
    "tan": np.tan,
    "asin": np.arcsin,
    "acos": np.arccos,
    "atan": np.arctan,
    "atan2": np.arctan2,
    "sinh": np.sinh,
    "cosh": np.cosh,
    "tanh": np.tanh,
    "exp": np.exp,
    "log": np.log,
    "sqrt": np.sqrt,
    "abs": np.abs,
    "min": np.minimum,
    "max": np.maximum,
    "hypot": np.hypot,
    "sign": np.sign,
    "clip": lambda x, low, high: np.minimum(np.maximum(x, low), high),
    "detach": lambda x: x,
}
ARITHMETIC = {ast.Add: np.add, ast.Sub: np.subtract, ast.Mult: np.multiply, ast.Div: np.divide}
COMPARISONS = {ast.Lt: np.less, ast.LtE: np.less_equal, ast.Gt: np.greater, ast.GtE: np.greater_equal}


class Reader:
    """Values of expressions for values of all names. `next.NAME` is the name with its prefix."""

    def __init__(self, define, values):
        self.define, self.known = define, {"pi": np.float64(np.pi), **values}

    def read(self, text):
        return self.number(ast.parse(text.replace("^", "**"), mode="eval").body)

    def name(self, name):
        if name not in self.known:
            self.known[name] = None  # a cycle fails below
            self.known[name] = self.read(self.define[name])
        assert self.known[name] is not None, f"`{name}` depends on itself"
        return self.known[name]

    def number(self, node):
        match node:
            case ast.Constant(value=int() | float() as value):
                return np.float64(value)
            case ast.Name(id=name):
                return self.name(name)
            case ast.Attribute(value=ast.Name(id="next"), attr=name):
                return self.name(f"next.{name}")
            case ast.UnaryOp(op=ast.USub(), operand=operand):
                return -self.number(operand)
            case ast.BinOp(op=ast.Pow(), left=base, right=exponent):
                return self.power(self.number(base), exponent)
            case ast.BinOp(op=op, left=left, right=right):
                return ARITHMETIC[type(op)](self.number(left), self.number(right))
            case ast.Call(func=ast.Name(id="where"), args=[condition, yes, no]):
                return self.number(yes) if self.condition(condition) else self.number(no)
            case ast.Call(func=ast.Name(id=name), args=args):
                return FUNCTIONS[name](*map(self.number, args))
        raise AssertionError(f"no expression: {ast.dump(node)}")

    def power(self, base, exponent):
        literal = exponent.operand if isinstance(exponent, ast.UnaryOp) else exponent
        n = self.number(exponent)
        if not isinstance(literal, ast.Constant) or not float(n).is_integer():
            return np.power(base, n)
        result = np.float64(1.0)
        for _ in range(abs(int(n))):
            result = result * base
        return 1.0 / result if n < 0 else result

    def condition(self, node):
        match node:
            case ast.Compare(left=left, ops=[op], comparators=[right]):
                return bool(COMPARISONS[type(op)](self.number(left), self.number(right)))
            case ast.BoolOp(op=ast.And(), values=values):
                return all(map(self.condition, values))
            case ast.BoolOp(op=ast.Or(), values=values):
                return any(map(self.condition, values))
            case ast.UnaryOp(op=ast.Not(), operand=operand):
                return not self.condition(operand)
        raise AssertionError(f"no condition: {ast.dump(node)}")


class Record(np.ndarray):
    """A plain array of float64 whose components have names."""

    names = ()

    def __array_finalize__(self, other):
        self.names = getattr(other, "names", ())

    def __getattribute__(self, name):
        names = object.__getattribute__(self, "__dict__").get("names", ())
        return self[names.index(name)] if name in names else super().__getattribute__(name)

    def __getitem__(self, key):
        if isinstance(key, slice) and key == slice(None):
            return self
        result = super().__getitem__(self.names.index(key) if isinstance(key, str) else key)
        return np.asarray(result) if isinstance(result, Record) else result

    def __setattr__(self, name, value):
        if name in self.__dict__.get("names", ()):
            self[self.names.index(name)] = value
        else:
            super().__setattr__(name, value)


def record(names, values):
    result = np.array(values, dtype=np.float64).view(Record)
    result.names = tuple(names)
    return result


class Params(types.SimpleNamespace):
    def __getitem__(self, name):
        return vars(self)[name]


def flat(result, states=()):
    """The numbers of a result of a function."""
    if isinstance(result, dict):
        result = [result[name] for name in states or result]
    if isinstance(result, (list, tuple)):
        return [number for part in result for number in flat(part)]
    return [np.float64(number) for number in np.ravel(result)]


class Case:
    """A function and its text, with values of all names."""

    def __init__(self, role, function, states, controls=(), params=None, tables=None, **options):
        rate = None if role in ("rate", "step") else lambda x: np.zeros(len(x))
        functions = {"step" if role == "step" else role: function}
        if role == "rate":
            rate, functions = function, {}
        self.role, self.function, self.params = role, function, dict(params or {})
        self.settings = trace.trace_settings(
            rate,
            states=states,
            controls=controls,
            params=params,
            tables=tables,
            dt=0.1,
            **functions,
            **options,
        )
        self.system = self.settings["system"]
        self.states, self.controls = self.system["states"], self.system["controls"]

    def texts(self):
        if self.role in ("rate", "step"):
            found = self.system["next" if self.role == "step" else "rate"]
            return [found[name] for name in self.states]
        return self.system["observe"] if self.role == "observe" else [self.settings["loss"][self.role[:-5]]]

    def both(self, x, u, next, t, params=None):
        """Numbers of the function on plain arrays, and of the text."""
        scalars = {name: np.float64(value) for name, value in (params or {}).items()}
        given = {
            "x": record(self.states, x),
            "u": record(self.controls, u),
            "next": record(self.states, next),
            "p": Params(**{"dt": np.float64(0.1), **self.params, **scalars}),
            "t": np.float64(t),
        }
        known = {"t": given["t"], "dt": np.float64(0.1), **scalars}
        for group, names, values in (
            ("", self.states, x),
            ("", self.controls, u),
            ("next.", self.states, next),
        ):
            known.update({group + name: np.float64(value) for name, value in zip(names, values, strict=True)})
        reader = Reader(self.system.get("define", {}), known)
        with np.errstate(all="ignore"):
            # In their order, definitions need no deep recursion.
            for name in reader.define:
                reader.name(name)
            found = [reader.read(text) for text in self.texts()]
            order = trace.ARGUMENTS[self.role]
            positional, named = trace.fit(self.role, self.function, {name: given[name] for name in order})
            states = () if self.role == "observe" else self.states
            return flat(self.function(*positional, **named), states), found


def same(a, b):
    """Whether two numbers have equal bits, or both are NaN."""
    return np.isnan(a) and np.isnan(b) or (a == b and np.signbit(a) == np.signbit(b))


def close(a, b, tolerance):
    if not (np.isfinite(a) and np.isfinite(b)):
        return same(a, b)
    return abs(a - b) <= tolerance * max(abs(a), abs(b), 1e-300)
