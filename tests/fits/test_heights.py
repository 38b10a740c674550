"""Heights from normals: surfaces of known height, their errors, parts and jumps, and what a user writes."""

from __future__ import annotations

import inspect
import tomllib
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import reliefs
from refusals import refuses
from reliefs import Relief, covered, off, relative, relief, stepped

import diffshade as ds
from diffshade.texels.heights.curl import curls, noise_scale
from diffshade.texels.heights.differences import differences, rays_of, smoothed
from diffshade.texels.heights.system import HeightGrid, HeightSystem

SIZE = 48
ONE = np.ones((SIZE, SIZE))  # degree
plain = inspect.unwrap(ds.heights.integrate_normals)  # past a type checker, which refuses a shape itself


def integrated(relief: Relief, degrees: float = 1.0, seed: int = 0, **options) -> ds.heights.HeightMap:
    """The heights of a relief's normals with an error that is known."""
    given = {
        "mask": relief.mask,
        "errors": np.full(relief.mask.shape, max(degrees, 1e-3)),
        "shared_error": 0.0,
    } | options
    return ds.heights.integrate_normals(relief.noisy(degrees, seed), relief.camera, **given)


@pytest.fixture(scope="module")
def ball() -> Relief:
    return reliefs.sphere(SIZE)


@pytest.fixture(scope="module")
def found(ball) -> ds.heights.HeightMap:
    with jax.enable_x64(False):  # as most users have it
        heights = integrated(ball)
        assert jnp.zeros(1).dtype == jnp.float32
    return heights


SURFACES = {
    "ball": lambda perspective: reliefs.sphere(SIZE, perspective=perspective),
    "vase": lambda perspective: reliefs.vase(SIZE, perspective=perspective),
    "plane": lambda perspective: relief(SIZE, reliefs.tilted, perspective=perspective),
    "step": lambda perspective: relief(SIZE, stepped(0.3), perspective=perspective),
}


@pytest.mark.parametrize(("name", "perspective"), [("ball", True), ("vase", False), ("step", True)])
def test_heights_of_noisy_normals(name: str, perspective: bool):
    """Required: 1 % of the range; the 95 % intervals of one image are right on average only."""
    surface = SURFACES[name](perspective)
    heights = integrated(surface)
    assert heights.part.max() == 0
    assert relative(heights, surface) < 0.01
    assert covered(heights, surface) > 0.8
    # an error that says nothing would cover too
    assert 0.3 < np.sqrt(np.mean(off(heights, surface) ** 2) / np.mean(heights.errors[heights.mask] ** 2)) < 3.0


@pytest.mark.parametrize("perspective", [False, True])
@pytest.mark.parametrize("name", ["ball", "plane"])
def test_the_chord_is_exact_on_planes_and_spheres(name: str, perspective: bool):
    surface = SURFACES[name](perspective)
    heights = integrated(surface, degrees=0.0)
    facing = heights.mask if name == "plane" else heights.mask & (surface.normal[..., 2] > 0.5)
    wrong = np.zeros(heights.mask.shape)
    wrong[heights.mask] = off(heights, surface)
    assert np.ptp(wrong[facing]) < 2e-5 * np.ptp(surface.z[facing])


def test_heights_are_in_scene_units():
    """A plane that rises by 1 in 2 along x, seen by a camera 5 scene units high."""
    normal = np.broadcast_to(np.array([-1.0, 0.0, 2.0]) / np.sqrt(5.0), (20, 30, 3))
    camera = ds.OrthographicCamera((1.0, 2.0, 9.0), target=(1.0, 2.0, -3.0), height=5.0, shape=(20, 30))
    heights = ds.heights.integrate_normals(normal, camera)
    np.testing.assert_allclose(heights.height, 0.125 * (np.arange(30) - 14.5)[None] + 0.0 * ONE[:20, :1], atol=1e-9)
    x, y, z = np.moveaxis(heights.position, -1, 0)
    np.testing.assert_allclose(z, -3.0 + 0.5 * (x - 1.0), atol=1e-9)
    np.testing.assert_allclose(y[0], 2.0 + 2.5 - 0.125, atol=1e-12)
    np.testing.assert_allclose(heights.depth, 9.0 - z, atol=1e-9)


