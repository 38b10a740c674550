"""A folder of real photographs, of the DiLiGenT benchmark, read and fitted."""

import numpy as np
from measured import measured

import diffshade as ds


def test_the_ball_has_the_diffuse_colour_that_others_found_and_is_predicted_where_held_out():
    scene, views = ds.read_photographs(measured("diligent_ball"))
    fit = ds.fit(scene, views[::2], free=("k_a", "k_d", "k_s", "n_s"))
    np.testing.assert_allclose(fit.material.k_d, (0.164, 0.138, 0.090), rtol=0.05)
    assert fit.counts.clipped > 300
    n_s = fit.names.index("n_s")
    assert fit.errors[n_s] > 10 * fit.plain_errors[n_s]  # photographs: the residuals are model error, not noise
    held_out = [fit.predict(view).rmse for view in views[1::2]]
    assert np.sqrt(np.mean(np.square(held_out))) < 0.012


def test_the_ball_is_read_as_16_bits_with_lights_that_travel_away_from_where_they_are():
    folder = measured("diligent_ball")
    scene, views = ds.read_photographs(folder)
    assert len(views) == len(scene.lights) == 48
    levels = views[0].image * 65535
    np.testing.assert_allclose(levels, np.rint(levels), atol=1e-6)
    assert np.mean(np.rint(levels) % 257 != 0) > 0.9  # what was cut to 8 bits has only multiples of 257
    first = np.loadtxt(folder / "light_directions.txt")[0]
    assert isinstance(scene.lights[0], ds.DirectionalLight)
    np.testing.assert_allclose(scene.lights[0].direction, -first / np.linalg.norm(first))
    assert views[3].lit == (3,)
