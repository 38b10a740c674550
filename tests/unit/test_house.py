"""The house rules of the design: who may import whom, and the grammar of the public names."""

import ast
import inspect
from pathlib import Path

import diffshade as ds

ROOT = Path(ds.__file__).parent
FILES = sorted(ROOT.rglob("*.py"))

# Each row may import from the rows above it and from its own. What a folder holds counts as the folder.
LAYERS = (
    "backend fields files progress",
    "image_formats image_headers images lazy_images",
    "vectors",
    "attenuation cameras fresnel patterns surfaces gbuffers meshes",
    "lights measured_lights materials named_materials",
    "reflection transmission",
    "scenes",
    "tracing",
    "rendering scene_files",
    "inverse",
    "texels",
    "diagnosis",
    "calibration",
    "exchange",
    "report",
    "cli __main__",
)
LEVEL = {name: level for level, row in enumerate(LAYERS) for name in row.split()}
# a light never knows a material, nor it a light
STRANGERS = {
    pair
    for light in ("lights", "measured_lights")
    for material in ("materials", "named_materials")
    for pair in ((light, material), (material, light))
} | {("exchange", "diagnosis"), ("exchange", "calibration")}  # to write a file takes a refit at most
# Packages that one place alone knows.
ONLY_IN = {
    "optimistix": "inverse",
    "lineax": "inverse",
    "click": "cli",
    "imageio": "image_formats",
    "jinja2": "report",
    "matplotlib": "report",
    "trimesh": "meshes",
    "tifffile": "lazy_images",
    "zarr": "lazy_images",
}

PUBLIC = {name: getattr(ds, name) for name in dir(ds)}


def place(file: Path) -> str:
    """The module or folder of diffshade that a file belongs to; `__init__` for the package itself."""
    return file.relative_to(ROOT).parts[0].removesuffix(".py")


def imports(file: Path) -> set[tuple[str, ...]]:
    """The dotted names a file imports, those of diffshade itself as ('diffshade', module, ...)."""
    package = ("diffshade", *file.relative_to(ROOT).parts[:-1])
    found = set()
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {tuple(alias.name.split(".")) for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) + 1 - node.level] if node.level else ()
            module = (*base, *(node.module or "").split(".")) if node.module else base
            # `from . import x` names a module by what it imports
            found |= {(*module, alias.name) if module == ("diffshade",) else module for alias in node.names}
    return found


def test_imports_point_downwards():
    wrong = []
    for file in FILES:
        here = place(file)
        for name in imports(file):
            if name[0] in ONLY_IN and here != ONLY_IN[name[0]]:
                wrong.append(f"only {ONLY_IN[name[0]]} may import {name[0]}; {file} does")
            if name == ("diffshade",):
                wrong += [f"only the command line uses the public names; {file} does"] * (here != "cli")
            elif name[0] == "diffshade" and here != "__init__":
                wrong += [f"{file} may not import {name[1]}"] * (LEVEL[name[1]] > LEVEL[here])
                wrong += [f"{here} may not know {name[1]}"] * ((here, name[1]) in STRANGERS)
    assert wrong == []


def test_the_imports_are_found():
    """So that the test above cannot pass because it sees nothing."""
    assert ("optimistix",) in imports(ROOT / "inverse" / "solvers.py")
    assert ("diffshade", "scenes") in imports(ROOT / "rendering.py")
    assert ("diffshade", "scenes") in imports(ROOT / "inverse" / "fitting.py")
    assert any(name[:1] == ("matplotlib",) for file in FILES if place(file) == "report" for name in imports(file))


def test_no_module_has_the_name_of_a_public_name():
    """`import diffshade.render` would shadow `diffshade.render`."""
    assert not {place(file) for file in FILES} & set(PUBLIC)


def test_every_public_name_has_a_docstring_of_its_own():
    for name, value in PUBLIC.items():
        doc = vars(value).get("__doc__") if inspect.isclass(value) else value.__doc__
        assert doc, name
        assert not doc.startswith(f"{name}("), name  # what a dataclass without one is given


def test_optional_arguments_are_keyword_only():
    for name in (name for name, value in PUBLIC.items() if inspect.isfunction(value)):
        parameters = inspect.signature(PUBLIC[name]).parameters.values()
        optional = [p.name for p in parameters if p.default is not p.empty and p.kind is not p.KEYWORD_ONLY]
        assert optional == [], name
