"""The fitting scripts, run as a user runs them, with warnings as errors."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from measured import measured

import diffshade as ds

SCRIPTS = Path(__file__).parents[2] / "fitting"


def run(script, *arguments, cwd):
    command = [sys.executable, "-W", "error", SCRIPTS / script, *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=False, cwd=cwd, env={**os.environ})


def test_recover_sphere_prints_every_parameter_within_four_errors_of_the_truth(tmp_path):
    done = run("recover_sphere.py", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    rows = re.findall(r"^(\S+) +(\S+) +(\S+) +(\S+) +(-?\d+\.\d\d)$", done.stdout, re.MULTILINE)
    names = [row[0] for row in rows]
    assert names == [f"{k}.{c}" for k in ("k_a", "k_d", "k_s") for c in "rgb"] + ["n_s", "linear", "quadratic"]
    assert all(abs(float(row[4])) < 4.0 for row in rows), done.stdout
    assert all(float(row[3]) > 0 for row in rows)
    picture = ds.read_image(tmp_path / "output" / "recover_sphere.png")
    assert picture.std() > 0.1
    assert "<h1>Fit of 8 photographs</h1>" in (tmp_path / "output" / "report.html").read_text(encoding="utf-8")


def test_fit_photographs_fits_the_ball(tmp_path):
    folder = measured("diligent_ball")
    done = run("fit_photographs.py", folder, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    k_d = [float(number) for number in re.findall(r"^k_d\.[rgb] +(\S+)", done.stdout, re.MULTILINE)]
    assert k_d == pytest.approx((0.164, 0.138, 0.090), rel=0.05)
    (held_out,) = re.findall(r"held-out RMSE (\S+) over 8 photographs", done.stdout)
    assert float(held_out) < 0.012
    assert (tmp_path / "output" / "fit_photographs.png").is_file()
    assert (tmp_path / "output" / "report.html").is_file()


@pytest.mark.parametrize("script", sorted(path.name for path in SCRIPTS.glob("*.py")))
def test_help_says_what_it_does(script, tmp_path):
    done = run(script, "--help", cwd=tmp_path)
    assert done.returncode == 0
    assert "usage:" in done.stdout
    assert len(done.stdout.splitlines()) < 24  # a screen


def test_bad_input_is_one_sentence_and_a_status(tmp_path):
    cases = {
        ("fit_photographs.py", "nowhere"): "there is no folder nowhere",
        ("recover_sphere.py", "--size", "0"): r"Camera.shape must be \(height, width\)",
        ("recover_sphere.py", "--sigma", "-1"): "--sigma and --seed must be at least 0; got -1.0",
    }
    for (script, *arguments), message in cases.items():
        done = run(script, *arguments, cwd=tmp_path)
        assert done.returncode != 0
        assert re.search(message, done.stderr), done.stderr
        assert done.stderr.count("\n") == 1
        assert "Traceback" not in done.stderr
    assert not list(tmp_path.iterdir())  # nothing half-written
