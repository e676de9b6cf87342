"""Model formulas of users: checked here, since formulaic evaluates the calls in a formula as Python."""

from __future__ import annotations

import ast
import re

import numpy as np

from morphofold.errors import NotReadable

CALLS = ("C", "log", "sqrt", "exp", "center", "scale", "poly", "bs", "cr")
MOST_CHARACTERS, MOST_TERMS = 1000, 5000
LARGEST_POWER, LARGEST_ARGUMENT, LARGEST_NUMBER = 9, 100, 1e300
_CHARACTERS = re.compile(rf"[\w\s.,+\-:*/^()=]{{1,{MOST_CHARACTERS}}}")
_QUOTED = re.compile(r"`([^`'\"\\]+)`")


def columns_of(formula: str) -> tuple[set[str], set[str]]:
    """Columns of a table that a formula names, and those of them in calls of ``C``.

    Raises
    ------
    NotReadable
        If there is more in it than columns, numbers, operators and known calls, or it makes thousands of terms.
    """
    quoted = _QUOTED.findall(formula)
    plain, names, factors = _QUOTED.sub(lambda _: " quoted_ ", formula), set[str](), set[str]()

    def number(node: ast.expr) -> float:
        value = node.value if isinstance(node, ast.Constant) else None
        return value if isinstance(value, int | float) else np.inf

    def terms(node: ast.expr, call: str = "") -> int:
        """Number of terms, at most; ``call``: the call whose argument the node is, where + is arithmetic."""
        match node:
            case ast.Constant() if number(node) < LARGEST_NUMBER:
                return 1
            case ast.Name(name):
                names.add(name := quoted.pop(0) if name == "quoted_" else name)
                factors.update([name] if call == "C" else [])
                return 1
            case ast.UnaryOp(ast.UAdd() | ast.USub(), inside):
                return terms(inside, call)
            case ast.BinOp(left, ast.Pow(), ast.Constant(int(power))) if not call and 0 < power <= LARGEST_POWER:
                return terms(left) ** power
            case ast.BinOp(left, ast.Add() | ast.Sub(), right):
                return terms(left, call) + terms(right, call)
            case ast.BinOp(left, ast.Mult() | ast.Div() | ast.MatMult(), right):  # @ is written for :
                return (1 + terms(left, call)) * (1 + terms(right, call))
            case ast.Call(ast.Name(name), [inside, *sizes], options) if name in CALLS:
                sizes += [option.value for option in options]
                if all(number(size) <= LARGEST_ARGUMENT for size in sizes):
                    return terms(inside, name)
        raise SyntaxError

    try:
        python = " ".join(plain.split()).replace(":", "@").replace("^", "**")
        if _CHARACTERS.fullmatch(plain) and terms(ast.parse(python, mode="eval").body) <= MOST_TERMS:
            return names, factors
    except (SyntaxError, IndexError, RecursionError, MemoryError):  # of Python's parser, or raised above
        pass
    raise NotReadable(
        f"{formula!r}: can't be read as a model. Write columns (in backquotes, if a name has more than letters, digits "
        f"and _), numbers, + - : * / ^ ( ), and calls of {', '.join(CALLS)}, such as 'age + sex'."
    )
