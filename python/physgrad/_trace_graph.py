"""Operations of traced functions as a graph, and the graph as text: expressions and definitions.

A node is a tuple of the operation and the numbers of its arguments. Equal nodes are one node.
Rewriting changes the text and not the value, also of infinities, NaN and zeros with a sign. The one
exception is the wrapped angle, whose value differs by rounding.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

from ._trace_errors import fail, place

OPERATORS = {"add": ("+", 1), "sub": ("-", 1), "mul": ("*", 2), "div": ("/", 2)}
# Operations that may become shorter nodes.
REWRITTEN = {*OPERATORS, "neg"}
COMPARISONS = {"lt": "<", "le": "<=", "gt": ">", "ge": ">="}
# Conditions of other conditions. Those that are shared or long become numbers, 0 or 1.
JOINED = ("and", "or", "not")
# Precedence of the text: sums 1, products 2, negation 3, power 4, names, numbers and calls 5.
NEGATION, POWER, ATOM = 3, 4, 5
# Precedence of conditions: `or` 1, `and` 2, `not` 3, comparisons 4.
COMPARISON = 4
FUNCTIONS = frozenset(
    "sin cos tan asin acos atan atan2 sinh cosh tanh exp log sqrt abs "
    "min max clip hypot sign where detach".split()
)
# An expression and a comparison that are longer are broken into definitions.
LONGEST, LONGEST_COMPARISON = 100, 60
# Expressions of `next` and conditions that are shorter are repeated where they are used.
REPEATED = 40
# A loop in Python is unrolled, so a mistake in its count would fill the memory.
MOST_NODES = 200_000
MOST_POWER = 1024


class Graph:
    def __init__(self) -> None:
        self.nodes: list[tuple] = []
        self.ids: dict[tuple, int] = {}
        # Places of operations that have no text.
        self.places: dict[int, str] = {}

    def add(self, *node) -> int:
        """The number of a node."""
        if node not in self.ids:
            if len(self.nodes) == MOST_NODES:
                fail(
                    ValueError,
                    f"the functions have more than {MOST_NODES} operations; loops of Python are unrolled",
                )
            self.ids[node] = len(self.nodes)
            self.nodes.append(node)
        return self.ids[node]

    def constant(self, value: float) -> int:
        # The key is text because 0.0 equals -0.0.
        return self.add("number", repr(float(value)))

    def number(self, id: int) -> float | None:
        """The value of a node that is a constant."""
        node = self.nodes[id]
        return float(node[1]) if node[0] == "number" else None

    def apply(self, op: str, *args: int) -> int:
        """Adds an operation."""
        rewritten = self.rewrite(op, args[0], args[-1]) if op in REWRITTEN else None
        if rewritten is not None:
            return rewritten
        id = self.add(op, *args)
        if op == "mod":
            self.places.setdefault(id, place())
        return id

    def rewrite(self, op: str, a: int, b: int) -> int | None:
        """A shorter node with the same value, or None."""
        right = self.number(b)
        if op == "neg":
            inner = self.nodes[a][1] if self.nodes[a][0] == "neg" else None
            return inner if right is None else self.constant(-right)
        if op in ("mul", "div"):
            one = op == "mul" and self.number(a) == 1.0
            return a if right == 1.0 else b if one else None
        if self.nodes[b][0] == "neg":
            return self.apply("sub" if op == "add" else "add", a, self.nodes[b][1])
        if right is None:
            return None
        negative = math.copysign(1.0, right) < 0
        if op == "add":
            return self.apply("sub", a, self.constant(-right)) if negative else None
        if right < 0:
            return self.apply("add", a, self.constant(-right))
        if right == 0.0 and not negative:
            return a
        return self.wrapped_angle(a) if right == math.pi else None

    def wrapped_angle(self, a: int) -> int | None:
        """The angle of `(x + pi) % (2 * pi) - pi`, if `a` is its remainder: atan2(sin(x), cos(x))."""
        op, *args = self.nodes[a]
        if op != "mod" or self.number(args[1]) != 2 * math.pi:
            return None
        op, *args = self.nodes[args[0]]
        x = [arg for arg in args if op in ("add", "sub") and self.number(arg) != math.pi]
        if len(x) != 1 or (op == "sub" and x[0] != args[0]):
            return None
        return self.add("atan2", self.add("sin", x[0]), self.add("cos", x[0]))


class Text:
    """Text of nodes. `define` collects the definitions that the expressions need."""

    def __init__(self, graph: Graph, outputs: Iterable[int], taken: Iterable[str]) -> None:
        self.graph, self.taken = graph, {*taken, *FUNCTIONS}
        self.define: dict[str, str] = {}
        self.names: dict[int, str] = {}
        self.shown: dict[int, tuple[str, int]] = {}
        self.uses = self.count(outputs)
        self.of_next: set[int] = set()
        # Arguments have smaller numbers than their operation.
        for id in sorted(self.uses):
            self.write(id)

    def count(self, outputs: Iterable[int]) -> dict[int, int]:
        """How often each node that the outputs need is used."""
        uses: dict[int, int] = {}
        waiting = list(outputs)
        while waiting:
            id = waiting.pop()
            uses[id] = uses.get(id, 0) + 1
            if uses[id] == 1:
                waiting += self.args(id)
        return uses

    def args(self, id: int) -> tuple[int, ...]:
        node = self.graph.nodes[id]
        return () if node[0] in ("number", "name") else node[1:2] if node[0] == "power" else node[1:]

    def write(self, id: int) -> None:
        """Finds the text of a node whose arguments have theirs."""
        op, *args = self.graph.nodes[id]
        of_next = op == "name" and args[0].startswith("next.")
        if of_next or not self.of_next.isdisjoint(self.args(id)):
            self.of_next.add(id)
        limit = LONGEST_COMPARISON if op in COMPARISONS else LONGEST
        self.shown[id] = self.render(op, args)
        while len(self.shown[id][0]) > limit:
            # The definition of the condition of `where` would be another `where` of the same length.
            parts = [arg for arg in (args[1:] if op == "where" else self.args(id)) if self.can_define(arg)]
            if not parts:
                break
            self.set_name(max(parts, key=lambda arg: len(self.shown[arg][0])))
            self.shown[id] = self.render(op, args)
        # `next` belongs to the running cost alone, and a condition is no number.
        repeated = (id in self.of_next or op in JOINED) and len(self.shown[id][0]) <= REPEATED
        if self.uses[id] > 1 and self.can_define(id) and not repeated:
            self.set_name(id)

    def can_define(self, id: int) -> bool:
        op, *args = self.graph.nodes[id]
        simple = op in ("number", "name", *COMPARISONS)
        return (
            not simple
            and id not in self.names
            and not (op == "neg" and self.graph.nodes[args[0]][0] == "name")
        )

    def set_name(self, id: int) -> None:
        """Makes a node a definition. That of a condition is 1 where it holds, and 0 elsewhere."""
        number = len(self.define) + 1
        while f"v{number}" in self.taken:
            number += 1
        name = f"v{number}"
        self.taken.add(name)
        text, joined = self.shown[id][0], self.graph.nodes[id][0] in JOINED
        self.define[name] = f"where({text}, 1, 0)" if joined else text
        self.names[id] = name
        self.shown[id] = (f"{name} > 0.5", COMPARISON) if joined else (name, ATOM)

    def at_least(self, id: int, precedence: int) -> str:
        text, found = self.shown[id]
        return text if found >= precedence else f"({text})"

    def render(self, op: str, args: list) -> tuple[str, int]:
        """Text and precedence of an operation, from those of its arguments."""
        if op == "name":
            return args[0], ATOM
        if op == "number":
            return number_text(float(args[0]))
        if op in OPERATORS:
            sign, precedence = OPERATORS[op]
            return (
                f"{self.at_least(args[0], precedence)} {sign} {self.at_least(args[1], precedence + 1)}",
                precedence,
            )
        if op == "neg":
            return f"-{self.at_least(args[0], NEGATION)}", NEGATION
        if op == "power":
            return f"{self.at_least(args[0], ATOM)}^{number_text(float(args[1]))[0]}", POWER
        if op == "pow":
            return f"{self.at_least(args[0], ATOM)}^{self.at_least(args[1], ATOM)}", POWER
        if op in COMPARISONS:
            return f"{self.shown[args[0]][0]} {COMPARISONS[op]} {self.shown[args[1]][0]}", COMPARISON
        if op == "not":
            return f"not ({self.shown[args[0]][0]})", 3
        if op in ("and", "or"):
            precedence = 2 if op == "and" else 1
            return f" {op} ".join(self.at_least(arg, precedence) for arg in args), precedence
        if op == "mod":
            raise ValueError(MOD.format(place=self.graph.places[self.graph.ids[(op, *args)]]))
        return f"{op}({', '.join(self.shown[arg][0] for arg in args)})", ATOM


MOD = (
    "{place}: a remainder (`%`, np.mod) is supported only as the angle `(a + np.pi) % (2 * np.pi) - "
    "np.pi`. Write "
    "`np.arctan2(np.sin(a), np.cos(a))` for an angle, `np.sin(2 * np.pi * t / period)` for a cycle, and "
    "`pg.table(values)` for other functions of time"
)


def number_text(value: float) -> tuple[str, int]:
    """A number as text that reads as the same number, and its precedence."""
    sign = "-" if math.copysign(1.0, value) < 0 else ""
    size = abs(value)
    whole = size.is_integer() and 0 < size < 1e16 or (size == 0 and not sign)
    text = "pi" if size == math.pi else str(int(size)) if whole else repr(size)
    return sign + text, NEGATION if sign else ATOM
