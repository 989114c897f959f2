"""Operations of JAX on numbers, and its functions whose operations have no equations."""

from __future__ import annotations

import functools
import operator
from collections.abc import Callable
from typing import Any

import numpy as np

from . import _import_numbers as more
from . import _trace_algebra as algebra
from ._trace_elements import ELEMENTWISE, log1p, power
from ._trace_errors import SEARCH
from ._trace_numbers import Condition, Symbol, apply, choose, combine, compare, invert, lift, refuse
from ._trace_numpy import interp
from ._trace_vectors import finish, plain


def constants(eqn: Any, values: list) -> list:
    """Evaluates an operation on constants by JAX."""
    import jax.numpy as jnp

    found = eqn.primitive.bind(*map(jnp.asarray, values), **eqn.params)
    return [np.asarray(v) for v in (found if eqn.primitive.multiple_results else [found])]


def elementwise(function: Callable, values: list, eqn: Any = None) -> Any:
    """Applies a function of numbers. Elements without traced arguments are evaluated by JAX."""
    arrays = np.broadcast_arrays(*map(plain, values))
    out = np.empty(arrays[0].shape, dtype=object)
    fixed = None
    for index in np.ndindex(out.shape):
        args = [array[index] for array in arrays]
        if eqn is not None and not any(isinstance(a, Symbol) for a in args):
            fixed = folded(eqn, values) if fixed is None else fixed
            out[index] = fixed[index]
        else:
            out[index] = function(*args)
    return out


def folded(eqn: Any, values: list) -> np.ndarray:
    """The results of an operation, in which traced elements are replaced by ones."""
    given = []
    for value, atom in zip(values, eqn.invars, strict=True):
        elements = [1 if isinstance(v, Symbol) else v for v in plain(value).flat]
        given.append(np.array(elements, dtype=atom.aval.dtype).reshape(np.shape(value)))
    return constants(eqn, given)[0]


def rule(name: str) -> Callable:
    return lambda _, *args: ELEMENTWISE[name](*map(lift, args))


def of(function: Callable) -> Callable:
    """A rule without parameters."""
    return lambda _, *args: function(*args)


def whole(eqn: Any) -> bool:
    """Whether the numbers of an operation are integers."""
    return eqn.invars[0].aval.dtype.kind in "iu"


def divide(eqn: Any, a: Any, b: Any) -> Any:
    if whole(eqn):
        refuse(TypeError, "an integer division rounds, which equations do not have; divide floating numbers")
    return apply("div", a, b)


def bits(op: str) -> Callable:
    def function(eqn: Any, a: Any, b: Any) -> Any:
        if whole(eqn):
            refuse(TypeError, "bits of traced integers are not known; use comparisons with `&` and `|`")
        return combine(op, a, b)

    return function


def xor(eqn: Any, a: Any, b: Any) -> Any:
    both = bits("and")(eqn, a, b)
    return combine("and", combine("or", a, b), invert(both))


def differs(a: Any, b: Any) -> Any:
    return invert(more.equal(a, b))


def convert(eqn: Any, a: Any) -> Any:
    """A change of type. Conditions stay conditions, which count as 0 and 1."""
    old, new = eqn.invars[0].aval.dtype, eqn.params["new_dtype"]
    if new == np.bool_:
        return more.truth(a)
    if new.kind in "iu" and old.kind == "f":
        refuse(
            TypeError,
            "a change to integers rounds, which equations do not have. Leave out `astype` and `int`",
        )
    if new.kind not in "iu" and new != np.float64:
        refuse(
            TypeError, f"a traced number is a float64, not {new}. Leave out the dtype: `precision` selects it"
        )
    return a


def select(_: Any, which: Any, *cases: Any) -> Any:
    """The case of a condition or of a whole number."""
    if not isinstance(which, Symbol):
        return cases[int(which)]
    if isinstance(which, Condition):
        return choose(which, cases[1], cases[0])
    result = cases[-1]
    for i in range(len(cases) - 2, -1, -1):
        result = choose(compare("lt", which, i + 0.5), cases[i], result)
    return result


def signed_power(eqn: Any, a: Any) -> Any:
    return power(lift(a), float(eqn.params["y"]))


