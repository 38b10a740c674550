"""Fresnel's W at values that can be worked out by hand, and its bounds (E7)."""

import jax
import numpy as np
import pytest

import diffshade as ds
from diffshade.model.vectors import Vec3


@jax.jit
def weight(fresnel, k_s, eta, cos):
    return fresnel.weight(Vec3.of(k_s), eta, cos).stack()


def dielectric(eta, cos):
    """W of each of several angles, which is grey."""
    cos = np.atleast_1d(np.asarray(cos, float))
    W = np.asarray(weight(ds.Dielectric(), np.zeros((len(cos), 3)), np.array(float(eta)), cos))
    np.testing.assert_array_equal(W, W[:, :1].repeat(3, 1))
    return W[:, 0]


K_S = np.array([[0.04, 0.5, 1.0]])
ETAS = [0.1, 0.5, 0.75, 1.0, 1.33, 1.5, 2.5, 10.0]


@pytest.mark.parametrize("eta", ETAS)
def test_head_on(eta):
    np.testing.assert_allclose(dielectric(eta, 1), [((eta - 1) / (eta + 1)) ** 2], rtol=1e-13, atol=1e-16)


@pytest.mark.parametrize("eta", [0.5, 0.75, 1.33, 1.5, 2.5])
def test_at_brewsters_angle_light_of_one_polarisation_is_not_reflected(eta):
    """tan theta = eta; what is left is half of r_s^2, with r_s = (1 - eta^2)/(1 + eta^2)."""
    cos = 1 / np.sqrt(1 + eta**2)
    np.testing.assert_allclose(dielectric(eta, cos), [0.5 * ((1 - eta**2) / (1 + eta**2)) ** 2], rtol=1e-12)


@pytest.mark.parametrize("eta", ETAS)
def test_the_energy_is_bounded_and_all_of_it_comes_back_at_grazing_light(eta):
    W = dielectric(eta, np.linspace(0, 1, 2001))
    assert (W >= 0).all()
    assert (W <= 1).all()
    if eta != 1:
        assert W[0] == 1


def test_the_same_index_reflects_nothing():
    np.testing.assert_allclose(dielectric(1.0, np.linspace(0.01, 1, 100)), 0, atol=1e-30)


def test_total_reflection_begins_at_the_critical_angle():
    """sin theta = eta."""
    cos = np.cos(np.arcsin(0.6))
    np.testing.assert_array_equal(dielectric(0.6, [cos - 1e-6, cos / 2, 0]), [1, 1, 1])
    assert (dielectric(0.6, [cos + 1e-6, cos + 0.1]) < 0.999).all()


def test_light_goes_both_ways_alike():
    """W(theta) from air is W(theta') from inside, where sin theta = eta sin theta' (Stokes)."""
    theta = np.linspace(0.05, 1.5, 30)
    inside = np.arcsin(np.sin(theta) / 1.5)
    np.testing.assert_allclose(dielectric(1.5, np.cos(theta)), dielectric(1 / 1.5, np.cos(inside)), rtol=1e-11)


def test_schlick():
    """k_s head on, 1 at grazing light, and a 32nd of the rest at 60 degrees."""
    cos, k_s = np.array([1.0, 0.5, 0.0]), np.repeat(K_S, 3, 0)
    W = weight(ds.Schlick(), k_s, np.array(1.0), cos)
    np.testing.assert_allclose(W, [K_S[0], K_S[0] + (1 - K_S[0]) / 32, (1, 1, 1)], rtol=1e-14)


def test_schlicks_energy_is_bounded():
    cos = np.linspace(0, 1, 1001)
    W = np.asarray(weight(ds.Schlick(), np.repeat(K_S, len(cos), 0), np.array(1.0), cos))
    assert (W >= K_S - 1e-15).all()
    assert (W <= 1).all()
    assert (np.diff(W, axis=0) <= 1e-15).all()  # it falls with the cosine


def test_schlick_is_near_the_dielectric():
    """For glass, to 0.02 up to 60 degrees and 0.05 anywhere, which is why it is used."""
    cos = np.linspace(0, 1, 501)
    schlick = np.asarray(weight(ds.Schlick(), np.full((501, 3), 0.04), np.array(1.0), cos))[:, 0]
    difference = np.abs(schlick - dielectric(1.5, cos))
    assert difference[cos > 0.5].max() < 0.02
    assert 0.001 < difference.max() < 0.05


def test_without_fresnel_it_is_k_s():
    cos = np.linspace(0, 1, 3)
    np.testing.assert_array_equal(weight(ds.NoFresnel(), np.repeat(K_S, 3, 0), np.array(1.0), cos), K_S.repeat(3, 0))
