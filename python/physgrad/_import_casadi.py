"""Functions of CasADi, as a `casadi.Function` holds them: a list of operations on numbers."""

from __future__ import annotations

import inspect
import keyword
import math
import sys
from collections.abc import Callable
from typing import Any

import numpy as np

from . import _import_numbers as more
from ._trace_arrays import of_numpy
from ._trace_elements import ELEMENTWISE, log1p, power
from ._trace_errors import at_place
from ._trace_numbers import apply, choose, combine, compare, lift, refuse
from ._trace_vectors import Parameters, finish, plain


def rule(name: str) -> Callable:
    """The rule of a function of NumPy, for numbers. Comparisons count as 0 and 1."""
    return lambda *args: ELEMENTWISE[name](*map(lift, args))


def if_else_zero(condition: Any, value: Any) -> Any:
    return choose(more.truth(condition), lift(value), lift(0.0))


def remainder(a: Any, b: Any) -> Any:
    """The remainder by a full turn is the angle between -pi and pi."""
    if lift(b).call.graph.number(lift(b).id) != 2 * math.pi:
        refuse(TypeError, NO_RULE["OP_REMAINDER"])
    return np.arctan2(np.sin(lift(a)), np.cos(lift(a)))


def same(a: Any, *_: Any) -> Any:
    return a


# Operations of CasADi by the name of their number in the module.
RULES: dict[str, Callable] = {
    "OP_ASSIGN": same,
    "OP_LIFT": same,
    "OP_PRINTME": same,
    "OP_ADD": rule("add"),
    "OP_SUB": rule("subtract"),
    "OP_MUL": rule("multiply"),
    "OP_DIV": rule("divide"),
    "OP_NEG": rule("negative"),
    "OP_EXP": rule("exp"),
    "OP_LOG": rule("log"),
    "OP_POW": lambda a, b: power(lift(a), b),
    "OP_CONSTPOW": lambda a, b: power(lift(a), b),
    "OP_SQRT": rule("sqrt"),
    "OP_SQ": rule("square"),
    "OP_TWICE": lambda a: apply("mul", 2.0, a),
    "OP_INV": rule("reciprocal"),
    "OP_SIN": rule("sin"),
    "OP_COS": rule("cos"),
    "OP_TAN": rule("tan"),
    "OP_ASIN": rule("arcsin"),
    "OP_ACOS": rule("arccos"),
    "OP_ATAN": rule("arctan"),
    "OP_ATAN2": rule("arctan2"),
    "OP_SINH": rule("sinh"),
    "OP_COSH": rule("cosh"),
    "OP_TANH": rule("tanh"),
    "OP_ASINH": more.asinh,
    "OP_ACOSH": more.acosh,
    "OP_ATANH": more.atanh,
    "OP_HYPOT": rule("hypot"),
    "OP_LOG1P": lambda a: log1p(lift(a)),
    "OP_EXPM1": more.expm1,
    "OP_ERF": more.erf,
    "OP_FABS": rule("absolute"),
    "OP_SIGN": rule("sign"),
    "OP_COPYSIGN": more.copysign,
    "OP_FMIN": more.fmin,
    "OP_FMAX": more.fmax,
    "OP_REMAINDER": remainder,
    "OP_LT": lambda a, b: compare("lt", a, b),
    "OP_LE": lambda a, b: compare("le", a, b),
    "OP_EQ": more.equal,
    "OP_NE": lambda a, b: ELEMENTWISE["invert"](more.equal(a, b)),
    "OP_NOT": lambda a: ELEMENTWISE["invert"](more.truth(a)),
    "OP_AND": lambda a, b: combine("and", more.truth(a), more.truth(b)),
    "OP_OR": lambda a, b: combine("or", more.truth(a), more.truth(b)),
    "OP_IF_ELSE_ZERO": if_else_zero,
}
JUMPS = (
    "{name} is constant between jumps, so its derivative says nothing, and equations do not have it. Leave "
    "the rounding out, or write `if_else` with comparisons"
)
ANGLE = (
    "{name} jumps, and equations do not have it. Write `atan2(sin(a), cos(a))` or `remainder(a, 2*pi)` for "
    "an angle, and `sin(2*pi*t/period)` for a cycle"
)
# Operations without a rule: the message.
NO_RULE = {
    "OP_FLOOR": JUMPS.format(name="floor") + ". For an angle, write `atan2(sin(a), cos(a))`",
    "OP_CEIL": JUMPS.format(name="ceil"),
    "OP_FMOD": ANGLE.format(name="fmod"),
    "OP_REMAINDER": ANGLE.format(name="a remainder by another number than 2*pi"),
    "OP_ERFINV": "erfinv is not a function of equations. Leave it out, or write an approximation",
}
CALLS_OTHER = (
    "it calls {found}, which CasADi cannot write as operations on numbers. Replace it by its formula, and a "
    "table by `pg.table` or by `if_else`"
)
LINEAR_SOLVER = (
    "CasADi cannot write `solve` and `inv` of MX as operations on numbers. Build the function with SX, or "
    "write `inv_minor(A) @ b`"
)


