"""Views become residuals: which samples count, and that blocks, padding and stacking change nothing about them."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from normal_equations import (
    SMALL,
    assert_equal,
    dense_gram,
    gram,
    grey_views_of_normals_without_positions,
    lights_of_several_kinds_and_views_of_every_sort,
    problem_of,
    random_views,
    several_objects_and_cameras,
)
from refusals import refuses
from synthetic import seen_by, standard_scene

import diffshade as ds
from diffshade.core import backend
from diffshade.inverse.data.samples import Samples, SensorRange, find_samples
from diffshade.inverse.data.view_sets import ViewSet
from diffshade.inverse.data.views import is_grey
from diffshade.inverse.fitting import new_problem
from diffshade.inverse.forward.features import FeatureModel
from diffshade.inverse.pixels import blocks
from diffshade.inverse.pixels.blocks import block_size, pieces
from diffshade.inverse.problem import PART, fit_problem
from diffshade.inverse.unknowns.parameters import find_unknowns
from diffshade.io.lazy_images import LazyImage
from diffshade.parallel.threads import on_all_cores
from diffshade.texels.tiles import TexelTile, ViewReader

BALL = ds.Scene(ds.Object(ds.Sphere()), [ds.PointLight((2, 3, 4))])
SILHOUETTE = (6, 5)  # a pixel on the ball in SMALL
DARK = np.full((10, 12, 3), 0.5)


def changed(image: np.ndarray, *, at: tuple, value: float) -> np.ndarray:
    image = image.copy()
    image[at] = value
    return image


# --- what a view is


@pytest.mark.parametrize(("channels", "grey"), [((), True), ((2,), True), ((3,), False), ((4,), False)])
def test_an_image_may_be_grey_with_or_without_its_channel_axis_and_have_alpha(channels, grey):
    view = ds.View(np.zeros((10, 12, *channels)), SMALL)
    assert view.image.shape == (10, 12, *(channels or (1,)))
    assert is_grey(view) is grey


def test_what_is_lit():
    assert [ds.View(DARK, SMALL, lit=lit).lit for lit in (2, (2,), [2], (), None)] == [(2,), (2,), (2,), (), None]
    # switches are no indices: (True, False) would silently mean lights 1 and 0
    refuses(lambda: ds.View(DARK, SMALL, lit=(True, False)), "lit", error=(TypeError, ValueError))


@pytest.mark.parametrize(
    ("image", "options", "words"),
    [
        (DARK[..., None], {}, ("View.image", "shape", "(10, 12, 3, 1)")),
        (np.zeros((10, 12, 41)), {}, ("View.image", "shape", "(10, 12, 41)", "40")),
        (DARK, {"saturation": np.nan}, ("View.saturation", "number or None", "nan", "level")),
        (DARK, {"exposure": -1.0}, ("View.exposure", "above 0", "-1.0")),
        (DARK, {"exposure": np.inf}, ("View.exposure", "finite", "inf")),
        (DARK, {"exposure": (1.0, 2.0)}, ("View.exposure", "a number", "(2,)")),
    ],
)
def test_what_is_no_view_is_refused(image, options, words):
    refuses(lambda: ds.View(image, ds.Camera((0, 0, 4), fov=32, shape=SMALL.shape), **options), *words)


# --- which samples count


def test_without_a_mask_the_silhouette_counts():
    samples = find_samples(BALL, ds.View(DARK, SMALL))
    np.testing.assert_array_equal(samples.inside, ds.intersect(BALL, SMALL).mask)
    assert 0 < samples.inside.sum() < samples.inside.size
    np.testing.assert_array_equal(samples.pixels, np.flatnonzero(samples.inside))
    assert samples.ends().shape == (samples.inside.sum(), 3)
    assert not samples.ends().any()


@pytest.mark.parametrize("kind", [bool, float])
def test_a_mask_takes_away_from_the_silhouette_and_adds_nothing(kind):
    left = np.broadcast_to(np.arange(12) < 6, (10, 12))
    samples = find_samples(BALL, ds.View(DARK, SMALL, mask=left.astype(kind)))
    np.testing.assert_array_equal(samples.inside, left & ds.intersect(BALL, SMALL).mask)


def test_a_mask_of_floats_is_inside_from_one_half():
    mask = changed(np.full((10, 12), 0.499), at=SILHOUETTE, value=0.5)
    assert np.argwhere(find_samples(BALL, ds.View(DARK, SMALL, mask=mask)).inside).tolist() == [list(SILHOUETTE)]


@pytest.mark.parametrize("channels", [1, 3])
def test_a_further_channel_is_alpha_and_takes_away_too(channels):
    alpha = changed(np.full((10, 12, 1), 0.499), at=SILHOUETTE, value=0.5)
    view = ds.View(np.concatenate([DARK[..., :channels], alpha], -1), SMALL)
    samples = find_samples(BALL, view)
    assert np.argwhere(samples.inside).tolist() == [list(SILHOUETTE)]
    assert samples.values(samples.pixels).tolist() == [[0.5] * channels]
    none = ds.View(view.image, SMALL, mask=changed(np.ones((10, 12), bool), at=SILHOUETTE, value=False))
    refuses(lambda: find_samples(BALL, none), "no pixel is left to fit")


def test_a_sample_at_exactly_one_is_clipped_where_nothing_is_above():
    """The top of an integer file's range. It is marked; the pixel's other channels were measured."""
    samples = find_samples(BALL, ds.View(changed(DARK, at=(*SILHOUETTE, 1), value=1.0), SMALL))
    pixel = samples.pixels == np.ravel_multi_index(SILHOUETTE, SMALL.shape)
    assert samples.ends()[pixel].tolist() == [[0, 1, 0]]
    assert not samples.ends()[~pixel].any()
    assert samples.values(samples.pixels[pixel]).tolist() == [[0.5, 1.0, 0.5]]


@pytest.mark.parametrize("top", [1.0 - 1e-9, 1.0 + 1e-9, 3.0])
def test_another_largest_value_is_not_clipped(top):
    image = changed(changed(DARK, at=(*SILHOUETTE, 1), value=1.0), at=(*SILHOUETTE, 0), value=top)
    image[SILHOUETTE][1] = min(top, 1.0)
    assert clipped(ds.View(image, SMALL)) == 0


def clipped(view: ds.View, end: int = 1) -> int:
    """How many samples are clipped at the top, or with -1 at the bottom."""
    return int((find_samples(BALL, view).ends() == end).sum())


def test_saturation_names_the_level():
    image = changed(DARK, at=SILHOUETTE, value=0.9)
    assert clipped(ds.View(image, SMALL, saturation=0.8)) == 3
    assert clipped(ds.View(image, SMALL, saturation=0.9)) == 3
    assert clipped(ds.View(image, SMALL, saturation=0.91)) == 0
    ones = changed(DARK, at=SILHOUETTE, value=1.0)
    assert clipped(ds.View(ones, SMALL, saturation=float("inf"))) == 0


def test_floor_names_the_level_at_the_bottom_and_is_none_by_default():
    image = changed(DARK, at=SILHOUETTE, value=0.0)
    assert clipped(ds.View(image, SMALL), -1) == 0
    assert clipped(ds.View(image, SMALL, floor=0.0), -1) == 3
    assert clipped(ds.View(image, SMALL, floor=-0.01), -1) == 0
    both = ds.View(
        changed(image, at=(SILHOUETTE[0], SILHOUETTE[1] + 1, 2), value=0.9), SMALL, floor=0.1, saturation=0.8
    )
    assert (clipped(both, -1), clipped(both, 1)) == (3, 1)


def test_a_number_that_is_not_finite_is_named_by_row_and_column_unless_it_is_masked():
    row, column = SILHOUETTE
    for bad in (np.nan, np.inf):
        image = changed(DARK, at=(*SILHOUETTE, 2), value=bad)
        words = ("finite inside the mask", f"row {row}, column {column} (1 such")
        refuses(lambda image=image: find_samples(BALL, ds.View(image, SMALL)), *words)
        mask = changed(np.ones((10, 12), bool), at=SILHOUETTE, value=False)
        samples = find_samples(BALL, ds.View(image, SMALL, mask=mask))
        assert np.isfinite(samples.values(samples.pixels)).all()
        assert len(samples.pixels) > 0


def test_a_corner_outside_the_silhouette_may_hold_anything():
    samples = find_samples(BALL, ds.View(changed(DARK, at=(0, 0), value=np.nan), SMALL))
    assert not samples.inside[0, 0]


def test_a_moving_surface_needs_a_mask_and_loses_one_pixel_of_its_edge():
    refuses(lambda: find_samples(BALL, ds.View(DARK, SMALL), moving=True), "surface needs a mask", "View.mask")
    mask = np.zeros((10, 12), bool)
    mask[2:7, 3:8] = True
    mask[0, :] = True  # at the picture's own edge, and one pixel thin
    core = np.zeros((10, 12), bool)
    core[3:6, 4:7] = True
    np.testing.assert_array_equal(find_samples(BALL, ds.View(DARK, SMALL, mask=mask), moving=True).inside, core)
    rgba = np.concatenate([DARK, mask[..., None]], -1)
    np.testing.assert_array_equal(find_samples(BALL, ds.View(rgba, SMALL), moving=True).inside, core)


def test_a_mask_of_a_moving_surface_does_not_depend_on_where_the_surface_starts():
    everywhere = np.ones((10, 12), bool)
    assert find_samples(BALL, ds.View(DARK, SMALL, mask=everywhere), moving=True).inside.sum() == 8 * 10


def test_counts_add_up_over_views_of_all_kinds():
    silhouette = int(np.asarray(ds.intersect(BALL, SMALL).mask).sum())
    views = [
        ds.View(DARK, SMALL),
        ds.View(DARK[..., 0], SMALL),
        ds.View(changed(DARK, at=SILHOUETTE, value=1.0), SMALL),
        ds.View(DARK, SMALL, mask=changed(np.zeros((10, 12), bool), at=SILHOUETTE, value=True)),
    ]
    unknowns = find_unknowns(BALL, views, ("k_d",))
    data = new_problem(BALL, ViewSet.of(BALL, views), unknowns, "squares", "hinge").data
    samples, counts = data.samples, data.counts
    assert (counts.views, counts.pixels, counts.clipped, counts.left_out) == (4, 3 * silhouette + 1, 3, 0)
    assert counts.samples == (3 + 1 + 3) * silhouette + 3
    assert [len(s.pixels) for s in samples] == [silhouette] * 3 + [1]
    data = new_problem(BALL, ViewSet.of(BALL, views), unknowns, "squares", "exclude").data  # one pixel
    samples, counts = data.samples, data.counts
    assert (counts.views, counts.pixels, counts.clipped, counts.left_out) == (4, 3 * silhouette, 0, 3)
    assert counts.samples == (3 + 1 + 3) * silhouette - 3 + 3
    assert [len(s.pixels) for s in samples] == [silhouette, silhouette, silhouette - 1, 1]


@pytest.mark.parametrize("lazy", [False, True])
def test_texels_count_by_the_same_rule(lazy):
    clipped = changed(DARK, at=(*SILHOUETTE, 1), value=1.0)
    bright = changed(clipped, at=(SILHOUETTE[0], SILHOUETTE[1] + 1, 0), value=3.0)  # its 1 is no end of a file's range
    masked = np.concatenate([DARK, changed(np.ones((10, 12, 1)), at=SILHOUETTE, value=0.2)], -1)
    images = [
        LazyImage(lambda a, b, i=i: i[a:b], i.shape, i.dtype) if lazy else i
        for i in (clipped, bright, masked, bright / 2)
    ]
    views = [*(ds.View(image, SMALL) for image in images[:3]), ds.View(images[3], SMALL, saturation=0.5, floor=0.1)]
    tile = ViewReader(BALL, views).read(0, 10, 10)
    for view, counts in zip(views, tile.counts, strict=True):
        samples = find_samples(BALL, view)
        np.testing.assert_array_equal(tile.pixels[counts], samples.pixels[(samples.ends() == 0).all(-1)])


# --- blocks, padding and stacking change nothing


PROBLEMS = [
    lights_of_several_kinds_and_views_of_every_sort,
    pytest.param(several_objects_and_cameras, marks=pytest.mark.slow),
    pytest.param(grey_views_of_normals_without_positions, marks=pytest.mark.slow),
]


@pytest.mark.thorough
@pytest.mark.parametrize("problem", PROBLEMS)
def test_the_gram_of_the_blocks_is_that_of_a_dense_jacobian(problem, monkeypatch):
    monkeypatch.setattr(blocks, "BLOCK", 37)  # several blocks a view, the last one padded, and several chunks
    monkeypatch.setattr(blocks, "CHUNK", 3)
    with jax.enable_x64(True):
        scene, views, free, tied = problem()
        unknowns = find_unknowns(scene, views, free, tied, grey=all(is_grey(view) for view in views))
        theta = np.random.default_rng(1).uniform(0.2, 0.9, len(unknowns))
        theta[[u.name == "cutoff" for u in unknowns]] = 33.0
        assert_equal(gram(scene, views, unknowns, theta), dense_gram(scene, views, unknowns, theta))


@pytest.mark.thorough
def test_a_moving_sphere_is_compared_inside_its_fixed_mask():
    """A ray that misses takes the sphere's nearest point, so that one that starts too small has a slope too."""
    with jax.enable_x64(True):
        views = random_views(BALL, [SMALL], mask=seen_by(SMALL).mask)
        unknowns = find_unknowns(BALL, views, ("center", "radius", "k_d"))
        large, small = (np.array([0.02, -0.01, 0.03, radius, 0.5, 0.4, 0.3]) for radius in (1.05, 0.5))
        fills_the_mask = gram(BALL, views, unknowns, large)
        assert_equal(fills_the_mask, dense_gram(BALL, views, unknowns, large, moving=True))
        shrunk = gram(BALL, views, unknowns, small)
        assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(shrunk))
        assert np.all(np.diagonal(shrunk.hessian[0]) > 0)


