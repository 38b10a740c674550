"""An editable install, as the README says to make one, beside a script: which diffshade does the script import?"""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


def test_a_script_beside_the_clone_imports_the_library(tmp_path):
    clone = tmp_path / "diffshade"
    clone.mkdir()
    for name in ("pyproject.toml", "README.md", "LICENSE", "diffshade"):
        (shutil.copytree if (ROOT / name).is_dir() else shutil.copy)(ROOT / name, clone / name)
    subprocess.run([sys.executable, "-m", "venv", tmp_path / "own"], check=True)
    python = tmp_path / "own" / "bin" / "python"
    # what the import itself needs: names are looked up when they are asked for
    installed = subprocess.run(
        [python, "-m", "pip", "install", "-q", "lazy_loader", "editables"], capture_output=True, text=True, check=False
    )
    if installed.returncode:
        pytest.skip(f"pip finds no packages here: {installed.stderr[-300:]}")
    subprocess.run([python, "-m", "pip", "install", "-q", "--no-deps", "-e", clone], check=True, capture_output=True)
    (tmp_path / "script.py").write_text("import diffshade\nprint(diffshade.__file__, len(diffshade.__all__))\n")
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    for folder in (tmp_path, elsewhere):
        run = subprocess.run(
            [python, tmp_path / "script.py"], cwd=folder, capture_output=True, text=True, check=False, env={}
        )
        assert run.returncode == 0, run.stderr
        file, number = run.stdout.split()
        assert Path(file) == clone / "diffshade" / "__init__.py"
        assert int(number) > 60
