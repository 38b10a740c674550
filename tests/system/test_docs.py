"""The documentation's sources: public names, what functions refuse, links of texts, and the page of the lectures."""

import functools
import importlib
import inspect
import re
import tomllib
from pathlib import Path

import pytest
from public_names import PUBLIC, ROOMS, TOP

import diffshade as ds
from diffshade.report.lecture import FIGURES

ROOT = Path(__file__).parents[2]
PAGES, STUDIES = (sorted((ROOT / "docs" / folder).glob("*.md")) for folder in ("pages", "studies"))
TEXTS = (*(ROOT / name for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md")), *PAGES, *STUDIES)
WORDS = 2500  # of a page: a quarter of an hour
LECTURES = (ROOT / "docs" / "pages" / "lectures.md").read_text(encoding="utf-8")
ROWS = [
    dict(zip(("concept", "equation", "name", "key", "figure"), line.strip("| ").split(" | "), strict=True))
    for line in re.findall(r"^\| .+ \|$", LECTURES, re.MULTILINE)
    if not line.startswith("| concept ")
]
FUNCTIONS = {name: of for name, of in PUBLIC.items() if inspect.isfunction(of)}


def test_the_package_lists_every_public_name_under_one_topic():
    listed = re.findall(r"`(\w+)`", (ds.__doc__ or "").partition("\n## ")[2])
    assert sorted(listed) == sorted(dir(ds)) == sorted({*TOP, *ROOMS})


def test_a_public_room_is_imported_as_a_module_and_says_what_is_in_it():
    assert {"lights", "lamps", "heights", "exchange", "lecture", "extension"} == set(ROOMS)
    for name, room in ROOMS.items():
        assert importlib.import_module(f"diffshade.{name}") is room
        assert room.__doc__
    typed = Path(ds.exchange.__file__).with_suffix(".pyi").read_text(encoding="utf-8")
    assert sorted(re.findall(r" as (\w+)$", typed, re.MULTILINE)) == sorted(dir(ds.exchange))


@pytest.mark.parametrize("name", FUNCTIONS)
def test_a_function_says_what_it_raises(name):
    if inspect.signature(FUNCTIONS[name]).parameters:  # what takes nothing refuses nothing
        assert re.search(r"\b[Rr]aises\b", FUNCTIONS[name].__doc__ or "")


@pytest.mark.parametrize("text", TEXTS, ids=lambda path: path.name)
def test_a_text_links_to_files_that_exist(text):
    for link in re.findall(r"\]\(([^)#]+)(?:#[^)]*)?\)", text.read_text(encoding="utf-8")):
        assert link.startswith("https://") or (text.parent / link).is_file(), link


def test_every_page_is_reached_from_the_readme():
    linked = set(re.findall(r"\]\((docs/pages/[^)#]+)", TEXTS[0].read_text(encoding="utf-8")))
    assert linked == {path.relative_to(ROOT).as_posix() for path in PAGES}


def test_every_study_is_dated_and_reached_from_a_page():
    linked = {
        link for page in PAGES for link in re.findall(r"\]\(\.\./studies/([^)#]+)", page.read_text(encoding="utf-8"))
    }
    assert linked == {path.name for path in STUDIES}
    for path in STUDIES:
        assert re.match(r"20\d\d-\d\d-\d\d-", path.name)
        assert path.name[:10] in path.read_text(encoding="utf-8").partition("\n")[0]


@pytest.mark.parametrize("page", PAGES, ids=lambda path: path.name)
def test_a_page_is_read_in_a_quarter_of_an_hour(page):
    assert len(page.read_text(encoding="utf-8").split()) <= WORDS


def test_the_installing_page_has_every_extra():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    page = (ROOT / "docs" / "pages" / "install.md").read_text(encoding="utf-8")
    assert set(re.findall(r"'\.\[(\w+)\]'", page)) == set(project["optional-dependencies"])
    asked = {
        extra
        for file in (*PAGES, *(ROOT / "diffshade").rglob("*.py"))
        for extra in re.findall(
            r"diffshade\[(\w+)\]'|(?:needing|check_extra)\(\"(\w+)\"", file.read_text(encoding="utf-8")
        )
        for extra in extra
        if extra
    }
    assert asked <= set(project["optional-dependencies"])


def test_the_version_is_the_same_everywhere():
    version = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["version"]
    assert f"\nversion: {version}\n" in (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    changes = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    assert re.search(rf"^## {re.escape(version)}, 20\d\d-\d\d-\d\d$", changes, re.MULTILINE)
    assert "\n## Unreleased\n" in changes


def scene_file_keys(folder):
    """Return every key that a scene file may have, with the tables that hold it."""
    attenuation = ds.RadialAttenuation(1, 0.1, 0.2)
    lights = [
        ds.PointLight((2, 3, 4), attenuation=attenuation),
        ds.DirectionalLight((0, 0, -1)),
        ds.SpotLight((2, 3, 4), (-2, -3, -4), attenuation=attenuation, flaps=ds.Flaps(-1, 1)),
        ds.AreaLight((-1, 2, 2), (1, 0, 0), (0, -1, 1), attenuation=attenuation),
    ]
    glass = ds.Material(k_d=0.5, k_s=0.3, k_t=0.5, eta=1.5, fresnel=ds.Schlick(), lobe=ds.Blinn())
    keys = set()

    def collect(value, at):
        for item in value if isinstance(value, list) else [value]:
            if isinstance(item, dict):
                for key, inner in item.items():
                    keys.add(name := f"{at}{key}")
                    collect(inner, f"{name}.")

    for atmosphere in (ds.DepthCueing(2, 9, I_dc=0.5), ds.Fog(0.1)):
        scene = ds.Scene(ds.Object(ds.Sphere(), glass), lights, atmosphere=atmosphere)
        ds.write_scene(folder / "scene.toml", scene, camera=ds.Camera((0, 0, 4)))
        collect(tomllib.loads((folder / "scene.toml").read_text(encoding="utf-8")), "")
    return keys


def test_the_page_of_the_lectures_names_what_exists(tmp_path):
    assert len(ROWS) > 30
    keys = scene_file_keys(tmp_path) | {"objects.material.foley"}  # which is read, and written as its products
    for row in ROWS:
        assert re.search(r"\[E\d+\]", row["equation"]), row
        found = {column: re.findall(r"`([^`]+)`", row[column]) for column in ("name", "key", "figure")}
        assert all(found.values()), row
        for name in found["name"]:
            assert name.startswith("ds.")
            functools.reduce(getattr, name.split(".")[1:], ds)
        assert set(found["key"]) <= keys, set(found["key"]) - keys
        assert set(found["figure"]) <= set(FIGURES), set(found["figure"]) - set(FIGURES)
    for name in re.findall(r"`ds\.([\w.]+)", LECTURES):
        functools.reduce(getattr, name.split("."), ds)


def test_the_page_of_the_lectures_has_every_equation_and_figure():
    equations = [f"E{i}" for i in range(1, 15)]
    sections = re.findall(r"^### (E\d+) [^\n]+\n\n\$\$ .*?(?=^### |\Z)", LECTURES, re.MULTILINE | re.DOTALL)
    assert sections == equations
    assert {link for row in ROWS for link in re.findall(r"\[(E\d+)\]", row["equation"])} == set(equations)
    assert {figure for row in ROWS for figure in re.findall(r"`(\w+)`", row["figure"])} == set(FIGURES)
    for section in re.split(r"^### E", LECTURES, flags=re.MULTILINE)[1:]:
        assert "`ds." in section, section