class CasadiFunction:
    """A `casadi.Function` as a function of traced numbers, whose arguments have the names of its inputs."""

    def __init__(self, function: Any) -> None:
        self.function, self.__name__ = function, function.name()
        # An input without elements, as the algebraic states of a model without any, needs no value.
        self.inputs = [i for i in range(function.n_in()) if function.numel_in(i)]
        self.names = {argument(function.name_in(i)): i for i in self.inputs}
        kind = inspect.Parameter.POSITIONAL_OR_KEYWORD
        self.__signature__ = inspect.Signature([inspect.Parameter(name, kind) for name in self.names])

    def __call__(self, *args: Any, **named: Any) -> Any:
        given = dict(zip(self.names, args, strict=False)) | named
        with of_numpy(), at_place(f"`{self.__name__}`"):
            function = self.one_output()
            values = {i: self.elements(i, given[name]) for name, i in self.names.items()}
            return self.evaluate(self.operations(function), values)

    def one_output(self) -> Any:
        function = self.function
        if function.n_out() != 1:
            outputs = ", ".join(function.name_out()) or "none"
            refuse(
                ValueError,
                f"the function has {function.n_out()} outputs: {outputs}. Give one of them: "
                f"`f.slice('{function.name_out(0) if function.n_out() else 'f'}', "
                f"range({function.n_in()}), [0])` has the first",
            )
        return function

    def operations(self, function: Any) -> Any:
        """The function with all calls of other functions written out."""
        if function.has_free():
            free = ", ".join(str(symbol) for symbol in function.get_free())
            refuse(ValueError, f"the symbols {free} are not inputs. Add them to the inputs, as `p` or others")
        inner = [f for f in function.find_functions() if f.class_name() not in ("SXFunction", "MXFunction")]
        found = ", ".join(f"`{f.name()}` ({f.class_name()})" for f in inner)
        if function.class_name() not in ("SXFunction", "MXFunction"):
            found = ", ".join([f"`{function.name()}` ({function.class_name()})", *[found] * bool(found)])
        try:
            expanded = function.expand()
        except RuntimeError as error:
            reason = str(error).strip().splitlines()[-1]
            if "Linsol" in reason:
                refuse(TypeError, LINEAR_SOLVER)
            refuse(TypeError, CALLS_OTHER.format(found=found or "a function") + f". CasADi says: {reason}")
        casadi = sys.modules["casadi"]
        if any(expanded.instruction_id(k) == casadi.OP_CALL for k in range(expanded.n_instructions())):
            refuse(TypeError, CALLS_OTHER.format(found=found or "another function"))
        return expanded

    def elements(self, i: int, value: Any) -> list:
        """The numbers of an argument that are not zeros by structure, by columns."""
        numbers = [n for part in parts(value) for n in part]
        wanted, shape = self.function.numel_in(i), self.function.size_in(i)
        if len(numbers) != wanted:
            names = f": {', '.join(value.keys())}" if isinstance(value, Parameters) else ""
            refuse(
                ValueError,
                f"the input `{self.function.name_in(i)}` has the shape {shape}, and its argument "
                f"{len(numbers)} numbers{names}. Inputs have the names x, u, p, t, next, or their order",
            )
        return [numbers[k] for k in self.function.sparsity_in(i).find()]

    def evaluate(self, function: Any, inputs: dict[int, list]) -> Any:
        casadi = sys.modules["casadi"]
        names = {getattr(casadi, name): name for name in dir(casadi) if name.startswith("OP_")}
        work: list = [None] * function.sz_w()
        found: dict[int, Any] = {}
        for k in range(function.n_instructions()):
            name = names.get(function.instruction_id(k), f"operation {function.instruction_id(k)}")
            taken, given = function.instruction_input(k), function.instruction_output(k)
            if name == "OP_CONST":
                work[given[0]] = function.instruction_constant(k)
            elif name == "OP_INPUT":
                work[given[0]] = inputs[taken[0]][taken[1]]
            elif name == "OP_OUTPUT":
                found[given[1]] = lift(work[taken[0]])
            elif name in RULES:
                work[given[0]] = RULES[name](*(work[place] for place in taken))
            else:
                refuse(TypeError, NO_RULE.get(name, f"{name} of CasADi is not supported; write it otherwise"))
        out = np.full(function.numel_out(0), np.float64(0.0), dtype=object)
        for k, place in enumerate(function.sparsity_out(0).find()):
            out[place] = found[k]
        return finish(out)


def argument(name: str) -> str:
    """The name of an input as that of an argument: do-mpc writes `_x`, integrators of CasADi write `x0`."""
    name = name.strip("_") or name
    return {"x0": "x"}.get(name, name) + ("_" if keyword.iskeyword(name) else "")


def parts(value: Any) -> list[list]:
    """The numbers of an argument. Arrays among the parameters are read by columns, as CasADi has them."""
    values = value.values() if isinstance(value, Parameters) else [value]
    return [list(plain(v).ravel(order="F")) for v in values]


def is_casadi(function: Any) -> bool:
    """Whether a value is a function of CasADi, without importing CasADi."""
    casadi = sys.modules.get("casadi")
    return casadi is not None and isinstance(function, casadi.Function)
