"""Folders as strangers have them: what is wrong is one sentence from every command, and nothing is written."""

import re
import sys

import numpy as np
import pytest

import diffshade as ds
from diffshade.cli import main

LIGHTS = np.array([[0, 0, 1], [0.6, 0, 0.8], [0, 0.6, 0.8], [-0.6, 0, 0.8]])


@pytest.fixture
def folder(tmp_path):
    """A dome of four lights over a ball, as JPEGs with an RTI list of lights and a mask."""
    where = tmp_path / "dome"
    where.mkdir()
    row, column = np.mgrid[:24, :24]
    x, y = (column - 11.5) / 10, -(row - 11.5) / 10
    inside = x**2 + y**2 < 0.9
    normal = np.stack([x, y, np.sqrt(np.maximum(1 - x**2 - y**2, 0))], -1) * inside[..., None]
    for i, l in enumerate(LIGHTS):
        ds.write_image(where / f"{i}.jpg", 0.5 * np.maximum(normal @ l, 0)[..., None] * np.ones(3))
    rows = [f"{i}.jpg {x:g} {y:g} {z:g}\n" for i, (x, y, z) in enumerate(LIGHTS)]
    (where / "dome.lp").write_text("4\n" + "".join(rows))
    ds.write_image(where / "mask.png", inside * 1.0)
    return where


def lines(folder, number):
    text = (folder / "dome.lp").read_text().splitlines()
    return "\n".join(text[:number])


def cut(file):
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])


def hold_a_raw_file(folder):
    (folder / "1.jpg").rename(folder / "1.dng")
    (folder / "dome.lp").write_text((folder / "dome.lp").read_text().replace("1.jpg", "1.dng"))


BAD = {
    "empty": (lambda folder: [file.unlink() for file in folder.iterdir()], "holds no photograph. Give a folder"),
    "two sizes": (
        lambda folder: ds.write_image(folder / "1.jpg", np.zeros((10, 10, 3))),
        "(must have the size of the other photographs|must have one size|has photographs of sizes)",
    ),
    "too few lines": (
        lambda folder: (folder / "dome.lp").write_text(lines(folder, 3)),
        "dome.lp must have 4 lines after its first, as that says; got 2",
    ),
    "no direction": (
        lambda folder: (folder / "dome.lp").write_text(lines(folder, 9).replace("0.6 0 0.8", "0 0 0")),
        "dome.lp must hold directions towards the lights; got .* on line 3. Correct it",
    ),
    "RAW without rawpy": (
        hold_a_raw_file,
        r"1.dng without the package rawpy. Install it: pip install 'diffshade\[raw\]'",
    ),
    "mask of another size": (
        lambda folder: ds.write_image(folder / "mask.png", np.ones((10, 12))),
        r"mask must have the (size of the photographs,|photographs' shape) \(24, 24\); got \(10, 12\)",
    ),
    "truncated": (
        lambda folder: cut(folder / "2.jpg"),
        "2.jpg: it is no JPEG, or is empty, truncated or damaged. Make or copy the file again",
    ),
}
COMMANDS = {
    "texels": ["texels", "{}", "-o"],
    "find-lights": ["find-lights", "{}", "--unknown", "-o"],
    "calibrate": ["calibrate", "{}", "--ball", "matte", "-o"],
    "mask": ["mask", "{}", "-o"],
}


PAIRS = [(case, command) for case in BAD for command in COMMANDS]
PAIRS.remove(("mask of another size", "mask"))  # which makes a mask, and reads none


@pytest.mark.parametrize(("case", "command"), PAIRS)
def test_a_bad_folder_is_one_sentence_and_nothing_is_written(folder, tmp_path, monkeypatch, capfd, case, command):
    spoil, said = BAD[case]
    spoil(folder)
    monkeypatch.setitem(sys.modules, "rawpy", None)
    before = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*")}
    arguments = [word.format(folder) for word in COMMANDS[command]]
    with pytest.raises(SystemExit) as stopped:
        main([*arguments, str(tmp_path / "out")])
    shown = capfd.readouterr()
    assert stopped.value.code == 1
    assert shown.out == ""
    assert shown.err.count("\n") == 1
    assert re.search(said, shown.err), shown.err
    assert {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*")} == before
