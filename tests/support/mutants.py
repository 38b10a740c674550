"""Plant faults in the library and see which ones the default tests find: `python tests/support/mutants.py`.

Each mutant is one small change of one expression: a comparison or condition inverted, an arithmetic operator exchanged,
a number changed, a sign dropped, the branches of a `where` exchanged, a `raise` left out. They are drawn with a fixed
seed, equally many from the physics, the solver, the statistics and the readers, and each is tested in a copy of the
repository. Left alone is what no test should depend on: types, texts, and sizes of blocks of memory (`1 << 16`).
"""

import argparse
import ast
import concurrent.futures
import os
import random
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[2]
GROUPS = {
    "physics": (
        "model/area_lights model/attenuation model/cameras model/fresnel model/gbuffers model/lights model/materials "
        "model/measured_lights model/meshes model/patterns model/reflection model/rendering model/scenes "
        "model/surfaces model/tracing model/transmission model/vectors"
    ),
    "solver": (
        "inverse/data/views inverse/fitting inverse/forward/features inverse/forward/gram inverse/forward/losses "
        "inverse/forward/rendered inverse/pixels/blocks inverse/problem "
        "inverse/laid_out inverse/solving inverse/solved inverse/data/samples "
        "inverse/solve/descent inverse/solve/solvers inverse/solve/start_search inverse/unknowns/constraints "
        "inverse/unknowns/names inverse/unknowns/parameters inverse/unknowns/ranges inverse/unknowns/slots "
        "inverse/spreads inverse/forward/sums texels/linear_systems texels/descent texels/normal_equations "
        "texels/region_exponents texels/geometry"
    ),
    "statistics": (
        "diagnosis/cross_validation diagnosis/examination diagnosis/forecasting diagnosis/intervals "
        "inverse/misfit/explained inverse/misfit/found inverse/misfit/regions inverse/misfit/relevance "
        "diagnosis/suspicions diagnosis/model_choice "
        "diagnosis/patches diagnosis/planning diagnosis/resampling diagnosis/sensitivity "
        "diagnosis/shots inverse/verdicts/stability "
        "inverse/statistics/clusters inverse/statistics/identifiability inverse/statistics/uncertainty texels/estimates"
    ),
    "readers": (
        "exchange/gltf io/lamps/eulumdat io/lamps/ies io/lamps/lamp_files io/lamps/c_planes "
        "exchange/material_files exchange/mtl exchange/opengl io/parsing exchange/threejs "
        "inverse/data/photographs io/image_formats io/image_headers io/images io/lazy_images io/meshes "
        "io/scene_files"
    ),
}
SECONDS = 1800  # a mutant whose tests do not end is found
EXCHANGED = {
    ast.Add: "-", ast.Sub: "+", ast.Mult: "/", ast.Div: "*", ast.Pow: "*", ast.FloorDiv: "*", ast.Mod: "*",
    ast.MatMult: "*", ast.BitAnd: "|", ast.BitOr: "&",
    ast.Lt: ">=", ast.LtE: ">", ast.Gt: "<=", ast.GtE: "<", ast.Eq: "!=", ast.NotEq: "==",
    ast.Is: "is not", ast.IsNot: "is", ast.In: "not in", ast.NotIn: "in",
    ast.And: "or", ast.Or: "and",
}  # fmt: skip


class Mutant(NamedTuple):
    """A place in a file, and what is written there instead."""

    group: str
    file: str
    line: int
    start: int
    end: int
    before: str
    after: str


def swaps(node: ast.AST, text: bytes, at) -> Iterator[tuple[int, int, str]]:
    """Yield the changes of one node: from and to which byte, and the new text."""

    def source(part: ast.AST) -> str:
        start, end = at(part)
        return text[start:end].decode()

    def between(left: ast.AST, right: ast.AST, new: str) -> tuple[int, int, str]:
        """The operator between two operands, with what brackets stand about it left as they are."""
        start, end = at(left)[1], at(right)[0]
        gap = text[start:end].decode()
        sign = re.search(r"[^\s()]+(\s+(in|not)\b)?", gap)
        assert sign is not None
        return start + sign.start(), start + sign.end(), new

    match node:
        case ast.BinOp(left, op, right) if type(op) in EXCHANGED:
            if not any(isinstance(side, ast.JoinedStr | ast.List | ast.Tuple) for side in (left, right)) and not any(
                isinstance(side, ast.Constant) and isinstance(side.value, str) for side in (left, right)
            ):
                yield between(left, right, EXCHANGED[type(op)])
        case ast.Compare(left, [op], [right]):
            yield between(left, right, EXCHANGED[type(op)])
        case ast.BoolOp(op, values):
            yield between(values[0], values[1], EXCHANGED[type(op)])
        case ast.UnaryOp(ast.USub() | ast.Not(), operand):
            yield at(node)[0], at(operand)[0], ""
        case ast.Constant(bool() as value):
            yield *at(node), str(not value)
        case ast.Constant(int() | float() as value):
            yield *at(node), repr(value + 1 if isinstance(value, int) else 2.0 * value or 1.0)
        case ast.Call(ast.Attribute(attr="where"), [_, first, second]):
            yield at(first)[0], at(second)[1], f"{source(second)}, {source(first)}"
        case ast.Raise():
            yield *at(node), "pass"


def nodes(tree: ast.AST) -> Iterator[ast.AST]:
    """Yield the expressions that do something: no annotation, text, decorator, type alias or shifted size."""
    skipped = ("annotation", "returns", "decorator_list", "type_params", "bases")
    for name, value in ast.iter_fields(tree):
        if name in skipped:
            continue
        for child in value if isinstance(value, list) else [value]:
            if not isinstance(child, ast.AST) or isinstance(child, ast.JoinedStr | ast.Assert):
                continue
            if isinstance(child, ast.BinOp) and isinstance(child.op, ast.LShift):
                continue
            yield child
            if not isinstance(child, ast.Raise):
                yield from nodes(child)


