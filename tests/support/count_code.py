"""Counts what there is to carry on: lines of code, tuned constants, and functions that are long.

python tests/support/count_code.py [ROOM ...]  prints, for each room of the library, the lines that are neither blank,
comment, docstring nor import, its tuned constants, and the numbers within its functions.

A tuned constant is a name that a module gives a number. Not counted are codes: the entries of a dict and of an Enum,
and `range`; and what is derived: an expression of other names that adds no number but 0, 1 and 2.
A number that moves into a function, a class or the default of an argument is counted there, unless it is a small whole
number or a half. The room `report` is left out of both: its numbers place and colour what is drawn.
"""

from __future__ import annotations

import ast
import io
import sys
import tokenize
from collections.abc import Collection, Iterator, Sequence
from functools import cache
from pathlib import Path

LIBRARY = Path(__file__).parents[2] / "diffshade"
BLANK = {
    tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER,
}  # fmt: skip
Function = ast.FunctionDef | ast.AsyncFunctionDef
PLAIN = {0, 1, 2, 3, 4, 0.5}  # counts of channels and axes, halves and signs
DRAWING = "report"


def modules(rooms: list[str] | None = None) -> Iterator[Path]:
    """Yield the modules of the library, or of some of its rooms."""
    for path in sorted(LIBRARY.rglob("*.py")):
        if not rooms or path.relative_to(LIBRARY).parts[0] in rooms:
            yield path


@cache
def parsed(path: Path) -> ast.Module:
    """Return the tree of a module."""
    return ast.parse(path.read_text(encoding="utf-8"))


def is_text(node: ast.AST) -> bool:
    """Whether a statement is a string alone, such as a docstring."""
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)


def lines_of(node: ast.stmt) -> range:
    """Return the lines of a statement."""
    return range(node.lineno, (node.end_lineno or node.lineno) + 1)


def lines_of_code(path: Path) -> int:
    """Return the lines of a module that are neither blank, comment, docstring nor import."""
    text = path.read_text(encoding="utf-8")
    left_out = {
        line
        for node in ast.walk(parsed(path))
        if isinstance(node, ast.Import | ast.ImportFrom) or is_text(node)
        for line in lines_of(node)  # pyright: ignore[reportArgumentType]
    }
    code = {
        line
        for token in tokenize.generate_tokens(io.StringIO(text).readline)
        if token.type not in BLANK
        for line in range(token.start[0], token.end[0] + 1)
    }
    return len(code - left_out)


def numbers(node: ast.AST, plain: Collection[float]) -> list[float]:
    """Return the numbers that an expression or a statement spells out, without some that say nothing."""
    values = [each.value for each in ast.walk(node) if isinstance(each, ast.Constant)]
    spelled = [value for value in values if isinstance(value, int | float) and not isinstance(value, bool)]
    return [value for value in spelled if value not in plain]


def is_code(value: ast.expr) -> bool:
    """Whether an expression is a list of codes: `range`, or a dict of whole numbers."""
    if isinstance(value, ast.Dict):
        return not any(isinstance(number, float) for number in numbers(value, ()))
    return isinstance(value, ast.Call) and isinstance(value.func, ast.Name) and value.func.id == "range"


def tuned_constants(path: Path) -> list[str]:
    """Return the names that a module gives a number, each with its own where several are given at once."""
    found = []
    for node in parsed(path).body:
        if not isinstance(node, ast.Assign | ast.AnnAssign) or node.value is None or is_code(node.value):
            continue
        targets = node.targets if isinstance(node, ast.Assign) else [node.target]
        names = [name.id for target in targets for name in ast.walk(target) if isinstance(name, ast.Name)]
        derived = any(isinstance(each, ast.Name) and each.id.isupper() for each in ast.walk(node.value))
        if numbers(node.value, (0, 1, 2) if derived else ()):
            found += names
    return found


def numbers_within(path: Path) -> list[float]:
    """Return the numbers within a module's functions and classes, without small whole numbers and a half."""
    definitions = [
        node
        for node in parsed(path).body
        if isinstance(node, Function) or (isinstance(node, ast.ClassDef) and not is_enum(node))
    ]
    return [number for node in definitions for number in numbers(node, PLAIN)]


def is_enum(node: ast.ClassDef) -> bool:
    """Whether a class lists codes."""
    return any(isinstance(base, ast.Name) and base.id.endswith("Enum") for base in node.bases)


def long_functions(path: Path, most: int) -> list[str]:
    """Return the functions of a module that have more lines than `most` after their docstring."""
    found = []
    for node in ast.walk(parsed(path)):
        if isinstance(node, Function):
            body = node.body[1:] if is_text(node.body[0]) else node.body
            if body and (node.end_lineno or 0) - body[0].lineno + 1 > most:
                found.append(f"{path.relative_to(LIBRARY)}: {node.name}")
    return found


def classes(path: Path) -> list[str]:
    """Return the names of the classes of a module."""
    return [node.name for node in ast.walk(parsed(path)) if isinstance(node, ast.ClassDef)]


def count_tuned(paths: Sequence[Path]) -> tuple[int, int]:
    """Return the tuned constants of some modules, and the numbers within their functions."""
    fitted = [path for path in paths if path.relative_to(LIBRARY).parts[0] != DRAWING]
    return sum(len(tuned_constants(path)) for path in fitted), sum(len(numbers_within(path)) for path in fitted)


def main() -> None:
    """Print a line for each room and one for all of them."""
    rooms = sys.argv[1:] or sorted({path.relative_to(LIBRARY).parts[0] for path in modules()})
    every = [list(modules([room])) for room in rooms]
    for room, paths in [*zip(rooms, every, strict=True), ("together", [path for of in every for path in of])]:
        lines, (constants, within) = sum(map(lines_of_code, paths)), count_tuned(paths)
        print(f"{room:<16}{lines:>7} lines of code{constants:>5} tuned constants{within:>6} numbers within functions")


if __name__ == "__main__":
    main()
