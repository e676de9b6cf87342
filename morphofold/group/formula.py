"""Model formulas of users: checked here, since formulaic evaluates the calls in a formula as Python."""

import ast
import math
import re
from collections.abc import Mapping

import numpy as np

from morphofold.errors import NotReadable

CALLS_WITH_SIZES = ("poly", "bs", "cr")
CALLS = ("C", "log", "sqrt", "exp", "center", "scale", *CALLS_WITH_SIZES)
MOST_CHARACTERS, MOST_COLUMNS = 1000, 20_000
LARGEST_POWER, LARGEST_ARGUMENT, LARGEST_NUMBER = 9, 100, 1e300
_CHARACTERS = re.compile(rf"[\w\s.,+\-:*/^()=]{{1,{MOST_CHARACTERS}}}")
_QUOTED = re.compile(r"`([^`'\"\\]+)`")


def columns_of(formula: str, levels: Mapping[str, int] = {}) -> tuple[set[str], set[str]]:
    """Columns of a table that a formula names, and those of them in calls of ``C``; ``levels`` are those of factors.

    Raises
    ------
    NotReadable
        If there is more in it than columns, numbers, operators and known calls, or a model of it has more than
        ``MOST_COLUMNS`` columns.
    """
    quoted = _QUOTED.findall(formula)
    plain, names, factors = _QUOTED.sub(lambda _: " quoted_ ", formula), set[str](), set[str]()

    def number(node: ast.expr) -> float:
        value = node.value if isinstance(node, ast.Constant) else None
        return value if isinstance(value, int | float) else np.inf

    def size(node: ast.expr, call: str = "") -> int:
        """Number of columns, at most; ``call``: the call whose argument the node is, where + is arithmetic."""
        match node:
            case ast.Constant() if number(node) < LARGEST_NUMBER:
                return 1
            case ast.Name(name):
                names.add(name := quoted.pop(0) if name == "quoted_" else name)
                factors.update([name] if call == "C" else [])
                return levels.get(name, 1)
            case ast.UnaryOp(ast.UAdd() | ast.USub(), inside):
                return size(inside, call)
            case ast.BinOp(left, ast.Pow(), ast.Constant(int(power))) if not call and 0 < power <= LARGEST_POWER:
                return size(left) ** power
            case ast.BinOp(left, ast.Add() | ast.Sub(), right):
                return size(left, call) + size(right, call)
            case ast.BinOp(left, ast.Mult() | ast.Div() | ast.MatMult(), right):  # @ is written for :
                return (1 + size(left, call)) * (1 + size(right, call))
            case ast.Call(ast.Name(name), [inside, *more], options) if name in CALLS:
                given = [number(value) for value in (*more, *(option.value for option in options))]
                if not given or (name in CALLS_WITH_SIZES and max(given) <= LARGEST_ARGUMENT):
                    return math.ceil(size(inside, name) * (1 + sum(given)))
        raise SyntaxError

    try:
        python = " ".join(plain.split()).replace(":", "@").replace("^", "**")
        if _CHARACTERS.fullmatch(plain) and size(ast.parse(python, mode="eval").body) <= MOST_COLUMNS:
            return names, factors
    except (SyntaxError, IndexError, RecursionError, MemoryError):  # of Python's parser, or raised above
        pass
    raise NotReadable(
        f"{formula!r}: can't be read as a model, or has more than {MOST_COLUMNS:,} columns. Write columns (in "
        "backquotes, if a name has more than letters, digits and _), numbers, + - : * / ^ ( ), and calls of "
        f"{', '.join(CALLS)}, such as 'age + sex'."
    )
