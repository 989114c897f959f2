"""Systems as functions of NumPy: `system` calls each function with symbolic numbers, and writes equations.

The functions are called twice when the system is made and never again. Their operations become
expressions in the settings of the task `equations`, so scenes and run folders need no Python.
Operations, their order and their constants are those of NumPy in float64. A function that cannot
become equations raises an error with its file and line.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Iterable, Sequence
from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar

import numpy as np

from . import _trace_numbers as numbers
from . import _trace_numpy  # noqa: F401 (gives traced numbers their operators)
from ._distributions import finite, table
from ._import_casadi import CasadiFunction, is_casadi
from ._import_jax import JaxFunction
from ._trace_arrays import constructors
from ._trace_errors import begin, near, place_of
from ._trace_graph import FUNCTIONS, Graph, Text
from ._trace_numbers import CALLS, Call, Condition, check_call, compare, is_traced, lift
from ._trace_vectors import Parameters, plain, vector

__all__ = ["detach", "system", "trace_settings"]

# Arguments of each function, in the order of functions that use other names.
ARGUMENTS = {
    "rate": ("x", "u", "p", "t"),
    "step": ("x", "u", "p", "t"),
    "observe": ("x", "p", "t"),
    "running_cost": ("x", "u", "next", "p", "t"),
    "terminal_cost": ("x", "p"),
    "end": ("x", "p"),
}
RESERVED = FUNCTIONS | {"t", "dt", "pi", "next", "and", "or", "not", "inf", "nan"}
# Other words that name an argument.
ALIASES = {
    "state": "x",
    "states": "x",
    "control": "u",
    "controls": "u",
    "action": "u",
    "params": "p",
    "param": "p",
    "parameters": "p",
    "time": "t",
    "next_state": "next",
    "next_x": "next",
    "x_next": "next",
}
HINT = ". NumPy cannot compute this with a list of traced numbers; write `np.array([...])` of it first"
# Words of NumPy about arrays of objects, after which the hint helps.
OF_OBJECTS = re.compile(r"dtype\('O'\)|loop of ufunc|not supported for the input types|only integers, slices")
# Words about the number of elements, after which a tuple in `params` may be meant as a distribution.
OF_SHAPES = re.compile(r"shape|element|length|dimension|broadcast|scalar|returned a")
# Words of JAX about values that are not its own.
OF_JAX = re.compile(r"as an abstract array|JAX|np\.result_type")
if TYPE_CHECKING:
    from ._core import Task

Names = Sequence[str] | int
P = ParamSpec("P")
R = TypeVar("R")
Function = Callable[..., Any]


def detach(value: Any) -> Any:
    """A number or an array whose derivative is 0, in a function of `system`."""
    if not is_traced(value):
        return value
    from ._trace_elements import elementwise

    return elementwise(lambda a: numbers.apply("detach", a), value)


def names(what: str, given: Names, prefix: str) -> list[str]:
    """A list of names, or as many names as a count says."""
    if isinstance(given, (int, np.integer)) and not isinstance(given, bool):
        if given < 0:
            raise ValueError(f"`{what}` is {given}; allowed: 0 or more, or a list of names")
        return [f"{prefix}{i + 1}" for i in range(given)]
    if isinstance(given, str):
        raise TypeError(
            f"`{what}` is the text {given!r}; give a list of names, as in {what}=[{given!r}], or a count"
        )
    if isinstance(given, bool) or not isinstance(given, Iterable):
        raise TypeError(f"`{what}` is of type {type(given).__name__}; allowed: a list of names, or a count")
    return list(given)


def check_dict(what: str, given: Any) -> dict[str, Any]:
    """The items of an argument that is a dict or None."""
    if given is None:
        return {}
    if not hasattr(given, "items"):
        raise TypeError(f"`{what}` is of type {type(given).__name__}; allowed: a dict, by name")
    return dict(given)


def check_names(groups: dict[str, Iterable[str]]) -> None:
    """Refuses names that the text could not tell apart."""
    seen: dict[str, str] = {}
    for group, labels in groups.items():
        for label in labels:
            if not isinstance(label, str) or not re.fullmatch(r"[A-Za-z_][A-Za-z0-9_]*", label):
                raise ValueError(f"{label!r} in `{group}` is not a name of letters, digits and `_`")
            if label in RESERVED:
                raise ValueError(f"`{label}` in `{group}` has a meaning in expressions; choose another name")
            if label in seen:
                where = "twice" if seen[label] == group else f"in `{seen[label]}` and in `{group}`"
                raise ValueError(f"the name `{label}` is {where}; names must differ")
            seen[label] = group


def check_keys(what: str, given: Iterable[str], known: Iterable[str]) -> None:
    known = list(known)
    for key in given:
        if key not in known:
            raise ValueError(f"`{what}` has no `{key}`{near(key, known)}")


def by_order(what: str, given: Any, labels: list[str]) -> dict[str, Any]:
    """Values by name, from a dict or from a list in the order of the names."""
    if given is None:
        return {}
    if not hasattr(given, "items"):
        if isinstance(given, str) or not isinstance(given, Iterable):
            kind = type(given).__name__
            raise TypeError(f"`{what}` is of type {kind}; allowed: a dict or a list of numbers")
        given = list(given)
        if len(given) != len(labels):
            raise ValueError(f"`{what}` has {len(given)} values; expected {len(labels)}: {', '.join(labels)}")
        return dict(zip(labels, given, strict=True))
    check_keys(what, given, labels)
    return dict(given)


def number_or_table(what: str, value: Any) -> Any:
    """A number or a distribution as a setting."""
    if isinstance(value, dict):
        return value
    if isinstance(value, np.ndarray) and value.ndim == 0:
        value = value.item()
    return finite(what, value)[0]


class Plan:
    """What the functions receive: names, constants and bounds."""

    def __init__(self, states: Names, controls: Any, params: Any, tables: Any) -> None:
        params, tables = check_dict("params", params), check_dict("tables", tables)
        self.bounds = {}
        if hasattr(controls, "items"):
            self.bounds = {
                name: self.bound(name, pair) for name, pair in controls.items() if pair is not None
            }
        self.states = names("states", states, "x")
        self.controls = names("controls", controls, "u")
        if not self.states:
            raise ValueError("`states` is empty; a system has at least one state")
        self.order = [*params, *tables]
        self.tables = {
            name: (value if isinstance(value, table) else table(value)).values
            for name, value in tables.items()
        }
        self.parameters: dict[str, Any] = {}
        self.arrays: dict[str, np.ndarray] = {}
        # Names that functions have read, and tuples of two numbers.
        self.used: set[str] = set()
        self.pairs = {
            name: value
            for name, value in params.items()
            if isinstance(value, tuple) and len(value) == 2
        }
        for name, value in params.items():
            if isinstance(value, table):
                self.tables[name] = value.values
            elif isinstance(value, (list, tuple)) or isinstance(value, np.ndarray) and value.ndim > 0:
                self.arrays[name] = self.array(name, value)
            else:
                self.parameters[name] = number_or_table(f"parameter `{name}`", value)
        groups = {
            "states": self.states,
            "controls": self.controls,
            "params": params,
            "tables": tables,
        }
        check_names(groups)
        self.labels = [label for group in groups.values() for label in group]

    @staticmethod
    def bound(name: str, pair: Any) -> list[float]:
        if np.shape(pair) != (2,):
            raise ValueError(f"the bounds of the control `{name}` are {pair!r}; expected (low, high) or None")
        low, high = finite(f"bounds of `{name}`", *pair)
        if not low < high:
            raise ValueError(
                f"the bounds of the control `{name}` are {low} and {high}; low must be below high"
            )
        return [low, high]

    def tuples(self) -> str:
        """What to write for the parameters that are pairs, if they are meant as distributions."""
        return "".join(
            f". The parameter `{name}` is a tuple, which is an array of constants; a number that is drawn "
            f"in every rollout is `pg.uniform{self.pairs[name]}`"
            for name in self.pairs
            if name in self.used
        )

    @staticmethod
    def array(name: str, value: Any) -> np.ndarray:
        array = np.array(value)
        if array.dtype.kind not in "iuf":
            raise TypeError(
                f"parameter `{name}` is an array of {array.dtype}; an array holds constant numbers"
            )
        array.setflags(write=False)
        return array

    def arguments(self, role: str) -> dict[str, Any]:
        """The traced arguments of a function. Names of tables have no value after the last step."""
        left_out = self.tables if role in ("terminal_cost", "end") else ()
        values = {
            name: self.arrays[name] if name in self.arrays else numbers.name(name)
            for name in self.order
            if name not in left_out
        }
        found = {
            "x": vector(self.states),
            "u": vector(self.controls),
            "p": Parameters(values, self.used, numbers.name("dt")),
            "next": vector(self.states, "next."),
            "t": numbers.name("t"),
        }
        return {name: found[name] for name in ARGUMENTS[role]}


def fit(role: str, function: Function, given: dict[str, Any]) -> tuple[list[Any], dict[str, Any]]:
    """The arguments of a function: by name if all its names are known, and otherwise in their order."""
    where = begin(function)
    try:
        parameters = list(inspect.signature(function).parameters.values())
    except (TypeError, ValueError):
        raise TypeError(
            f"`{role}` is {function!r}; give a function of Python, with arguments among {', '.join(given)}"
        ) from None
    role_of = {p.name: ALIASES.get(p.name, p.name) for p in parameters}
    variadic = [p for p in parameters if p.kind is p.VAR_POSITIONAL]
    wanted = [p for p in parameters if p.kind not in (p.VAR_POSITIONAL, p.VAR_KEYWORD)]
    wanted = [p for p in wanted if p.default is p.empty or role_of[p.name] in given]
    if not variadic and all(role_of[p.name] in given for p in wanted):
        positional = [given[role_of[p.name]] for p in wanted if p.kind is p.POSITIONAL_ONLY]
        return positional, {p.name: given[role_of[p.name]] for p in wanted if p.kind is not p.POSITIONAL_ONLY}
    order = list(given)
    receives = f"`{role}` receives {', '.join(order)}, by these names or in this order"
    every = {name for arguments in ARGUMENTS.values() for name in arguments}
    for place, p in enumerate(wanted):
        found = role_of[p.name]
        if found in every and order[place : place + 1] != [found] or p.kind is p.KEYWORD_ONLY:
            unknown = [p.name for p in wanted if role_of[p.name] not in every]
            missing = [name for name in order if name not in role_of.values()]
            # A known name is out of place because of one that is not known.
            if found in order and unknown and missing:
                raise TypeError(
                    f"{where} has an argument `{unknown[0]}` that does not fit; rename it `{missing[0]}`. "
                    f"{receives}"
                )
            raise TypeError(f"{where} has an argument `{p.name}` that does not fit: {receives}")
    if len(wanted) > len(order):
        found = ", ".join(p.name for p in wanted)
        raise TypeError(
            f"{where} has the arguments {found}; {receives}"
        )
    return list(given.values())[: None if variadic else len(wanted)], {}


def flatten(role: str, where: str, result: Any) -> list[Any]:
    """The numbers of a result, of any nesting."""
    if isinstance(result, (list, tuple)):
        return [number for part in result for number in flatten(role, where, part)]
    if isinstance(result, np.ndarray) and plain(result).ndim > 0:
        return [number for part in plain(result).flat for number in flatten(role, where, part)]
    if result is None:
        raise TypeError(f"{where} returned None, or a list with None; is a `return` missing?")
    if not is_traced(result) and not isinstance(result, (int, float, np.number, np.bool_, np.ndarray)):
        raise TypeError(
            f"{where} returned an object of type {type(result).__name__}; expected {EXPECTED[role]}"
        )
    if not is_traced(result) and not np.isfinite(result):
        raise ValueError(f"{where} returned a number that is not finite: {result}")
    return [lift(result)]


EXPECTED = {
    "rate": "one number per state",
    "step": "one number per state",
    "observe": "a list of numbers",
    "running_cost": "one number",
    "terminal_cost": "one number",
    "end": "one condition on the state, such as `x.height < 0.7`",
}


def components(role: str, where: str, result: Any, states: list[str]) -> list[Any]:
    """The numbers of a result, in the order of the states."""
    if isinstance(result, dict) and role != "observe":
        if role.endswith("cost") or sorted(map(str, result)) != sorted(states):
            expected = "one number" if role.endswith("cost") else f"the states {', '.join(states)}"
            raise ValueError(
                f"{where} returned a dict with {', '.join(map(str, result)) or 'no keys'}; expected "
                f"{expected}"
            )
        result = [result[name] for name in states]
    elif isinstance(result, dict):
        result = list(result.values())
    shape = shape_of(result)
    found = flatten(role, where, result)
    count = {"observe": len(found), "running_cost": 1, "terminal_cost": 1}.get(role, len(states))
    if len(found) != count or not found:
        order = f": {', '.join(states)}" if role in ("rate", "step") else ""
        raise ValueError(f"{where} returned {shape}; `{role}` returns {EXPECTED[role]}{order}")
    return found


def condition(function: Function, result: Any) -> Condition:
    """The condition that a function returned. In CasADi, conditions are numbers, 0 or 1."""
    while isinstance(result, (list, tuple, np.ndarray)) and np.size(result) == 1:
        result = result[0] if isinstance(result, (list, tuple)) else plain(result).item()
    if isinstance(function, CasadiFunction) and is_traced(result):
        result = compare("gt", result, 0.5)
    if isinstance(result, Condition):
        check_call(result)
        return result
    found = shape_of(result) if is_traced(result) or np.size(result) > 1 else repr(result)
    raise TypeError(f"{begin(function)} returned {found}; `end` returns {EXPECTED['end']}")


def shape_of(result: Any) -> str:
    if isinstance(result, (list, tuple)):
        return f"a {type(result).__name__} of {len(result)} elements"
    return f"an array of shape {plain(result).shape}" if isinstance(result, np.ndarray) else "one number"


def traced(graph: Graph, plan: Plan, role: str, function: Function) -> list[int]:
    """Calls a function of the user, and returns the nodes of its result."""
    if not callable(function):
        raise TypeError(
            f"`{role}` is of type {type(function).__name__}; give a function with arguments "
            f"{', '.join(ARGUMENTS[role])}"
        )
    call = Call(graph)
    CALLS.append(call)
    try:
        positional, named = fit(role, function, plan.arguments(role))
        result = function(*positional, **named)
        if role == "end":
            found = [condition(function, result)]
        else:
            found = components(role, begin(function), result, plan.states)
    except Exception as error:
        reported = call.refused or error
        if OF_SHAPES.search(str(reported)) and len(reported.args) == 1:
            reported.args = (f"{reported}{plan.tuples()}",)
        if reported is not error:
            raise reported from error
        words = " ".join([str(error), *getattr(error, "__notes__", ())])
        if OF_JAX.search(words) and not isinstance(function, JaxFunction) and hasattr(error, "add_note"):
            error.add_note(f"If `{role}` is written with jax.numpy, give pg.from_jax(function)")
        place = place_of(error)
        if call.refused is None and place and place not in str(error) and hasattr(error, "add_note"):
            error.add_note(
                f"{place}: raised in `{role}`, while it was traced"
                + (HINT if OF_OBJECTS.search(str(error)) else "")
            )
        raise
    finally:
        CALLS.pop()
    if call.refused is not None:
        raise call.refused
    return [number.id for number in found]


def equations(plan: Plan, functions: dict[str, Function]) -> dict[str, Any]:
    """Definitions, and expressions by function."""
    graph = Graph()
    # Equal operations of a second call are the same nodes. Its order is another one, for functions that
    # share a variable.
    outputs, again = (
        {role: traced(graph, plan, role, functions[role]) for role in roles}
        for roles in ([*functions], [*reversed(functions)])
    )
    for role, function in functions.items():
        if outputs[role] != again[role]:
            raise ValueError(
                f"{begin(function)} gave other equations when it was called again. A function must not "
                "draw random numbers, count its calls or change variables. In `params`, pg.uniform is drawn "
                "for each rollout and pg.noise in each step; states are memory"
            )
    text = Text(graph, [id for ids in outputs.values() for id in ids], [*plan.labels, *RESERVED])
    return {
        "define": text.define,
        **{role: [text.shown[id][0] for id in ids] for role, ids in outputs.items()},
    }


def trace_settings(
    rate: Function | None = None,
    *,
    step: Function | None = None,
    states: Names,
    controls: Any = (),
    params: dict[str, Any] | None = None,
    tables: dict[str, Any] | None = None,
    dt: float,
    method: str | None = None,
    substeps: int | None = None,
    horizon: int = 100,
    start: Any = None,
    observe: Function | None = None,
    running_cost: Function | None = None,
    terminal_cost: Function | None = None,
    end: Function | None = None,
    angles: Sequence[str] = (),
    units: dict[str, str] | None = None,
    **settings: Any,
) -> dict[str, Any]:
    """The settings of the task `equations` for functions of NumPy, with the arguments of `system`."""
    if (rate is None) == (step is None):
        raise TypeError(
            "give either the rate, as first argument, or `step=`, a function that returns the next state"
        )
    if step is not None and (method is not None or substeps is not None):
        raise TypeError("`method` and `substeps` belong to a rate; `step=` returns the next state itself")
    plan = Plan(states, controls, params, tables)
    given = {
        "rate": rate,
        "step": step,
        "observe": observe,
        "running_cost": running_cost,
        "terminal_cost": terminal_cost,
        "end": end,
    }
    functions: dict[str, Function] = {
        role: CasadiFunction(function) if is_casadi(function) else function
        for role, function in given.items()
        if function is not None
    }
    with constructors(functions.values()):
        found = equations(plan, functions)
    starts = by_order("start", start, plan.states)
    if isinstance(angles, (int, np.integer)):
        raise TypeError(f"`angles` is {angles!r}; allowed: a list of names of states")
    check_keys("angles", names("angles", angles, ""), plan.states)
    units = check_dict("units", units)
    check_keys("units", units, plan.labels)
    system: dict[str, Any] = {
        "states": plan.states,
        "controls": plan.controls,
        "dt": finite("`dt`", dt)[0],
        "angles": list(angles),
        "bounds": plan.bounds,
        "units": units,
        "parameters": plan.parameters,
        "start": {name: number_or_table(f"start of `{name}`", value) for name, value in starts.items()},
        "tables": plan.tables,
        "define": found["define"],
        "observe": found.get("observe", []),
    }
    if system["dt"] <= 0:
        raise ValueError(f"`dt` is {system['dt']}; a time step is positive")
    kind, role = ("rate", "rate") if rate is not None else ("next", "step")
    result: dict[str, Any] = {
        "task": "equations",
        "horizon": horizon,
        "system": {
            key: value for key, value in system.items() if value or key in ("states", "controls", "dt")
        },
        "loss": {
            key: found[role][0]
            for key, role in (("running", "running_cost"), ("terminal", "terminal_cost"), ("end", "end"))
            if role in found
        },
        "integrator": {}
        if rate is None
        else {"method": method or "rk4", **({} if substeps is None else {"substeps": substeps})},
    }
    result["system"][kind] = dict(zip(plan.states, found[role], strict=True))
    return merge(result, settings)


def merge(result: dict[str, Any], settings: dict[str, Any]) -> dict[str, Any]:
    """Adds other settings, which must not replace those of the functions."""
    for key, value in settings.items():
        if key in ("loss", "integrator", "system") and isinstance(value, dict):
            twice = sorted(result[key].keys() & value.keys())
            if twice:
                raise ValueError(
                    f"`{key}.{twice[0]}` is given twice: in `{key}`, and by an argument of `system`"
                )
            result[key].update(value)
        elif key in ("task", "loss", "integrator", "system"):
            raise TypeError(f"`{key}` is {value!r}; give a dict of the settings of its section")
        else:
            result[key] = value
    return {key: value for key, value in result.items() if value != {}}


# Errors in the arguments of `system` are raised by the call of this function.
trace_settings.__qualname__ = "system"


def with_arguments_of(function: Callable[P, Any]) -> Callable[[Callable[..., R]], Callable[P, R]]:
    """Gives a function the signature of another one, for `help`, completion and checkers of types."""

    def decorate(other: Callable[..., R]) -> Callable[P, R]:
        result = inspect.signature(other).return_annotation
        setattr(other, "__signature__", inspect.signature(function).replace(return_annotation=result))
        return other

    return decorate


@with_arguments_of(trace_settings)
def system(*arguments: Any, **settings: Any) -> Task:
    """Opens a task whose dynamics and costs are functions of NumPy.

    `rate` returns the derivative of the state by time; `step=` returns the next state instead.
    Functions take any of `x`, `u`, `p`, `t` (and `next`, in `running_cost`) by these names, or in
    this order: (x, u, p, t), observe (x, p, t), running_cost (x, u, next, p, t), terminal_cost and
    end (x, p). Components have the names of `states`, `controls` and `params`: `x.h1`, `x["h1"]`, `x[0]`.
    `p.dt` is the time step. `end` returns a condition; an episode ends at the first state in which it
    holds.

    `states` is a list of names, or a count for x1, x2, ...; `controls` may also be a dict of
    bounds, (low, high) or None. `params` has numbers, constant arrays, `pg.uniform`, `pg.normal`,
    `pg.log_uniform`, `pg.choice`, `pg.noise`, `pg.trained` and `pg.table`. `start` has numbers and
    those that are drawn for each sample, by state; states without a start begin at 0. `dt` is the time step in s.
    `method` is an integrator, "rk4" by default, with `substeps` per step. Other arguments are
    `tables`, `angles`, `units`, `horizon`, and those of `pg.task`.

    The functions are called when the system is made and never again, so values of global variables
    are those of that time. Write conditions as `np.where`.
    """
    found = trace_settings(*arguments, **settings)
    if not found["system"]["controls"]:
        raise ValueError(
            '`controls` is empty; name at least one, as in `controls=["u"]`, which no function has to use'
        )
    from . import Task

    del found["task"]
    return Task._of("equations", **found)
