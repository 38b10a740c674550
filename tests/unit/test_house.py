"""The house rules of the design: who may import whom, and the grammar of the public names."""

import ast
import inspect
import re
import runpy
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path

import pytest
from public_names import PUBLIC, TOP

import diffshade as ds
from diffshade import extension
from tests.support import count_code, mutants

ROOT = Path(ds.__file__).parent
FILES = sorted(ROOT.rglob("*.py"))

# Each row may import from the rows above it and from its own; a room is named whole, or by what it holds.
LAYERS = (
    "core.words core.extras core.progress core.backend core.barriers core.robust_scale core.thresholds",
    "core.arrays core.tables",
    "core.fields",
    "core.masks",
    "model.vectors",
    "model.bands",
    "model.attenuation model.cameras model.fresnel model.microfacets",
    "model.patterns model.surfaces model.meshes model.gbuffers",
    "model.diffuse_laws model.flaps model.lobes",
    "model.photometry",
    "model.lights model.area_lights model.measured_lights model.materials model.named_materials",
    "model.reflection model.transmission",
    "model.scenes",
    "model.tracing",
    "model.rendering",
    "io",
    "parallel",
    "inverse.data",
    "inverse.unknowns",
    "inverse.pixels",
    "inverse.forward",
    "inverse.solve",
    "inverse.statistics",
    "inverse.problem inverse.laid_out inverse.solved inverse.spreads inverse.hidden_highlights",
    "inverse.solving",
    "inverse.result inverse.summary",
    "inverse.misfit",
    "inverse.verdicts",
    "inverse.fitting",
    "inverse.image_fits",
    "inverse.fit_functions",
    "texels",
    "diagnosis",
    "calibration",
    "exchange",
    "report",
    "extension lights lamps heights lecture",
    "cli __main__",
)
LEVEL = {room: level for level, row in enumerate(LAYERS) for room in row.split()}
# a light never knows a material, nor it a light
STRANGERS = {
    (f"model.{one}", f"model.{other}")
    for lights, materials in [
        (("flaps", "lights", "area_lights", "measured_lights"), ("lobes", "materials", "named_materials"))
    ]
    for pair in [(light, material) for light in lights for material in materials]
    for one, other in (pair, pair[::-1])
} | {("exchange", "diagnosis"), ("exchange", "inverse.misfit"), ("exchange", "calibration")}
# Packages that one place alone knows.
ONLY_IN = {
    "optimistix": "inverse.solve",
    "click": "cli",
    "OpenEXR": "io",
    "imageio": "io",
    "jinja2": "report",
    "matplotlib": "report",
    "pyamg": "texels.heights",
    "mapbox_earcut": "io",
    "trimesh": "io",
    "fast_simplification": "io",
    "pillow_heif": "io",
    "rawpy": "io",
    "tifffile": "io",
    "zarr": "io",
}

MAX_LINES = 400  # of a module
MAX_LINES_OF_A_FUNCTION = 60
MAX_CONSTANTS, MAX_NUMBERS = 350, 765  # tuned, with a name; and within functions, where they must not hide


def module(file: Path) -> str:
    """The dotted name of a file within diffshade; "" for the package itself."""
    return ".".join(part for part in file.relative_to(ROOT).with_suffix("").parts if part != "__init__")


MODULES = {module(file): file for file in FILES}


def room(name: str) -> str:
    """The room of the layers that a module belongs to."""
    while name not in LEVEL:
        name, dot, _ = name.rpartition(".")
        assert dot, "a module that no layer holds"
    return name


@cache
def imports(file: Path) -> set[tuple[str, ...]]:
    """The dotted names a file imports, those of diffshade itself as ('diffshade', module, ...)."""
    package = ("diffshade", *file.relative_to(ROOT).parts[:-1])
    found = set()
    for node in ast.walk(count_code.parsed(file)):
        if isinstance(node, ast.Import):
            found |= {tuple(alias.name.split(".")) for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) + 1 - node.level] if node.level else ()
            module = (*base, *(node.module or "").split(".")) if node.module else base
            for name in ((*module, alias.name) for alias in node.names):  # `from . import x` may name a module
                found.add(name if ".".join(name[1:]) in MODULES else module)
    return found


# all modules but the packages that only say what their room is for
FILLED = [name for name, file in MODULES.items() if name and "import" in file.read_text(encoding="utf-8")]


@cache
def known(name: str) -> dict[str, str]:
    """The modules of diffshade that a module imports, each with its room."""
    dotted = {".".join(found[1:]) for found in imports(MODULES[name]) if found[0] == "diffshade"}
    return {found: room(found) for found in dotted & set(FILLED) - {name}}


@pytest.mark.parametrize("name", FILLED)
def test_imports_point_downwards(name):
    here = room(name)
    wrong = [
        f"only {ONLY_IN[found[0]]} may import {found[0]}"
        for found in imports(MODULES[name])
        if found[0] in ONLY_IN and not name.startswith(ONLY_IN[found[0]])
    ]
    wrong += [other for other, there in known(name).items() if LEVEL[there] > LEVEL[here]]
    wrong += [other for other, there in known(name).items() if (here, there) in STRANGERS]
    assert wrong == []
    assert ("diffshade",) not in imports(MODULES[name]) or here == "cli", "only the command line uses the public names"


