"""Counts what there is to carry on: lines of code, constants, and functions that are long.

python tests/support/count_code.py [ROOM ...]  prints, for each room of the library, the lines that are neither blank,
comment, docstring nor import, and the constants of its modules.
"""

from __future__ import annotations

import ast
import io
import sys
import tokenize
from collections.abc import Iterator
from pathlib import Path

LIBRARY = Path(__file__).parents[2] / "diffshade"
BLANK = {
    tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER,
}  # fmt: skip
Function = ast.FunctionDef | ast.AsyncFunctionDef


def modules(rooms: list[str] | None = None) -> Iterator[Path]:
    """Yield the modules of the library, or of some of its rooms."""
    for path in sorted(LIBRARY.rglob("*.py")):
        if not rooms or path.relative_to(LIBRARY).parts[0] in rooms:
            yield path


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
        for node in ast.walk(ast.parse(text))
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


def constants(path: Path) -> list[str]:
    """Return the names in capitals that a module assigns."""
    found = []
    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        targets = node.targets if isinstance(node, ast.Assign) else [getattr(node, "target", None)]
        for target in targets:
            names = target.elts if isinstance(target, ast.Tuple) else [target]
            found += [name.id for name in names if isinstance(name, ast.Name) and name.id.isupper()]
    return found


def long_functions(path: Path, most: int) -> list[str]:
    """Return the functions of a module that have more lines than `most` after their docstring."""
    found = []
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, Function):
            body = node.body[1:] if is_text(node.body[0]) else node.body
            if body and (node.end_lineno or 0) - body[0].lineno + 1 > most:
                found.append(f"{path.relative_to(LIBRARY)}: {node.name}")
    return found


def classes(path: Path) -> list[str]:
    """Return the names of the classes of a module."""
    return [
        node.name for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))) if isinstance(node, ast.ClassDef)
    ]


def main() -> None:
    """Print a line for each room and one for all of them."""
    rooms = sys.argv[1:] or sorted({path.relative_to(LIBRARY).parts[0] for path in modules()})
    every = [list(modules([room])) for room in rooms]
    for room, paths in [*zip(rooms, every, strict=True), ("together", [path for of in every for path in of])]:
        lines, named = sum(map(lines_of_code, paths)), sum(len(constants(path)) for path in paths)
        print(f"{room:<16}{lines:>7} lines of code{named:>5} constants")


if __name__ == "__main__":
    main()
