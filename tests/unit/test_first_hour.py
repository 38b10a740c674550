"""What a newcomer's first hour meets: own parts, derivatives, types of numbers, masks, missing packages."""

import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import diffshade as ds
from diffshade.calibration.result import Calibration
from diffshade.cli import main
from diffshade.core.words import did_you_mean
from diffshade.model.lights import AbstractLight
from diffshade.report.lecture.diffuse import diffuse_over_theta
from diffshade.report.page.writing import MOST_VIEWS, _spread

ROOT = Path(__file__).parents[2]
CAMERA = ds.Camera((0, 0, 4), fov=35, shape=(6, 8))
IMAGE = np.full((6, 8, 3), 0.25)
PIXELS = (6, 8)


def scene(intensity: Any = 1.0) -> ds.Scene:
    return ds.Scene(ds.Object(ds.Sphere(), ds.Material(0.1, 0.5, 0.3, 15)), ds.PointLight((2, 3, 4), intensity))


# Own parts


class Nowhere(AbstractLight):
    """A light that does not say how it reaches a point."""

    @property
    def is_local(self):
        return False


def test_a_light_that_reaches_no_point_cannot_be_made():
    with pytest.raises(TypeError, match=r"Nowhere.*\bemitters"):
        Nowhere()  # pyright: ignore[reportAbstractUsage]


# Derivatives


def _fitted(scene: ds.Scene, view: ds.View) -> object:
    return ds.fit(scene, view, free=("k_d",)).values[0]


TRACED = {
    "scene.lights.0.intensity": lambda x: _fitted(scene(x), ds.View(IMAGE, CAMERA)),
    "views.0.exposure": lambda x: _fitted(scene(), ds.View(IMAGE, CAMERA, exposure=x)),
    "View.image": lambda x: _fitted(scene(), ds.View(x * IMAGE, CAMERA)),
    "scene.objects.0.material.k_s": lambda x: ds.forecast(
        ds.Scene(ds.Object(ds.Sphere(), ds.Material(k_s=x)), ds.PointLight((2, 3, 4))),
        ds.View(IMAGE, CAMERA),
        free=("k_d",),
    ).errors[0],
}


@pytest.mark.parametrize("name", TRACED)
def test_a_fit_inside_grad_says_what_is_traced_and_names_the_derivative(name):
    with pytest.raises(TypeError, match=rf"{name}.* traced.* ds\.(image_)?sensitivity\("):
        jax.grad(TRACED[name])(1.0)


def test_a_fit_inside_jit_is_refused_though_nothing_of_it_is_traced():
    with pytest.raises(TypeError, match=r"it was called there\. Fit outside.*ds\.sensitivity"):
        jax.jit(lambda: _fitted(scene(), ds.View(IMAGE, CAMERA)))()


def test_texels_inside_grad():
    views = [ds.View(IMAGE, CAMERA)] * 2
    with pytest.raises(TypeError, match=r"scene\.lights\.0\.intensity is traced\. Fit outside"):
        jax.grad(lambda x: ds.fit_texels(scene(x), views, free=("k_d",)).residual[0, 0])(1.0)


# Types of numbers


@pytest.mark.parametrize("kind", [jnp.bfloat16, jnp.float8_e4m3fn, jnp.float16])
def test_short_floats_are_numbers(kind):
    colour = jnp.array([0.5, 0.25, 0.125], kind)
    exact = np.array([0.5, 0.25, 0.125])
    np.testing.assert_array_equal(np.asarray(ds.Material(k_d=colour).k_d, np.float64), exact)
    np.testing.assert_array_equal(ds.Material(k_d=np.asarray(colour)).k_d, exact)
    np.testing.assert_array_equal(ds.View(jnp.full((*PIXELS, 3), 0.25, kind), CAMERA).image, IMAGE)
    with pytest.raises(ValueError, match=r"Material\.k_d must be at least 0; got \(-0\.5, -0\.25, -0\.125\)"):
        ds.Material(k_d=-colour)


# Words


def test_no_word_is_answered_with_its_opposite():
    options = ("NoFresnel", "Schlick", "Dielectric")
    assert did_you_mean("fresnel", options) == "Known names: Dielectric, NoFresnel, Schlick."
    assert did_you_mean("nofresnal", options) == "Did you mean 'NoFresnel'?"
    assert did_you_mean("schlik", options) == "Did you mean 'Schlick'?"


