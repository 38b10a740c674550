"""The check of the machine, and what an import does not do."""

import os
import subprocess
import sys
from re import escape

import jax
import numpy as np
import pytest

import diffshade as ds
from diffshade.core import backend


@pytest.fixture
def unchecked():
    """The state of a fresh process."""
    backend.check_backend.cache_clear()
    yield
    backend.check_backend.cache_clear()


def one_channel_for_all(n, y):
    """What jaxlib 0.10.2 returns."""
    return np.broadcast_to(np.sum(n * y[:1], -2), (3, n.shape[-1]))


def test_wrong_sums_are_refused_each_time(unchecked, monkeypatch):
    backend.check_backend()  # right ones pass
    backend.check_backend.cache_clear()
    monkeypatch.setattr(backend, "_sums", one_channel_for_all)
    scene, camera = ds.Scene(ds.Object(ds.Sphere())), ds.Camera((0, 0, 4), shape=(4, 5))
    said = rf"^jaxlib {escape(backend.jaxlib_version)} returns wrong sums on this machine, .*pip install 'jaxlib!="
    for call in (ds.render, ds.render, ds.intersect):
        with pytest.raises(RuntimeError, match=said):
            call(scene, camera)


def test_the_sums_are_checked_once(unchecked, monkeypatch):
    calls = []

    def count(n, y):
        assert n.dtype == y.dtype == np.float32
        calls.append(n.shape)
        return np.sum(n * y, -2)

    monkeypatch.setattr(backend, "_sums", count)
    for _ in range(3):
        ds.render(ds.Scene(ds.Object(ds.Sphere())), ds.Camera((0, 0, 4), shape=(4, 5)))
    assert calls == [(8, 16000)]


def test_the_first_render_may_be_inside_a_callers_jit(unchecked):
    def red(k_d):
        scene = ds.Scene(ds.Object(ds.Sphere(), ds.Material(k_d=k_d)), ds.PointLight((0, 0, 4)))
        return ds.render(scene, ds.Camera((0, 0, 4), shape=(3, 3)))[1, 1, 0]

    value, slope = jax.jit(jax.value_and_grad(red))(0.5)
    np.testing.assert_allclose([value, slope], [0.5, 1.0], rtol=1e-6)


def run(code, **environment):
    command = [sys.executable, "-W", "error", "-c", code]
    return subprocess.run(command, env=os.environ | environment, capture_output=True, text=True, check=False)


def test_the_help_of_the_command_line_loads_neither_numpy_nor_jax():
    code = """
import sys
from diffshade.cli import commands
assert not {"numpy", "jax"} & {*sys.modules}, {"numpy", "jax"} & {*sys.modules}
"""
    done = run(code)
    assert done.returncode == 0, done.stderr


def test_an_import_starts_no_backend_and_loads_nothing_that_it_may_not_need():
    code = """
import sys
import diffshade as ds
ds.fit, ds.read_scene, ds.exchange.read_material
packages = ("imageio", "cv2", "OpenEXR", "matplotlib", "rich", "tomli_w")
for name in (*packages, "scipy.interpolate", "scipy.optimize", "scipy.sparse"):
    assert name not in sys.modules, name
scene = ds.Scene(ds.Object(ds.Sphere(), ds.Material(k_d=0.7)), ds.PointLight((2, 3, 4)))
camera = ds.Camera((0, 0, 4), fov=35, shape=(8, 10))
from jax._src import xla_bridge
assert not xla_bridge.backends_are_initialized()
"""
    # and indeed there need be none to start: any array of JAX's would end in an error
    done = run(code, JAX_PLATFORMS="none_of_that_name")
    assert done.returncode == 0, done.stderr


def test_a_compiler_is_given_only_the_options_that_it_knows():
    assert backend._known(tuple(backend.QUICKLY.items())).items() >= {("xla_backend_optimization_level", 0)}
    with_unknown = {"xla_cpu_no_such_option": 1, "xla_backend_optimization_level": 0}
    assert backend._known(tuple(with_unknown.items())) == {"xla_backend_optimization_level": 0}
    assert backend.jit_quickly(lambda x: x + 1.0, options=with_unknown)(1.0) == 2.0
