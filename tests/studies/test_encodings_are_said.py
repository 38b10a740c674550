"""Each command that reads photographs says in one line what it took them for."""

import json
from pathlib import Path

import numpy as np
import pytest

import diffshade as ds
from diffshade.cli import main

SIZE, COUNT = 24, 6
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
    """JPEGs of a ball under distant lights, with its normals."""
    folder = tmp_path_factory.mktemp("photographs")
    y, x = np.mgrid[1 : -1 : SIZE * 1j, -1 : 1 : SIZE * 1j] * 1.1
    z2 = 1.0 - x**2 - y**2
    normals = np.where((z2 > 0)[..., None], np.stack([x, y, np.sqrt(np.maximum(z2, 0.0))], -1), (0.0, 0.0, 1.0))
    around = 2.0 * np.pi * np.arange(COUNT) / COUNT
    towards = np.stack([0.6 * np.cos(around), 0.6 * np.sin(around), np.full(COUNT, 0.8)], -1)
    scene = ds.Scene(
        ds.Object(ds.GBuffer(normals, mask=z2 > 0.0), ds.Material(k_a=0.0, k_d=(0.6, 0.4, 0.2))),
        [ds.DirectionalLight(-l) for l in towards],
    )
    camera = ds.OrthographicCamera((0, 0, 1), shape=(SIZE, SIZE), local_viewer=False)
    for i in range(COUNT):
        ds.write_image(folder / f"{i}.jpg", np.asarray(ds.render(scene, camera, lit=i)))
    ds.write_image(folder / "mask.png", (z2 > 0)[..., None] * 1.0, srgb=False)
    np.save(folder / "normal_gt.npy", normals)
    (folder / "filenames.txt").write_text("\n".join(f"{i}.jpg" for i in range(COUNT)))
    np.savetxt(folder / "light_directions.txt", towards)
    np.savetxt(folder / "light_intensities.txt", np.ones((COUNT, 3)))
    return folder


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