def mutants(group: str, file: str) -> Iterator[Mutant]:
    """Yield every mutant of a file of the library."""
    text = (ROOT / file).read_bytes()
    starts = [0]
    for line in text.splitlines(keepends=True):
        starts.append(starts[-1] + len(line))

    def at(node) -> tuple[int, int]:
        return starts[node.lineno - 1] + node.col_offset, starts[node.end_lineno - 1] + node.end_col_offset

    for node in nodes(ast.parse(text)):
        for start, end, new in swaps(node, text, at):
            changed = text[:start] + new.encode() + text[end:]
            try:
                compile(changed, file, "exec")
            except (SyntaxError, ValueError):
                continue
            yield Mutant(group, file, text[:start].count(b"\n") + 1, start, end, text[start:end].decode(), new)


def drawn(count: int, seed: int) -> list[Mutant]:
    """Draw mutants, equally many from each group, and within it equally likely wherever they stand."""
    chance, found = random.Random(seed), []
    for i, (group, names) in enumerate(GROUPS.items()):
        every = [mutant for name in names.split() for mutant in mutants(group, f"diffshade/{name}.py")]
        found += chance.sample(every, count // len(GROUPS) + (i < count % len(GROUPS)))
    return found


def in_order(mutant: Mutant, folders: list[str]) -> list[str]:
    """Return the test files, those that name the mutant's module most often first: the sooner it is found."""
    name = Path(mutant.file).stem
    files = [file for folder in folders for file in sorted((ROOT / "tests" / folder).rglob("test_*.py"))]
    words = {file: len(re.findall(rf"\b{name}\b", file.read_text(encoding="utf-8"))) for file in files}
    own = [file for file in files if file.stem == f"test_{name}"]
    rest = sorted((file for file in files if file not in own), key=lambda file: (-words[file], file.stat().st_size))
    return [str(file.relative_to(ROOT)) for file in own + rest]


def tried(mutant: Mutant, programs: str, options: list[str], folders: list[str]) -> tuple[str, float]:
    """Return the first test that fails on a mutant, or nothing, and the seconds that it took."""
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "repository"
        shutil.copytree(ROOT, copy, ignore=shutil.ignore_patterns(".git", ".venv", "output", "__pycache__"))
        text = (ROOT / mutant.file).read_bytes()
        (copy / mutant.file).write_bytes(text[: mutant.start] + mutant.after.encode() + text[mutant.end :])
        command = [sys.executable, "-m", "pytest", "-x", "-q", "-n", "0", "-p", "no:cacheprovider", *options]
        around = {
            **os.environ,
            "PYTHONPATH": str(copy),  # before the clone that is installed
            "PYTHONDONTWRITEBYTECODE": "1",
            "DIFFSHADE_TEST_PROGRAMS": programs,
            "DIFFSHADE_DATA": os.environ.get("DIFFSHADE_DATA", str(ROOT.parent / "shared" / "data")),
        }
        began = time.monotonic()
        try:
            run = subprocess.run(
                [*command, *in_order(mutant, folders)],
                cwd=copy, env=around, capture_output=True, text=True, timeout=SECONDS, check=False,
            )  # fmt: skip
        except subprocess.TimeoutExpired:
            return "no end", time.monotonic() - began
        took = time.monotonic() - began
        if run.returncode == 0:
            return "", took
        line = re.search(r"^(FAILED|ERROR) (\S+)", run.stdout, re.MULTILINE)
        return line[2] if line else (run.stdout + run.stderr)[-200:].strip().replace("\n", " "), took


def main() -> None:
    """Draw the mutants, try each, and print which test finds it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=40, help="how many faults (default 40)")
    parser.add_argument("--seed", type=int, default=0, help="of the draw (default 0)")
    parser.add_argument("--processes", type=int, default=2, help="how many at a time (default 2)")
    parser.add_argument("--only", type=int, nargs="*", help="the numbers of those to be tried, by default all")
    parser.add_argument("--tier", choices=("default", "thorough"), default="default", help="which tests look for them")
    parser.add_argument("--list", action="store_true", help="print them and try none")
    given = parser.parse_args()
    faults = list(enumerate(drawn(given.count, given.seed)))
    if given.only is not None:
        faults = [faults[i] for i in given.only]
    options = ["-m", "thorough"] if given.tier == "thorough" else []
    folders = ["unit", "model", "fits", "system"] + (["studies"] if given.tier == "thorough" else [])

    def show(i: int, mutant: Mutant, result: str) -> None:
        before, after = (" ".join(part.split())[:40] for part in (mutant.before, mutant.after))
        print(
            f"{i:3} {mutant.group:10} {mutant.file}:{mutant.line}  {before} -> {after or 'nothing'}  {result}",
            flush=True,
        )

    if given.list:
        for i, mutant in faults:
            show(i, mutant, "")
        return
    with tempfile.TemporaryDirectory() as programs, concurrent.futures.ThreadPoolExecutor(given.processes) as pool:
        runs = {pool.submit(tried, mutant, programs, options, folders): (i, mutant) for i, mutant in faults}
        survived = 0
        for run in concurrent.futures.as_completed(runs):
            test, took = run.result()
            survived += not test
            show(*runs[run], f"found by {test} in {took:.0f} s" if test else f"SURVIVED {took:.0f} s")
    print(f"{len(faults) - survived} of {len(faults)} found by the {given.tier} tier")


if __name__ == "__main__":
    main()
