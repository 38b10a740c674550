"""The command when it is stopped at any moment, and on a disk that is full."""

import contextlib
import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

import diffshade as ds

SIZE = 1 << 20  # bytes of the small disk
FURTHER = ("jpg", "tif", "tga")  # whose bytes the same function writes


@pytest.fixture
def photographs(tmp_path):
    """A matte ball of 200 x 200 pixels under four lights."""
    folder = tmp_path / "photographs"
    folder.mkdir()
    camera = ds.OrthographicCamera((0, 0, 4), height=2.6, shape=(200, 200), local_viewer=False)
    toward = np.array([(0.6, 0, 0.8), (0, 0.6, 0.8), (-0.6, 0, 0.8), (0, -0.6, 0.8)])
    ball = ds.Object(ds.Sphere(), ds.Material(0.05, 0.6, 0))
    scene = ds.Scene(ball, [ds.DirectionalLight(-l) for l in toward])
    for i in range(4):
        ds.write_image(folder / f"{i}.png", ds.render(scene, camera, lit=i))
    ds.write_image(folder / "mask.png", np.asarray(ds.intersect(scene, camera).mask) * 1.0)
    np.savetxt(folder / "light_directions.txt", toward)
    return folder


@pytest.fixture
def small_disk(tmp_path):
    """A disk of 1 MB."""
    where = tmp_path / "disk"
    where.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", f"size={SIZE}", "tmpfs", str(where)]
    try:
        subprocess.run(mount, check=True, capture_output=True)
    except (OSError, subprocess.CalledProcessError):
        pytest.skip("this user may not mount a small disk")
    yield where
    subprocess.run(["umount", str(where)], check=True)


def run(*arguments):
    return subprocess.run([sys.executable, "-m", "diffshade", *map(str, arguments)], capture_output=True, text=True)


# Earlier, the process is still Python's own.
@pytest.mark.parametrize("begun", [0.02, 0.05, 0.1, 0.2, 0.3, 0.4, 0.6, 0.8, 1.0, 2.0])
def test_ctrl_c_is_one_line_while_modules_are_imported_too(photographs, tmp_path, begun):
    program = "import sys; from diffshade.cli import main; print(flush=True); main(sys.argv[1:])"
    arguments = ["texels", str(photographs), "-o", str(tmp_path / "maps")]
    command = subprocess.Popen(
        [sys.executable, "-c", program, *arguments], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert command.stdout is not None
    command.stdout.readline()  # main is called
    time.sleep(begun)
    command.send_signal(signal.SIGINT)
    _, said = command.communicate(timeout=120)
    lines = [line for line in said.splitlines() if "light_intensities" not in line and "cpu_aot_loader" not in line]
    assert lines == ["diffshade: stopped; unfinished files are left as they were."]
    assert command.returncode == 130


@pytest.mark.parametrize(
    "name",
    ["ball.png", "ball.exr", "ball.npy", *(pytest.param(f"ball.{of}", marks=pytest.mark.slow) for of in FURTHER)],
)
def test_a_picture_on_a_full_disk(small_disk, tmp_path, name):
    run("new", tmp_path / "ball.toml")
    (small_disk / name).write_text("old")
    with contextlib.suppress(OSError), (small_disk / "rest").open("wb", buffering=0) as file:
        while True:
            file.write(bytes(4096))
    done = run("render", tmp_path / "ball.toml", "-o", small_disk / name)
    assert done.returncode == 1
    said = [line for line in done.stderr.splitlines() if "cpu_aot_loader" not in line]  # which XLA writes
    assert len(said) == 1
    assert said[0].startswith(f"diffshade: cannot write {small_disk / name}: the disk is full. Free some space")
    assert (small_disk / name).read_text() == "old"
    assert sorted(os.listdir(small_disk)) == sorted([name, "rest"])


def test_maps_on_a_full_disk_and_afterwards(small_disk, photographs, tmp_path):
    arguments = ("texels", photographs, "--free", "k_d", "-o", small_disk / "maps")
    (small_disk / "rest").write_bytes(bytes(SIZE // 2))
    done = run(*arguments)
    assert done.returncode == 1
    assert "k_d_error.npy: the disk is full. Free some space" in done.stderr.splitlines()[-1]
    page = run("report", small_disk / "maps", "-o", tmp_path / "page.html")
    assert page.returncode == 1
    assert "holds the maps of an unfinished fit of texels. Finish it with the command or call that" in page.stderr
