"""Build wheel and sdist and try them in clean environments: python tests/support/release.py [PYTHON ...].

Each Python gets the wheel with the newest dependencies, without extras. The first one also gets the oldest that
pyproject.toml allows, without extras and with all; the sdist; and each extra alone. In each environment diffshade is
imported, prints its help and renders, and does what the extra is for; where there is not one extra alone it fits and
writes a report. An environment is removed before the next is made. It takes about two minutes for each.
"""

from __future__ import annotations

import argparse
import re
import subprocess
import sys
import tempfile
import time
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]

BEGUN = """
import subprocess, sys
from pathlib import Path
import diffshade as ds
lamp = ds.PointLight((2, 3, 4), intensity=10, attenuation=ds.RadialAttenuation(1.0, 0.1, 0.5))
material = ds.Material(k_a=0.05, k_d=(0.7, 0.25, 0.2), k_s=0.4, n_s=40)
scene = ds.Scene(ds.Object(ds.Sphere(), material), (lamp, ds.DirectionalLight((1, -1, -1), intensity=0.3)))
camera = ds.Camera(eye=(0, 0, 4), fov=35, shape=(48, 48))
ds.write_image("sphere.png", ds.render(scene, camera, lit=0))
assert ds.read_image("sphere.png").shape == (48, 48, 3)
help_of = subprocess.check_output([Path(sys.executable).with_name("diffshade"), "--help"], text=True)
assert "render" in help_of
"""
MAIN = """
views = [ds.View(ds.render(scene, camera, lit=i), camera, lit=i) for i in (0, 1)]
fit = ds.fit(scene, views, free=("k_d", "k_s", "n_s"))
assert fit.determined.all() and abs(fit.values - fit.values_in(scene)).max() < 1e-3, fit
ds.write_report("fit.html", fit)
assert "<svg" in Path("fit.html").read_text(encoding="utf-8")
"""
TEXELS = """
import numpy as np
lights = [ds.DirectionalLight((x, y, -1.0)) for x in (-0.6, 0.0, 0.6) for y in (-0.6, 0.0, 0.6)]
scene = ds.Scene(ds.Object(ds.Sphere(), material), lights)
far = ds.OrthographicCamera((0, 0, 4), height=2.2, shape=(24, 24))
maps = ds.fit_texels(scene, [ds.View(ds.render(scene, far, lit=i), far, lit=i) for i in range(9)],
                     free=("k_d", "k_s", "n_s", "normal"))
inside = maps.status != maps.STATUS.index("outside")
heights = ds.heights.integrate_normals(maps.values["normal"], far, mask=inside, errors=maps.errors["normal"])
ds.write_image("sphere.tif", ds.render(scene, far))
ds.read_image("sphere.tif")
from diffshade.inverse.data.masks import find_mask
find_mask([ds.render(scene, camera, lit=4)])
"""
EXTRAS = {  # what each is for
    "exr": "ds.write_image('a.exr', ds.render(scene, camera)); ds.read_image('a.exr')",
    "figures": "ds.lecture.write_figures('figures', only='snell')",
    "photographs": TEXELS,
    "zarr": "import numpy as np, zarr; zarr.save('a.zarr', np.zeros((9, 9, 3), 'f4')); ds.open_image('a.zarr')[:]",
    "raw": "import rawpy",
    "heic": """
import pillow_heif
from PIL import Image
pillow_heif.register_heif_opener()
Image.open("sphere.png").convert("RGB").save("a.heic")
assert ds.read_image("a.heic").shape == (48, 48, 3)
""",
    "mesh": """
import trimesh
trimesh.creation.icosphere(2).export("ball.ply")
assert ds.exchange.read_mesh("ball.ply", camera).mask.any()
""",
    "notebooks": "import ipykernel, ipywidgets, jupyterlab, matplotlib, nbclient, PIL, trimesh, cv2, pyamg",
    "docs": "import pdoc, latex2mathml.converter",
    "test": "import pytest, hypothesis, beartype, selenium, xdist",
    "dev": "import nbconvert",
}


