"""Size of the code: lines of packages, files and functions that are not blank, comment or docstring.

``python -m morphofold.studies.code_sizes`` in a checkout prints them.
"""

import ast
import io
import tokenize
from pathlib import Path
from statistics import median

ROOMS = ("morphofold", "sim", "analysis", "studies", "tests")
LARGEST = 5  # number of files and functions that are listed
NO_CODE = (tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER)


def code_lines(source: str) -> set[int]:
    """Numbers of the lines of a Python file that are code; texts below fields, as in options, are docstrings, too."""
    lines: set[int] = set()
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type not in NO_CODE:
            lines.update(range(token.start[0], token.end[0] + 1))
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            lines.difference_update(range(node.lineno, (node.end_lineno or 0) + 1))
    return lines


def functions(source: str) -> dict[str, int]:
    """Lines of code of each function of a file."""
    lines = code_lines(source)
    found = (node for node in ast.walk(ast.parse(source)) if isinstance(node, ast.FunctionDef))
    return {f.name: sum(k in lines for k in range(f.lineno, (f.end_lineno or f.lineno) + 1)) for f in found}


def report(root: Path) -> str:
    """A line for each package, and the largest files and functions outside of the tests."""
    sources = {
        p: p.read_text(encoding="utf-8")
        for room in ROOMS
        for p in sorted((root / room).rglob("*.py"))
        if not any(folder.is_symlink() for folder in p.parents)
    }
    files = {p.relative_to(root): len(code_lines(text)) for p, text in sources.items()}
    report_lines = []
    for room in ROOMS:
        sizes = [n for p, n in files.items() if p.parts[0] == room]
        report_lines.append(f"{room:12} {sum(sizes):7,} lines in {len(sizes)} files, median {median(sizes):g}")
    product = [p for p in files if p.parts[0] != "tests"]
    report_lines += [f"{files[p]:4} {p}" for p in sorted(product, key=lambda p: -files[p])[:LARGEST]]
    each = [(n, p, name) for p in product for name, n in functions(sources[root / p]).items()]
    report_lines += [f"{n:4} {p} {name}" for n, p, name in sorted(each, key=lambda f: -f[0])[:LARGEST]]
    return "\n".join(report_lines)


if __name__ == "__main__":
    print(report(Path(__file__).resolve().parent.parent))