def test_any_pose_of_the_camera(ball, found):
    """Normals are in world coordinates: a camera anywhere sees the same ball."""
    camera = ds.OrthographicCamera((4.0, 3.0, 1.0), up=(0.2, 0.1, 1.0), shape=(SIZE, SIZE))
    with jax.enable_x64(True):
        seen = ds.intersect(ds.Scene(ds.Object(ds.Sphere(), ds.Material()), ds.DirectionalLight((0, 0, -1))), camera)
    heights = ds.heights.integrate_normals(np.asarray(seen.normal), camera, mask=np.asarray(seen.mask))
    assert np.abs(heights.height - found.height)[heights.mask & found.mask].max() < 0.05
    radius = heights.position[heights.mask] - np.asarray(seen.position)[heights.mask]
    np.testing.assert_allclose(radius - radius.mean(0), 0.0, atol=0.06)


def test_a_step_keeps_its_height_where_it_fades_out():
    """Required: the step's height within 5 %. Plain least squares would lose more than half of it."""
    for height, end, angle in ((0.3, 0.2, 0.0), (0.3, -0.4, 0.0), (0.2, 0.0, 30.0)):
        surface = relief(SIZE, stepped(height, end=end, angle=angle))
        heights = integrated(surface)
        wrong = np.zeros(heights.mask.shape)
        wrong[heights.mask] = off(heights, surface)
        # beside the line at the border where the step is highest
        line = 0.5 * SIZE * (1.0 - np.tan(np.deg2rad(angle)))
        left, right = wrong[:4, : int(line) - 1], wrong[:4, int(line) + 4 :]
        step = abs(surface.z[0, int(line) + 4] - surface.z[0, int(line) - 4])
        assert abs(right[:, :6].mean() - left[:, -6:].mean()) < 0.05 * step
        assert heights.jump_right.sum() > 10
        assert any(note.kind == "jumps" for note in heights.notes)


@pytest.mark.parametrize("angle", [0.0, 30.0])
def test_a_step_from_border_to_border_leaves_two_parts(angle: float):
    surface = relief(SIZE, stepped(0.3, whole=True, angle=angle))
    heights = integrated(surface)
    large = np.bincount(heights.part.ravel()) > 20
    assert large.sum() == 2
    note = next(note for note in heights.notes if note.kind == "parts")
    assert "relative heights of 2 parts" in note
    assert "not determined" in note
    assert note in str(heights)
    assert (
        np.median(np.abs(off(heights, surface))) < 0.005 * 0.4
    )  # single texels along the line may count to either side
    for part in (0, 1):
        assert heights.height[heights.part == part].mean() == pytest.approx(0.0, abs=1e-9)
    x, y = reliefs.grid(SIZE)
    right = np.cos(np.deg2rad(angle)) * x + np.sin(np.deg2rad(angle)) * y > 0
    assert min(np.mean(heights.part[right] == p) + np.mean(heights.part[~right] == 1 - p) for p in (0, 1)) < 0.1


def test_a_mask_may_have_holes_and_parts(ball):
    mask = ball.mask.copy()
    mask[10:16, 20:26] = False
    mask[:, 30] = False
    heights = integrated(ball, mask=mask)
    assert heights.part.max() == 1
    np.testing.assert_array_equal(heights.part >= 0, mask)
    assert (heights.part[:, 31:][mask[:, 31:]] == 1).all()
    assert relative(heights, ball) < 0.01
    assert (heights.height[~mask] == 0).all()
    assert (heights.errors[~mask] == 0).all()
    assert not heights.jump_right[:, 29].any(), "there is nothing to jump to"


def test_bad_normals_with_large_errors_do_not_spoil_the_rest(ball, found):
    """Nor do normals that are not known, whatever stands in their place."""
    bad = np.zeros(ball.mask.shape, bool)
    bad[18:26, 12:20] = True
    rng = np.random.default_rng(5)
    poor = np.where(bad[..., None], ball.noisy(25.0, seed=3), ball.noisy(1.0))
    weighed = ds.heights.integrate_normals(
        poor, ball.camera, mask=ball.mask, errors=np.where(bad, 25.0, 1.0), shared_error=0
    )
    junk = np.where(rng.random((SIZE, SIZE, 1)) < 0.5, np.nan, rng.standard_normal((SIZE, SIZE, 3)))
    junk = np.where(bad[..., None], junk, ball.noisy(1.0))
    bridged = ds.heights.integrate_normals(
        junk, ball.camera, mask=ball.mask, errors=np.where(bad, np.inf, 1.0), shared_error=0
    )
    for heights in (weighed, bridged):
        far = heights.mask & found.mask & ~bad
        assert (heights.height - found.height)[far].std() < 0.5 * np.median(found.errors[far])
        assert np.median(heights.errors[bad] / found.errors[bad]) > 1.3
        assert np.abs((heights.height - found.height)[bad]).max() < 4.0 * heights.errors[bad].max()
        np.testing.assert_allclose(heights.errors[:, 30:], found.errors[:, 30:], rtol=0.5)
        assert relative(heights, ball) < 0.01
    assert next(n for n in bridged.notes if n.kind == "interpolated").startswith("64 normals")


