"""Fits of all lights' directions beside the same fits with dense matrices, and by tiles and over devices."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import diffshade as ds
from diffshade.diagnosis import sensitivity as sensitivities
from diffshade.inverse import problem
from diffshade.inverse.forward import rendered
from tests.support.textured import lights_about

FREE = ("k_d", "k_s", "n_s", "direction")
SHOTS = [ds.Shot(light=ds.DirectionalLight((0.2, -0.5, -1.0))), ds.Shot(exposure=0.5)]
COUNT = 10
ROOT = Path(__file__).parents[2]
ON_EIGHT = """
import sys
import jax, numpy as np
from tests.studies.test_freed_lights_everywhere import fitted
assert len(jax.devices()) == 8
fit = fitted(96, devices=jax.make_mesh((4, 2), ("a", "b")))
np.savez(sys.argv[1], **{name: getattr(fit, name) for name in ("values", "plain_errors", "errors")})
"""


def given(size: int) -> tuple[ds.Scene, list[ds.View]]:
    """A ball under lights stated 2 degrees off."""
    random, towards = np.random.default_rng(0), lights_about(COUNT)
    camera = ds.OrthographicCamera((0.0, 0.0, 4.0), shape=(size, size), height=2.2, local_viewer=False)
    ball = ds.Object(ds.Sphere(), ds.Material(k_a=0.0, k_d=(0.5, 0.4, 0.3), k_s=0.3, n_s=20.0))
    true = ds.Scene(ball, [ds.DirectionalLight(-l) for l in towards])
    images = [np.asarray(ds.render(true, camera, lit=i)) for i in range(COUNT)]
    views = [ds.View(i + 0.02 * random.standard_normal(i.shape), camera, lit=k) for k, i in enumerate(images)]
    stated = towards + np.deg2rad(2.0) * random.standard_normal(towards.shape)
    return ds.Scene(ball, [ds.DirectionalLight(-l) for l in stated]), views


def fitted(size: int = 32, **options: Any) -> ds.Fit:
    return ds.fit(*given(size), free=FREE, light_error=2.0, **options)


def same(one: Any, other: Any, rtol: float) -> None:
    one, other = np.asarray(one), np.asarray(other)
    np.testing.assert_allclose(one, other, rtol=rtol, atol=rtol * np.abs(other).max())


@pytest.fixture(scope="module")
def by_blocks() -> ds.Fit:
    return fitted()


@pytest.fixture(scope="module")
def dense(by_blocks):
    """The same fit, and derivatives of the one by blocks, where each view may show all unknowns: one dense matrix."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(problem, "arrow_of", lambda *_: None)
        patch.setattr(rendered, "shown_unknowns", lambda *_: None)
        patch.setattr(sensitivities, "shown_unknowns", lambda *_: None)
        fit = fitted()
        found = {
            "intensity": ds.sensitivity(by_blocks, "intensity"),
            "image": ds.image_sensitivity(by_blocks, 3),
            "plan": ds.plan(fit, SHOTS),
            "examine": ds.examine(fit),
        }
    return fit, found  # what is compared with them is found without the patches


def test_values_and_errors_are_those_of_dense_matrices(by_blocks, dense):
    whole = dense[0]
    assert by_blocks.evidence.clusters.hessian.shape[-1] < len(by_blocks.values)
    assert whole.evidence.clusters.hessian.shape[-1] == len(whole.values)
    for name in ("values", "plain_errors", "errors"):
        same(getattr(by_blocks, name), getattr(whole, name), 1e-9)
    same(by_blocks.evidence.clustered_errors(), whole.evidence.clustered_errors(), 1e-9)
    assert by_blocks.notes == whole.notes


def test_sensitivities_are_those_of_dense_matrices(by_blocks, dense):
    same(ds.sensitivity(by_blocks, "intensity"), dense[1]["intensity"], 1e-9)
    same(ds.image_sensitivity(by_blocks, 3), dense[1]["image"], 1e-9)


def test_plans_and_intervals_are_those_of_dense_matrices(by_blocks, dense):
    assert str(ds.plan(by_blocks, SHOTS)) == str(dense[1]["plan"])
    found, whole = ds.examine(by_blocks), dense[1]["examine"]
    same(found.interval_95, whole.interval_95, 1e-6)
    assert found.notes == whole.notes


def test_on_eight_devices_the_fit_is_that_on_one(tmp_path):
    flags = {"XLA_FLAGS": "--xla_force_host_platform_device_count=8", "PYTHONPATH": f"{ROOT}", "JAX_ENABLE_X64": "1"}
    command = [sys.executable, "-W", "error", "-c", ON_EIGHT, tmp_path / "out.npz"]
    done = subprocess.run(command, env={**os.environ, **flags}, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    in_memory = fitted(96)
    with np.load(tmp_path / "out.npz") as file:
        for name, rtol in (("values", 1e-9), ("plain_errors", 1e-9), ("errors", 1e-7)):
            same(file[name], getattr(in_memory, name), rtol)
