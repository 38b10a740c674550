"""Each command that reads photographs says in one line what it took them for."""

import json
from pathlib import Path

import pytest
from folders import ball_under_distant_lights

from diffshade.cli import main

COUNT = 6
COMMANDS = {
    "fit": ("--free", "k_d"),
    "report": ("--free", "k_d", "--quick", "-o", "page.html"),
    "compare": ("--free", "k_d,k_s", "--model", "phong,matte"),
    "plan": ("--free", "k_d"),
    "texels": ("--free", "k_d", "-o", "maps"),
    "calibrate": ("--ball", "matte"),
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    return ball_under_distant_lights(tmp_path_factory.mktemp("jpegs") / "photographs", count=COUNT, suffix=".jpg")


@pytest.mark.parametrize("command", COMMANDS)
def test_a_command_says_what_it_took_the_photographs_for(command, folder, capfd, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as end:
        main([command, str(folder), *COMMANDS[command]])
    out, err = capfd.readouterr()
    assert end.value.code == 0, err
    assert out.startswith(f"photographs read as sRGB: {COUNT} JPEG (by file type; --linear to change)\n")
    if command == "fit":
        with pytest.raises(SystemExit):
            main([command, str(folder), *COMMANDS[command], "--linear", "--json"])
        told = json.loads(capfd.readouterr().out)
        assert told["read_as"] == ["linear"] * COUNT