def test_padding_has_no_weight_and_clipped_samples_are_marked():
    with jax.enable_x64(True):
        views = [
            ds.View(changed(DARK, at=(*SILHOUETTE, 1), value=1.0), SMALL),
            ds.View(DARK[..., 0], SMALL, saturation=0.9, floor=0.5),
        ]
        unknowns = find_unknowns(BALL, views, ("k_d",))
        work = problem_of(BALL, views, unknowns)
        (chunk,) = work.chunks()
        seen = chunk.observed
        assert seen.clipped is not None
        weight = np.asarray(seen.weight)
        assert set(np.unique(weight)) == {0.0, 1.0}
        silhouette = work.data.pixels[0]
        assert weight.sum(-1).tolist() == [[silhouette] * 3, [silhouette, 0, 0]]
        marks = np.asarray(seen.clipped) * weight
        assert (marks > 0).sum(-1).tolist() == [[0, 1, 0], [0, 0, 0]]
        assert (marks < 0).sum(-1).tolist() == [[0, 0, 0], [silhouette, 0, 0]]
        assert np.asarray(seen.target)[weight > 0].max() == 1.0
        assert not np.asarray(seen.target)[weight == 0].any()


def test_known_noise_weighs_each_sample_by_its_variance_at_the_photographs_level():
    with jax.enable_x64(True):
        noise = ds.Noise(read=0.1, shot=0.3)
        views = random_views(BALL, [SMALL], noise=noise)
        unknowns = find_unknowns(BALL, views, ("k_d",))
        (chunk,) = problem_of(BALL, views, unknowns).chunks()
        target, weight = np.asarray(chunk.observed.target), np.asarray(chunk.observed.weight)
        assert 3 * len(find_samples(BALL, views[0]).pixels) == (weight > 0).sum() < weight.size
        np.testing.assert_allclose(weight[weight > 0], 1.0 / (0.01 + 0.3 * target[weight > 0]), rtol=1e-12)