def test_a_list_of_another_length_names_the_photographs():
    names = ("0.JPG", "1.JPG", "ref.JPG")
    found = Calibration.__new__(Calibration)
    for field, value in (("names", names), ("directions", np.ones((3, 3))), ("errors", np.ones(3))):
        object.__setattr__(found, field, value)
    with pytest.raises(
        ValueError, match=r"list\.txt .* 3 photographs; got shape \(2, 3\).* 0\.JPG, 1\.JPG and ref\.JPG"
    ):
        found.compare(np.ones((2, 3)), name="list.txt")


# A folder's mask


@pytest.fixture
def folder(tmp_path):
    folder = tmp_path / "photographs"
    folder.mkdir()
    for i in range(2):
        ds.write_image(folder / f"{i}.png", IMAGE, bits=16, srgb=False)
    (folder / "filenames.txt").write_text("0.png\n1.png\n")
    np.savetxt(folder / "light_directions.txt", [(0, 0, 1), (0, 0.6, 0.8)])
    np.savetxt(folder / "light_intensities.txt", [1, 1])
    np.save(folder / "normal_gt.npy", np.broadcast_to((0.0, 0.0, 1.0), (*PIXELS, 3)))
    ds.write_image(folder / "mask.png", np.pad(np.ones((4, 6, 1)), ((1, 1), (1, 1), (0, 0))), srgb=False)
    return folder


def test_another_mask_stands_in_place_of_the_folders(folder, tmp_path):
    other = np.zeros(PIXELS)
    other[:, :2] = 1.0  # two columns, of which the folder's mask has one
    ds.write_image(tmp_path / "other.png", other[..., None], srgb=False)
    for mask in (tmp_path / "other.png", other):
        made, views = ds.read_photographs(folder, mask=mask)
        np.testing.assert_array_equal(made.objects[0].surface.mask, other > 0)  # pyright: ignore[reportAttributeAccessIssue]
        np.testing.assert_array_equal(views[0].mask, other > 0)
    (folder / "mask.png").unlink()
    assert len(ds.read_photographs(folder, mask=other)[1]) == 2


def test_a_mask_of_another_form(folder):
    with pytest.raises(ValueError, match=r"mask must have shape \(H, W\); got \(1, 6, 8\)"):
        ds.read_photographs(folder, mask=np.ones((1, 6, 8)))


def test_the_command_lines_mask_replaces_the_folders(folder, tmp_path, monkeypatch, capfd):
    from diffshade.cli.sources import Options

    ds.write_image(tmp_path / "other.png", np.ones((*PIXELS, 1)), srgb=False)
    (folder / "mask.png").unlink()
    source = Options(folder, (), mask=tmp_path / "other.png", noise=0.01).read()
    assert all(view.mask is not None and view.mask.all() for view in source.views)
    assert source.scene.objects[0].surface.mask.all()  # pyright: ignore[reportAttributeAccessIssue]
    with pytest.raises(SystemExit):
        main(["fit", str(folder)])
    assert "--mask" in capfd.readouterr().err


# The report and the lecture


def test_views_stand_from_the_worst_to_the_best():
    random = np.random.default_rng(0)
    for number in (1, 5, MOST_VIEWS, 3 * MOST_VIEWS):
        rmse = random.random(number)
        shown = _spread(rmse)
        assert len(shown) == min(number, MOST_VIEWS)
        assert shown == sorted(shown, key=lambda i: -rmse[i])
        assert (rmse[shown[0]], rmse[shown[-1]]) == (rmse.max(), rmse.min())


def test_fewer_rays_hit_a_face_the_more_they_graze_it():
    figure = diffuse_over_theta()
    arrows = [len(axes.texts) for axes in figure.axes if not axes.axison and axes.texts]
    share = np.cos(np.deg2rad([0, 15, 30, 45, 60, 75]))
    assert len(arrows) == len(share)  # at 90 degrees none does
    assert np.abs(np.array(arrows) - arrows[0] * share).max() <= 1.0


# Packages


def test_the_documentation_without_its_packages_says_which():
    code = (
        "import sys, runpy; sys.modules['pdoc'] = None; sys.path.insert(0, 'docs'); "
        "runpy.run_path('docs/build.py', run_name='__main__')"
    )
    run = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False)
    assert run.returncode == 1
    assert run.stderr == "the documentation needs pdoc, which is not here. Run pip install -e '.[docs]'.\n"


def test_an_editable_install_is_a_plain_path():
    """With dev-mode-exact a script beside a clone named diffshade imports the clone's folder; see the study."""
    with (ROOT / "pyproject.toml").open("rb") as file:
        build = tomllib.load(file)["tool"]["hatch"]["build"]
    assert "dev-mode-exact" not in build