RULES: dict[str, Callable] = {
    "add": rule("add"),
    "add_any": rule("add"),
    "sub": rule("subtract"),
    "mul": rule("multiply"),
    "div": divide,
    "neg": rule("negative"),
    "abs": rule("absolute"),
    "sign": rule("sign"),
    "max": of(more.maximum),
    "min": of(more.minimum),
    "clamp": lambda _, low, a, high: more.minimum(more.maximum(a, low), high),
    "sqrt": rule("sqrt"),
    "rsqrt": of(lambda a: 1.0 / np.sqrt(lift(a))),
    "cbrt": of(more.cbrt),
    "square": rule("square"),
    "integer_pow": signed_power,
    "pow": of(lambda a, b: power(lift(a), b)),
    "exp": rule("exp"),
    "exp2": rule("exp2"),
    "expm1": of(more.expm1),
    "log": rule("log"),
    "log1p": of(lambda a: log1p(lift(a))),
    "logistic": of(more.logistic),
    "erf": of(more.erf),
    "erfc": of(more.erfc),
    **{name: rule(name) for name in ("sin", "cos", "tan", "sinh", "cosh", "tanh")},
    "asin": rule("arcsin"),
    "acos": rule("arccos"),
    "atan": rule("arctan"),
    "atan2": rule("arctan2"),
    "asinh": of(more.asinh),
    "acosh": of(more.acosh),
    "atanh": of(more.atanh),
    "lt": of(functools.partial(compare, "lt")),
    "le": of(functools.partial(compare, "le")),
    "gt": of(functools.partial(compare, "gt")),
    "ge": of(functools.partial(compare, "ge")),
    "eq": of(more.equal),
    "ne": of(differs),
    "and": bits("and"),
    "or": bits("or"),
    "xor": xor,
    "not": lambda eqn, a: invert(a) if not whole(eqn) else bits("and")(eqn, a, a),
    "is_finite": of(more.is_finite),
    "select_n": select,
    "convert_element_type": convert,
    "stop_gradient": of(lambda a: a if isinstance(a, Condition) else apply("detach", a)),
}


def is_of_jax(path: str, options: dict, eqn: Any) -> bool:
    """Whether a function inside is the one of `jax.numpy`, and not another of the same name."""
    import jax

    function = operator.attrgetter(path)(jax.numpy)
    try:
        own = jax.make_jaxpr(functools.partial(function, **options))(*(v.aval for v in eqn.invars)).jaxpr.eqns
    except Exception:
        # The function of the same name takes other arguments, so it is another one.
        return False
    return len(own) == 1 and str(own[0].params.get("jaxpr")) == str(eqn.params.get("jaxpr"))


def rule_of_jax(eqn: Any) -> Callable | None:
    """The rule of a function of `jax.numpy`, if a function inside is one that has a rule."""
    for path, options, found in OF_JAX.get(eqn.params.get("name"), ()):
        if is_of_jax(path, options, eqn):
            return found
    return None


def by_elements(function: Callable) -> Callable:
    return lambda *values: elementwise(function, list(values))


def table(x: Any, places: Any, values: Any, *ends: Any) -> np.ndarray:
    """`jnp.interp` between constant places."""
    return plain(interp(finish(plain(x)), places, finish(plain(values)), *(plain(end)[()] for end in ends)))


def search(*_: Any) -> Any:
    refuse(TypeError, f"jnp.searchsorted is not supported in a traced function. {SEARCH}")


# Functions of `jax.numpy` whose operations have no equations, by their name inside: the path, options,
# and the rule. Infinite constants, bits of numbers, searches and factors occur in them.
OF_JAX: dict[str, list[tuple[str, dict, Callable]]] = {
    "remainder": [("remainder", {}, by_elements(lambda a, b: apply("mod", a, b)))],
    "hypot": [("hypot", {}, by_elements(lambda a, b: apply("hypot", a, b)))],
    "copysign": [("copysign", {}, by_elements(more.copysign))],
    "signbit": [("signbit", {}, by_elements(more.negative))],
    "_interp": [("interp", {}, table)],
    "searchsorted": [("searchsorted", {"side": side}, search) for side in ("left", "right")],
    "det": [("linalg.det", {}, lambda a: plain(algebra.determinant(finish(plain(a)))))],
}