def test_errors_that_are_not_given_are_estimated(ball, found):
    """And those that are too small for what the curl shows are enlarged."""
    estimated = integrated(ball, errors=None)
    note = next(n for n in estimated.notes if n.kind == "errors estimated")
    assert float(note.split("given: ")[1].split()[0]) == pytest.approx(1.0, rel=0.1)
    enlarged = integrated(ball, errors=0.2 * ONE)
    note = next(n for n in enlarged.notes if n.kind == "errors enlarged")
    assert float(note.split("multiplied by ")[1].split(",")[0]) == pytest.approx(5.0, rel=0.1)
    for heights in (estimated, enlarged):
        np.testing.assert_allclose(heights.errors[found.mask], found.errors[found.mask], rtol=0.3)
    assert not any(n.kind.startswith("errors") for n in found.notes)


def test_errors_grow_with_those_of_the_normals(ball, found):
    twice = integrated(ball, degrees=2.0, errors=2.0 * ONE)
    both = found.mask & (ball.normal[..., 2] > 0.5)
    assert np.median(twice.errors[both] / found.errors[both]) == pytest.approx(2.0, rel=0.1)


def test_normals_that_face_away_are_not_known(ball):
    normals = ball.noisy(1.0)
    normals[20, 20] = (0.6, 0.0, -0.8)
    heights = ds.heights.integrate_normals(normals, ball.camera, mask=ball.mask, errors=ONE)
    assert any(n.kind == "facing away" for n in heights.notes)
    assert relative(heights, ball) < 0.01


def test_a_part_without_normals_has_no_height(ball):
    mask, errors = ball.mask.copy(), ONE.copy()
    mask[0, :5] = True
    errors[0, :5] = np.inf
    heights = integrated(ball, mask=mask, errors=errors)
    assert (heights.part[0, :5] == -1).all()
    assert np.isinf(heights.errors[0, :5]).all()
    assert next(n for n in heights.notes if n.kind == "without normals").startswith("5 texels")


def test_the_surface_renders(ball, found):
    light = ds.PointLight((2.0, 3.0, 4.0))
    material = ds.Material(k_d=0.7)
    truth = np.asarray(ds.render(ds.Scene(ds.Object(ds.Sphere(), material), light), ball.camera))
    image = np.asarray(ds.render(ds.Scene(ds.Object(found.as_surface(), material), light), ball.camera))
    assert np.abs(image - truth)[found.mask].mean() < 0.03
    assert (found.as_surface().mask == found.mask).all()


def test_perspective_points_lie_on_the_surface():
    ball = reliefs.sphere(SIZE, perspective=True)
    heights = integrated(ball, degrees=0.1, errors=0.1 * ONE)
    eye = np.array([0.0, 0.0, reliefs.FAR])
    scale = np.median((reliefs.FAR - ball.z)[heights.mask] / heights.depth[heights.mask])
    points = eye + scale * (heights.position - eye)
    assert np.quantile(np.abs(np.linalg.norm(points, axis=-1)[heights.mask] - 1.0), 0.99) < 0.01
    assert np.mean(np.log(heights.depth[heights.mask])) == pytest.approx(np.log(reliefs.FAR), abs=1e-9)


@pytest.mark.parametrize("suffix", [".npy", ".exr", ".png"])
def test_heights_are_written(found, tmp_path, suffix):
    written = found.write(tmp_path / "here", suffix=suffix)
    assert sorted(path.name for path in (tmp_path / "here").iterdir()) == sorted(path.name for path in written)
    about = tomllib.loads((tmp_path / "here" / "heights.toml").read_text())
    assert about["notes"] == [str(note) for note in found.notes]
    path = tmp_path / "here" / f"height{suffix}"
    image = np.load(path) if suffix == ".npy" else ds.read_image(path, srgb=False)[..., 0]
    if suffix == ".npy":
        np.testing.assert_array_equal(image, found.height)
        np.testing.assert_array_equal(np.load(tmp_path / "here" / "height_error.npy"), found.errors)
    elif suffix == ".exr":
        np.testing.assert_allclose(image, found.height, atol=1e-6)
    else:
        low, high = about["scale"]["black"], about["scale"]["white"]
        np.testing.assert_allclose((low + image * (high - low))[found.mask], found.height[found.mask], atol=1e-4)
    part = ds.read_image(tmp_path / "here" / "part.png", srgb=False)[..., 0]
    np.testing.assert_allclose(part * 65535, found.part + 1, atol=1e-6)