def test_no_circle():
    assert list(TopologicalSorter({name: set(known(name)) for name in FILLED}).static_order())


def test_a_file_is_short_and_says_its_one_idea_first():
    for name, file in MODULES.items():
        assert file.read_text(encoding="utf-8").count("\n") <= MAX_LINES, name
        assert ast.get_docstring(count_code.parsed(file)), name


def test_no_function_is_long():
    found = [name for file in FILES for name in count_code.long_functions(file, MAX_LINES_OF_A_FUNCTION)]
    assert found == []


def test_no_two_classes_have_one_name():
    names = [name for file in FILES for name in count_code.classes(file)]
    assert {name for name in names if names.count(name) > 1} == set()


def test_tuned_constants_stay_few():
    constants, numbers = count_code.count_tuned(FILES)
    assert constants <= MAX_CONSTANTS
    assert numbers <= MAX_NUMBERS


def test_what_counts_as_tuned(tmp_path):
    """So that a number cannot leave the count but by being derived, shared, or a code."""
    module = tmp_path / "module.py"
    module.write_text(
        "NAMED, OTHER = 0.3, 8\nPAIR = (0.5, 2)\nDERIVED = 2 * NAMED\nFACTOR = 5 * NAMED\nTYPED: float = 1e-6\n"
        "KIND, STATE = range(2)\nCODES = {'a': 12}\nRANKS = {'a': 0.2}\nWORD = 'eight'\nlower = 0.7\n"
        "def f(x=0.9):\n    return x[0] * 1.7 + 2\nclass A:\n    y = 11\nclass B(IntEnum):\n    y = 12\n"
    )
    found = count_code.tuned_constants(module)
    assert found == ["NAMED", "OTHER", "PAIR", "FACTOR", "TYPED", "RANKS", "lower"]
    assert sorted(count_code.numbers_within(module)) == [0.9, 1.7, 11]


def test_the_imports_are_found():
    """So that the tests above cannot pass because they see nothing."""
    assert ("optimistix",) in imports(MODULES["inverse.solve.solvers"])
    assert known("model.rendering")["model.scenes"] == "model.scenes"
    assert known("inverse.fitting")["inverse.data.views"] == "inverse.data"
    assert any(
        found[:1] == ("matplotlib",)
        for name in MODULES
        if name.startswith("report")
        for found in imports(MODULES[name])
    )


def test_the_guide_names_every_module_of_a_fit():
    words = set(re.findall(r"\w+", (ROOT.parent / "CONTRIBUTING.md").read_text(encoding="utf-8")))
    rooms = ("inverse.", "texels.", "diagnosis.", "calibration.")
    assert [name for name in MODULES if name.startswith(rooms) and not words.issuperset(name.split("."))] == []


def test_faults_are_planted_in_modules_that_exist():
    assert {name.replace("/", ".") for names in mutants.GROUPS.values() for name in names.split()} <= set(MODULES)


def test_tests_that_others_run_again_exist():
    runs = runpy.run_path(str(ROOT.parent / "tests" / "studies" / "test_settings.py"))["RUNS"]
    places = [place for _, of in runs.values() for place in of]
    assert [place for place in places if not (ROOT.parent / "tests" / place).exists()] == []


def test_no_module_has_the_name_of_a_public_name():
    """`import diffshade.render` would shadow `diffshade.render`."""
    assert not {name.partition(".")[0] for name in MODULES} & set(TOP)


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


# What the rooms above the library use of it beyond public names and classes, `core` and `io`: the less the better.
INNER = {
    "cli": "FIGURES NORMALS SHOWN camera_axes center_of check_figure check_folder check_format check_page "
    "check_suffix draw_mask find_mask identifiers light_on_plane list_folder objects_seen photograph_files printable "
    "read_directions read_folder read_textured render_once segments_of unit_of_light write_photographs "
    "write_textured",
    "exchange": "COUNT INDEX OUTSIDE camera_axes check_rgb dome rays_of reflectance",
    "report": "OUTSIDE STATUS affine_rays angular_attenuation bend camera_axes developed heights_within is_grey "
    "lights_on of_channels pixel_matrix placed plane reflectance refract relative_error select visible_points "
    "wavelength",
}


@pytest.mark.parametrize("room", INNER)
def test_rooms_above_the_library_use_public_names(room):
    public = {*PUBLIC, *extension.__all__}
    used = set()
    for file in (ROOT / room).rglob("*.py"):
        package = file.relative_to(ROOT).parts[:-1]
        for node in ast.walk(count_code.parsed(file)):
            if isinstance(node, ast.ImportFrom) and node.level:
                home = (*package[: len(package) - node.level + 1], *(node.module or "").split("."))
                if home[0] not in (room, "core", "io", ""):
                    used |= {alias.name for alias in node.names}
    functions = {name for name in used - public if not re.match(r"[A-Z][a-z]", name)}  # not classes, for annotations
    assert functions == set(INNER[room].split())