def run(*words: str | Path, **more: object) -> str:
    """Return what a command prints; end with all that it printed where it fails."""
    done = subprocess.run([str(word) for word in words], capture_output=True, text=True, check=False, **more)  # pyright: ignore[reportCallIssue, reportArgumentType]
    if done.returncode:
        raise SystemExit(f"{' '.join(map(str, words))[:200]}\n{done.stdout[-2000:]}{done.stderr[-4000:]}")
    return done.stdout


def oldest() -> str:
    """Return a constraint for each dependency: the oldest release that pyproject.toml allows."""
    wanted = [*PROJECT["dependencies"], *(one for some in PROJECT["optional-dependencies"].values() for one in some)]
    bounds = [re.match(r"([\w.-]+)>=([\w.]+)", one) for one in wanted]
    return "\n".join(f"{bound[1]}=={bound[2]}" for bound in bounds if bound)


def size_of(folder: Path) -> float:
    """Return the space that a folder takes on the disk, MiB."""
    return int(run("du", "-sk", folder).split()[0]) / 1024


def try_in_an_environment(python: str, built: Path, extras: tuple[str, ...], *, old: bool = False) -> None:
    """Install what was built with some extras, and do what they are for; print a line about it."""
    brackets = f"[{','.join(extras)}]" if extras else ""
    with tempfile.TemporaryDirectory() as folder:
        there, began = Path(folder), time.monotonic()
        run(python, "-m", "venv", there / "env")
        own = there / "env" / "bin" / "python"
        packages = Path(run(own, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))").strip())
        before = size_of(packages)
        (there / "oldest.txt").write_text(oldest() if old else "")
        run(own, "-m", "pip", "install", "-q", f"{built}{brackets}", "-c", there / "oldest.txt")
        run(own, "-m", "pip", "check")
        size = size_of(packages) - before
        (there / "work").mkdir()
        program = "\n".join([BEGUN, *([MAIN] * (len(extras) != 1)), *(EXTRAS[extra] for extra in extras)])
        run(own, "-W", "ignore", "-c", program, cwd=there / "work")
        version = run(own, "-c", "import sys; print(sys.version.split()[0])").strip()
        versions = "oldest" if old else "newest"
        taken = time.monotonic() - began
    print(
        f"Python {version}, {versions} dependencies, {built.suffix}{brackets}: {size:.0f} MiB, {taken:.0f} s, passed",
        flush=True,
    )


def main() -> None:
    """Build, and try every environment that was asked for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("pythons", nargs="*", default=[sys.executable], help="by default the one that runs this")
    parser.add_argument("--only", choices=("plain", "oldest", "sdist", "extras"), help="one kind of environments")
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        built = Path(folder)
        run(sys.executable, "-m", "venv", built / "env")
        builder = built / "env" / "bin" / "python"
        run(builder, "-m", "pip", "install", "-q", "build")
        run(builder, "-m", "build", "--outdir", built / "dist", ROOT)
        (wheel,), (sdist,) = (built / "dist").glob("*.whl"), (built / "dist").glob("*.tar.gz")
        print(f"{wheel.name}: {wheel.stat().st_size / 1e6:.1f} MB; {sdist.name}: {sdist.stat().st_size / 1e6:.1f} MB")
        used = tuple(extra for extra in EXTRAS if extra not in ("test", "dev", "docs", "notebooks"))
        first = asked.pythons[0]
        if asked.only in (None, "plain"):
            for python in asked.pythons:
                try_in_an_environment(python, wheel, ())
        if asked.only in (None, "oldest"):
            try_in_an_environment(first, wheel, (), old=True)
            try_in_an_environment(first, wheel, used, old=True)
        if asked.only in (None, "sdist"):
            try_in_an_environment(first, sdist, ())
        if asked.only in (None, "extras"):
            for extra in EXTRAS:
                try_in_an_environment(first, wheel, (extra,))


if __name__ == "__main__":
    main()