def test_heights_in_words(found):
    words = str(found)
    assert f"{found.mask.sum():,} texels in 1 part, {SIZE} x {SIZE}" in words
    assert f"{np.median(found.errors[found.mask]):.2g} in the median" in words


def at(row: int, column: int, vector: object) -> Callable[[Relief], dict]:
    """Arguments with another normal at one texel."""

    def change(ball: Relief) -> dict:
        normals = ball.normal.copy()
        normals[row, column] = vector
        return {"normals": normals}

    return change


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        (lambda ball: {"normals": ball.normal[:-1]}, ("normals", f"({SIZE}, {SIZE}, 3)", f"({SIZE - 1}, {SIZE}, 3)")),
        (lambda ball: {"mask": ball.mask[:, 1:]}, ("mask", f"({SIZE}, {SIZE})", "Resize")),
        (lambda ball: {"errors": ONE[1:]}, ("errors", f"({SIZE}, {SIZE})", f"({SIZE - 1}, {SIZE})")),
        (lambda ball: {"errors": 0.0 * ONE}, ("errors", "above 0", "got 0.0")),
        (lambda ball: {"errors": np.nan * ONE}, ("errors", "above 0", "got nan")),
        (lambda ball: {"errors": np.inf * ONE}, ("no normal is left", "40 degrees")),
        (lambda ball: {"mask": ~ball.mask & False}, ("no normal is left", "mask has 0 texels")),
        (at(20, 21, (0.0, 0.0, 2.0)), ("row 20, column 21", "[0. 0. 2.]", "Normalise")),
        (at(20, 21, np.nan), ("row 20, column 21", "nan", "infinite error")),
        (lambda ball: {"normals": -ball.normal}, ("face the camera", "world coordinates")),
    ],
)
def test_what_cannot_be_integrated_is_refused(ball, wrong, words):
    given = {"normals": ball.normal, "mask": ball.mask} | wrong(ball)
    normals = given.pop("normals")
    refuses(lambda: plain(normals, ball.camera, **given), *words)


def test_what_is_of_another_kind_is_refused(ball, found, tmp_path):
    refuses(lambda: plain(ball.normal, "camera"), "camera", "OrthographicCamera", error=TypeError)
    refuses(lambda: plain("normals.png", ball.camera), "normals", "str", error=TypeError)
    refuses(lambda: found.write(tmp_path / "none", suffix=".jpg"), "suffix", "'.jpg'", ".exr")
    assert not (tmp_path / "none").exists()


def test_noise_is_told_from_the_curl():
    """Of normals with an error of 1 degree on a curved surface; creases, jumps and the border do not count."""
    surface = relief(96, stepped(0.3))
    sigma = np.full(surface.mask.shape, np.deg2rad(1.0) / np.sqrt(2.0))
    grid = HeightGrid.of(surface.mask)
    pairs = differences(surface.noisy(1.0), sigma, grid, rays_of(surface.camera))
    assert noise_scale(grid, pairs) == pytest.approx(1.0, abs=0.05)
    curl = curls(grid, pairs.value, pairs.shown())[1]
    assert np.median(np.abs(curl)) / 0.6745 == pytest.approx(1.0, abs=0.1)
    assert np.abs(curl[:, 22:25]).max() > 5.0


def test_smoothing_follows_a_slope_to_the_border():
    """A mean of texels would be drawn inwards at the border."""
    x, y = reliefs.grid(24)
    normals = np.stack([0.5 * x, 0.3 * y, 0.0 * x + 1.0], -1)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    np.testing.assert_allclose(smoothed(normals, np.ones((24, 24), bool)), normals.reshape(-1, 3), atol=4e-3)


def test_a_solution_is_as_exact_as_it_is_asked_to_be():
    """In standard deviations of the differences, whatever their units."""
    grid, rng = HeightGrid.of(np.ones((SIZE, SIZE), bool)), np.random.default_rng(0)
    deviation = 1e-3 * rng.uniform(0.2, 5.0, grid.start.size)
    d = deviation * rng.standard_normal(grid.start.size) + 0.1
    system = HeightSystem(grid, 1.0 / deviation**2)
    best = system.solve(d, tolerance=1e-6)
    for tolerance in (1.0, 0.01):
        off = np.linalg.norm(grid.step(system.solve(d, tolerance=tolerance) - best) / deviation)
        assert 0.0 < off < 2.0 * tolerance
