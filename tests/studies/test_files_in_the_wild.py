"""Files of public repositories, none of which is kept here: each is read, or refused, as the documentation says.

They are looked for as wild/REPOSITORY/FILE among the measured data.
"""

import logging
import re
from pathlib import Path

import pytest
from measured import measured

import diffshade as ds

pytestmark = pytest.mark.thorough

PAGE = Path(__file__).parents[2] / "docs" / "pages" / "files-in-the-wild.md"
ROW = re.compile(r"^\| (\S+) \| `([^`]+)` \| (.+) \|$", re.MULTILINE)
ROWS = ROW.findall(PAGE.read_text(encoding="utf-8"))


def found(path: Path, folder: Path) -> str:
    """What the table says of a file."""
    if path.suffix == ".ts":  # an IES file as a string of TypeScript
        text = path.read_text(encoding="utf-8")
        path = folder / "a.ies"
        path.write_text(text[text.index("IESNA") :].partition("`")[0], encoding="utf-8")
    if path.suffix.lower() in (".ies", ".ldt"):
        return str(ds.read_lamp(path)).splitlines()[1][12:]
    number = len(ds.read_materials(path))
    return f"{number} material{'s' if number > 1 else ''}"


def test_the_table_has_what_was_asked_for():
    kinds = [Path(file).suffix.lower() for _, file, _ in ROWS]
    assert kinds.count(".mtl") >= 40
    assert len({repository for repository, file, _ in ROWS if file.endswith(".mtl")}) >= 30
    assert kinds.count(".gltf") + kinds.count(".glb") >= 20
    assert kinds.count(".js") + kinds.count(".json") >= 20
    assert sum(kinds.count(kind) for kind in (".ies", ".ldt", ".ts")) >= 20


@pytest.mark.parametrize(("repository", "file", "expected"), ROWS)
def test_a_file_is_read_as_the_table_says(repository, file, expected, caplog, tmp_path):
    caplog.set_level(logging.ERROR, "diffshade")
    path = measured("wild") / repository / file
    if not path.is_file():
        pytest.skip(f"{repository} {file} is not among the measured data.")
    if not expected.startswith("refused: "):
        assert found(path, tmp_path) == expected
        return
    with pytest.raises(ValueError, match=re.escape(expected.removeprefix("refused: "))):
        found(path, tmp_path)