def test_a_part_of_the_pixels_is_spread_over_every_view_and_all_of_them_are_each_once():
    scene = standard_scene()
    large = ds.Camera(eye=(0, 0, 4), fov=32, shape=(60, 60))
    mask = np.zeros(large.shape, bool)
    mask[25:35, 25:35] = True
    picture = np.full((*large.shape, 3), 0.5)
    views = [ds.View(picture, large), ds.View(picture, large, mask=mask)]
    unknowns = find_unknowns(scene, views, ("k_d",))
    data = new_problem(scene, ViewSet.of(scene, views), unknowns, "squares", "hinge").data
    samples, counts = data.samples, data.counts
    everything = pieces(samples, 64)
    for view, s in enumerate(samples):
        pixels = np.concatenate([part.pixels for part in everything if part.view == view])
        np.testing.assert_array_equal(pixels, s.pixels)
    part = pieces(samples, 64, 500)
    first, second = (np.concatenate([p.pixels for p in part if p.view == view]) for view in range(2))
    assert len(first) == len(samples[0].pixels) * 500 // counts.pixels
    assert np.isin(first, samples[0].pixels).all()
    assert len(np.unique(first)) == len(first)
    steps = np.diff(np.flatnonzero(np.isin(samples[0].pixels, first)))
    assert steps.max() - steps.min() <= 1
    np.testing.assert_array_equal(second, samples[1].pixels)  # a view so small is taken whole
    assert max(len(piece.pixels) for piece in part) <= 64


