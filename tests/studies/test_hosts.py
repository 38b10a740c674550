"""Fits over several devices and several processes: the same answer as on one, and an end when a process is lost."""

import os
import subprocess
import sys
import time
from pathlib import Path

import generated
import numpy as np
import pytest
import synthetic

import diffshade as ds

SUPPORT = Path(__file__).parents[1] / "support"
ROOT = SUPPORT.parents[1]
SCRIPT = ROOT / "fitting" / "fit_on_hosts.py"

ON_EIGHT = """
import sys
import jax, numpy as np
import generated
assert len(jax.devices()) == 8
mesh = jax.make_mesh((4, 2), ("a", "b"))
fits = [generated.fit(150, mesh=mesh, **options) for options in ({}, {"memory": 1e6, "checkpoint": sys.argv[1]})]
np.savez(sys.argv[2], *(fit.values for fit in fits), *(fit.plain_errors for fit in fits))
"""


def test_eight_devices_give_the_answer_of_one(tmp_path):
    flags = {"XLA_FLAGS": "--xla_force_host_platform_device_count=8", "PYTHONPATH": f"{SUPPORT}{os.pathsep}{ROOT}"}
    command = [sys.executable, "-W", "error", "-c", ON_EIGHT, tmp_path / "checkpoint", tmp_path / "out.npz"]
    done = subprocess.run(command, env={**os.environ, **flags}, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    one = generated.fit(150)
    with np.load(tmp_path / "out.npz") as file:
        kept, anew, *errors = (file[name] for name in file.files)
    for values in (kept, anew):
        np.testing.assert_allclose(values, one.values, rtol=1e-10)
    for found in errors:
        np.testing.assert_allclose(found, one.plain_errors, rtol=1e-10)


def write_folder(folder: Path, size: int) -> None:
    """Write four photographs of a ball in DiLiGenT's layout, as .npy, which are read by rows."""
    folder.mkdir()
    camera = ds.OrthographicCamera((0, 0, 4), shape=(size, size), local_viewer=False)
    ball = synthetic.seen_by(camera)
    inside = np.asarray(ball.mask)
    towards = np.array([[0.3, 0.4, 1.0], [-0.5, 0.1, 1.0], [0.1, -0.6, 1.0], [0.4, -0.2, 1.0]])
    lights = [ds.DirectionalLight(-l) for l in towards]
    scene = ds.Scene(ds.Object(ds.GBuffer(ball.normal, mask=inside), synthetic.MATERIAL), lights)
    images = synthetic.noisy(synthetic.photographs(scene, camera), 0.005, 0)
    for i, image in enumerate(images):
        np.save(folder / f"{i}.npy", image.astype(np.float32))
    (folder / "filenames.txt").write_text("\n".join(f"{i}.npy" for i in range(4)), encoding="utf-8")
    np.savetxt(folder / "light_directions.txt", towards / np.linalg.norm(towards, axis=1)[:, None])
    np.savetxt(folder / "light_intensities.txt", np.ones((4, 1)))
    np.save(folder / "normal_gt.npy", ball.normal)
    ds.write_image(folder / "mask.png", inside.astype(float))


def begin(folder: Path, *arguments: object) -> subprocess.Popen:
    command = [sys.executable, "-W", "error", SCRIPT, folder / "photographs", "--checkpoint", folder / "checkpoint"]
    command += ["--memory", "1e6", *arguments]
    return subprocess.Popen(
        [str(word) for word in command],
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def wait_for(path: Path, process: subprocess.Popen) -> None:
    while not path.exists() and process.poll() is None:
        time.sleep(0.01)
    assert process.poll() is None, process.communicate()


def children(process: subprocess.Popen) -> list[int]:
    """Return the processes that a process started, in their order."""
    tasks = Path(f"/proc/{process.pid}/task").glob("*/children")
    return sorted(int(child) for path in tasks for child in path.read_text(encoding="ascii").split())


def table(said: str) -> str:
    return said[said.index("fit of ") :]


@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="the processes are found in Linux's /proc")
def test_two_processes_give_the_answer_of_one_though_one_is_lost(tmp_path):
    write_folder(tmp_path / "photographs", 400)
    first = begin(tmp_path, "--processes", 2)
    wait_for(tmp_path / "checkpoint" / "survey.npz", first)
    os.kill(children(first)[1], 9)
    killed = time.monotonic()
    _, said = first.communicate(timeout=60)
    assert first.returncode == 75, said
    assert "fit_on_hosts: a process was lost. Give the same command again to go on.\n" in said
    assert time.monotonic() - killed < 30

    again = begin(tmp_path, "--processes", 2)
    shown, said = again.communicate(timeout=300)
    assert again.returncode == 0, said
    scene, views = ds.read_photographs(tmp_path / "photographs")
    one = ds.fit(scene, views, free=("k_a", "k_d", "k_s", "n_s"))
    assert table(shown).splitlines() == str(one).splitlines()
    found = np.load(sorted((tmp_path / "checkpoint").glob("pass-*.npz"))[-1])["arr_0"]
    np.testing.assert_allclose(found[:9], one.values[:9], rtol=1e-8)  # where the last pass was made, one step before


@pytest.mark.slow
@pytest.mark.parametrize("number", [3, 4])
def test_more_processes_than_cores(tmp_path, number):
    write_folder(tmp_path / "photographs", 700)
    done = begin(tmp_path, "--processes", number, "--devices", 2)
    shown, said = done.communicate(timeout=600)
    assert done.returncode == 0, said
    scene, views = ds.read_photographs(tmp_path / "photographs")
    one = ds.fit(scene, views, free=("k_a", "k_d", "k_s", "n_s"))
    assert table(shown).splitlines() == str(one).splitlines()


@pytest.mark.slow
@pytest.mark.parametrize("lost", [0, 1])
def test_a_process_lost_in_a_pass_ends_the_others(tmp_path, lost):
    write_folder(tmp_path / "photographs", 1000)
    started = begin(tmp_path, "--processes", 2)
    wait_for(tmp_path / "checkpoint" / "pass-0000.npz", started)
    os.kill(children(started)[lost], 9)
    _, said = started.communicate(timeout=60)
    assert started.returncode == 75, said
    done = begin(tmp_path, "--processes", 2)
    shown, said = done.communicate(timeout=600)
    assert done.returncode == 0, said
    alone = begin(tmp_path, "--processes", 1)
    assert alone.communicate(timeout=600)[0] == shown[shown.index("fit of ") :]