@pytest.mark.parametrize(("count", "size"), [(1, 64), (64, 64), (65, 96), (2048, 2048), (5000, 3072)])
def test_a_block_has_one_of_a_few_sizes_that_holds_a_small_view_and_is_never_too_large(count, size):
    h = np.ones((count, 1), bool)
    camera = ds.OrthographicCamera((0, 0, 4), shape=(count, 1), local_viewer=False)
    normal = np.broadcast_to(np.array([0.0, 0.0, 1.0]), (count, 1, 3))
    scene = ds.Scene(ds.Object(ds.GBuffer(normal)), [ds.DirectionalLight((0, 0, -1))])
    samples = find_samples(scene, ds.View(np.full((count, 1), 0.5), camera, mask=h))
    assert block_size([len(samples.pixels)] * 3) == size


def test_the_blocks_of_many_views_are_hardly_padded():
    assert [block_size([n] * (100_000 // n)) for n in (70, 1000, 2660, 3100, 20_000)] == [72, 1024, 2816, 1664, 2048]
    assert [block_size([n] * 200, places=16) for n in (200, 5000)] == [104, 128]
    for n in range(180, 30_000, 7):
        size = block_size([n] * 200)
        assert -(-n // size) * size <= 1.14 * n, n
        assert size <= 1.5 * blocks.BLOCK


def tile_of(texels: int) -> TexelTile:
    black = np.zeros((1, 1, texels))
    return TexelTile(np.arange(texels), np.zeros((texels, 3)), None, black, black[0].astype(bool))


def test_a_gpu_is_given_more_at_once(monkeypatch):
    monkeypatch.setattr(backend.jax, "default_backend", lambda: "gpu")
    assert block_size([2**20]) == backend.AT_ONCE
    reader = ViewReader(BALL, [ds.View(DARK, SMALL)] * 2)
    assert reader.pieces(tile_of(5000), np.zeros((2, 5000)))[0].size == 8192


@pytest.mark.thorough
def test_a_fit_with_the_blocks_of_a_gpu_is_the_same(monkeypatch):
    scene, camera = standard_scene(), ds.Camera((0, 0, 4), fov=32, shape=(96, 96))
    view = ds.View(np.asarray(ds.render(scene, camera)), camera)
    here = ds.fit(scene, view, free=("k_d", "n_s"))
    monkeypatch.setattr(backend.jax, "default_backend", lambda: "gpu")
    there = ds.fit(scene, view, free=("k_d", "n_s"))
    assert there.solved.problem.block_size > 1.5 * blocks.BLOCK
    np.testing.assert_allclose(there.values, here.values, rtol=1e-9)


def shared_problem(views: list, lights: int, free: str, **options) -> tuple:
    """Return a problem of views of a ball, and its samples."""
    scene = ds.Scene(ds.Object(ds.Sphere()), [ds.DirectionalLight((0.1 * k, 0.2, -1)) for k in range(lights)])
    unknowns = find_unknowns(scene, views, (free,))
    data = new_problem(scene, ViewSet.of(scene, views), unknowns, "squares", "hinge").data
    return fit_problem(scene, data, unknowns, "squares", **options), data.samples


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("free", "options", "noise", "shared"),
    [
        ("direction", {}, ds.Noise(0.01, 0.1), True),
        ("k_d", {}, None, False),  # each chunk has what its lights do there
        ("k_d", {"rendered": True}, None, True),
    ],
)
def test_views_that_show_the_same_points_share_them(free, options, noise, shared):
    """Those of one camera and mask; where the lights are known, those of one light too."""
    left, right = (ds.Camera(eye=(x, 0, 4), fov=32, shape=shape) for x, shape in ((-1, (16, 16)), (1, (18, 15))))
    half, random = np.arange(16)[:, None] * np.ones(16) < 9, np.random.default_rng(0)
    shown = [(left, None)] * 64 + [(right, None)] * 8 + [(left, half)] * 8
    views = [
        ds.View(random.random((*camera.shape, 3)), camera, mask=mask, lit=k, noise=noise)
        for k, (camera, mask) in enumerate(shown)
    ]
    with jax.enable_x64(True):
        problem, samples = shared_problem(views, 80, free, **options)
        chunks, size = problem.chunks(), problem.block_size
        alone = [problem.lay_out([part], size)[0] for part in pieces(samples, size)]
    first, second, *_, last = ([id(leaf) for leaf in jax.tree.leaves(chunk.points)] for chunk in chunks)
    assert (first == second) is shared
    assert not set(first) & set(last)
    assert len(alone) == 80 + 8  # views of the second camera have two blocks
    for k, one in enumerate(alone):
        c, b = divmod(k, len(chunks[0].view))
        block = jax.tree.map(lambda leaf, b=b: np.asarray(leaf)[b], chunks[c])
        jax.tree.map(lambda a, b: np.testing.assert_allclose(a, np.asarray(b)[0], rtol=1e-13), block, one)


def test_what_a_camera_shows_is_found_once_for_all_lights(monkeypatch):
    camera, random, times = ds.Camera(eye=(0, 0, 4), fov=32, shape=(16, 16)), np.random.default_rng(0), []
    views = [ds.View(random.random((16, 16, 3)), camera, lit=k) for k in range(96)]
    of = FeatureModel.seen
    monkeypatch.setattr(FeatureModel, "seen", lambda *given: times.append(len(given[2])) or of(*given))
    with jax.enable_x64(True):
        problem, _ = shared_problem(views, 96, "k_d")
        laid = problem.chunks()
    assert len(laid) > 1
    assert times == [blocks.padded_length(1)]


def test_one_program_serves_a_part_and_the_whole_of_a_large_photograph():
    samples = [Samples(np.ones((1, 1), bool), np.arange(60_000), np.ones((60_000, 1, 3)), SensorRange(), 1.0)]
    part, whole = (blocks.chunks(pieces(samples, blocks.BLOCK, at_most)) for at_most in (PART, None))
    assert {len(chunk) for chunk in part} == {len(chunk) for chunk in whole} == {8}


def test_jax_takes_aligned_arrays_as_they_are():
    given = blocks.aligned_zeros((3, 5, 7))
    assert given.shape == (3, 5, 7)
    assert not given.any()
    with jax.enable_x64(True):
        assert jax.device_put(given, jax.devices("cpu")[0]).unsafe_buffer_pointer() == given.ctypes.data


def test_views_under_the_same_known_lights_share_their_fields():
    camera, random = ds.Camera(eye=(0, 0, 4), fov=32, shape=(16, 16)), np.random.default_rng(0)
    views = [ds.View(random.random((16, 16, 3)), camera, lit=k % 2) for k in range(32)]
    with jax.enable_x64(True):
        problem, _ = shared_problem(views, 2, "k_d")
        first, *others = problem.chunks()
    assert others
    assert all(chunk.points is first.points for chunk in others)


@pytest.mark.parametrize(
    ("of_view", "views", "length"),
    [(1, 12, 4), (1, 96, 16), (2, 24, 8), (5, 7, 5), (5, 12, 5), (5, 24, 15), (40, 3, 20), (3, 5, 3)],
)
def test_chunks_of_views_with_the_same_pixels_have_the_same_pieces(of_view, views, length):
    samples = [Samples(np.ones((1, 1), bool), np.arange(of_view * 10), np.ones((1, 1, 3)), SensorRange(), 1.0)] * views
    found = blocks.chunks(pieces(samples, 10))
    assert {len(chunk) for chunk in found} == {length}
    repeat = [[tuple(part.pixels) for part in chunk if len(part.pixels)] for chunk in found]
    per_view = max(of_view // length, 1)
    assert all(of == repeat[c % per_view] for c, of in enumerate(repeat))
    seen = [(part.view, *part.pixels) for chunk in found for part in chunk if len(part.pixels)]
    assert seen == [(v, *range(10 * b, 10 * b + 10)) for v in range(views) for b in range(of_view)]
    assert blocks.chunks([]) == []


def test_few_sizes_serve_every_count():
    assert [blocks.few_sizes(n) for n in range(14)] == [0, 1, 2, 3, 4, 6, 6, 8, 8, 12, 12, 12, 12, 16]


def test_work_on_all_cores_keeps_the_order_and_float64():
    found = on_all_cores(lambda i: jnp.asarray(i, float) / 3, range(50))
    assert [float(x) for x in found] == [i / 3 for i in range(50)]
    assert all(x.dtype == jnp.float64 for x in found)
    with pytest.raises(ZeroDivisionError):
        on_all_cores(lambda i: 1 // (i - 3), range(5))
