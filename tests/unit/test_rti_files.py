"""Relightable images: files of PTM and HSH as others write them, and folders that viewers show."""

import struct

import handmade_maps
import numpy as np
import pytest
import rti_viewers
from handmade_maps import bumpy

import diffshade as ds
from diffshade.io.rti_files import terms

TOWARD = ((0.0, 0.0, 1.0), (0.3, -0.2, 0.9), (-0.5, 0.6, 0.6))
SCALE, BIAS = np.array([0.5, 1.0, 2.0, 0.25, 1.5, 2.0]), np.array([120, 130, 128, 100, 140, 10])


def polynomial(l):
    x, y = (np.array(l) / np.linalg.norm(l))[:2]
    return np.array([x * x, y * y, x * y, x, y, 1.0])


def ptm(kind, body, *, version="PTM_1.2", size="3\n2"):
    """A PTM of 3 x 2 pixels: a header as HP's fitter writes it, and bytes."""
    scale, bias = (" ".join(f"{x:g}" for x in of) for of in (SCALE, BIAS))
    return f"{version}\nPTM_FORMAT_{kind}\n{size}\n{scale} \n{bias} \n".encode() + body


def stored(*shape):
    return np.random.default_rng(3).integers(0, 256, shape).astype(np.uint8)


@pytest.mark.parametrize("version", ["PTM_1.1", "PTM_1.2"])
def test_an_lrgb_ptm_is_brightness_times_colour(tmp_path, version):
    six, rgb = stored(2, 3, 6), stored(2, 3, 3)
    body = np.concatenate([six, rgb], -1).tobytes() if version == "PTM_1.1" else six.tobytes() + rgb.tobytes()
    (tmp_path / "a.ptm").write_bytes(ptm("LRGB", body, version=version))
    image = ds.exchange.read_rti(tmp_path / "a.ptm")
    assert image.shape == (2, 3)
    for l in TOWARD:
        bright = (SCALE * (six.astype(float) - BIAS)) @ polynomial(l) / 255.0
        expected = np.maximum(bright[..., None] * rgb / 255.0, 0.0)[::-1]  # the bottom row is first
        np.testing.assert_allclose(image.shade(l), expected, atol=1e-5)


def test_an_rgb_ptm_has_a_polynomial_for_each_channel(tmp_path):
    of = stored(3, 2, 3, 6)
    (tmp_path / "a.ptm").write_bytes(ptm("RGB", of.tobytes()))
    image = ds.exchange.read_rti(tmp_path / "a.ptm")
    for l in TOWARD:
        expected = np.moveaxis((SCALE * (of.astype(float) - BIAS)) @ polynomial(l) / 255.0, 0, -1)
        np.testing.assert_allclose(image.shade(l), np.maximum(expected, 0.0)[::-1], atol=1e-5)
    assert "no highlight sharper than its basis" in f"{image}"


def harmonics(order, l):
    """The terms but for signs, from associated Legendre polynomials of 2 cos(theta) - 1 (Gautron et al. 2004)."""
    from scipy.special import factorial, lpmv

    x, y, z = np.array(l) / np.linalg.norm(l)
    phi, found = np.arctan2(y, x), []
    for n in range(order):
        for m in range(-n, n + 1):
            k = np.sqrt((2 * n + 1) * factorial(n - abs(m)) / (2 * np.pi * factorial(n + abs(m))))
            turn = np.sqrt(2) * np.cos(m * phi) if m > 0 else np.sqrt(2) * np.sin(-m * phi) if m < 0 else 1.0
            found.append(k * turn * lpmv(abs(m), n, 2 * z - 1))
    return np.array(found)


@pytest.mark.parametrize("order", [2, 3, 4])
def test_the_basis_is_hemispherical_harmonics(order):
    for l in TOWARD:
        ours, theirs = np.abs(terms("hsh", order**2, l)), np.abs(harmonics(order, l))
        np.testing.assert_allclose(np.sort(ours), np.sort(theirs), atol=1e-9)


@pytest.mark.parametrize("universal", [False, True])
def test_hsh_of_both_forms(tmp_path, universal):
    of = stored(2, 3, 3, 9)
    first, second = np.linspace(0.1, 0.9, 9).astype("<f4"), np.linspace(-0.4, 0.4, 9).astype("<f4")
    if universal:
        data = b"#HSH1.2\n3\n3 2 3\n9 2 1\n"
        coefficients = of / 255.0 * first + second
    else:
        data = b"# a comment\n" + struct.pack("<4i", 3, 2, 3, 3)
        coefficients = first + (second - first) * (of / 255.0)
    (tmp_path / "a.rti").write_bytes(data + first.tobytes() + second.tobytes() + of.tobytes())
    image = ds.exchange.read_rti(tmp_path / "a.rti")
    assert image.basis == "hsh"
    np.testing.assert_allclose(image.coefficients, coefficients, atol=1e-6)
    flat = np.maximum(
        coefficients @ [1 / np.sqrt(2 * np.pi), 0, np.sqrt(1.5 / np.pi), 0, 0, 0, np.sqrt(2.5 / np.pi), 0, 0], 0
    )
    np.testing.assert_allclose(image.shade((0, 0, 2)), flat, atol=1e-5)


BAD = {
    "short.ptm": (ptm("LRGB", b"x" * 53), "3 x 2 pixels need 54 bytes, and it has 53"),
    "jpeg.ptm": (ptm("JPEG_LRGB", b""), "has the format 'PTM_FORMAT_JPEG_LRGB'"),
    "version.ptm": (ptm("LRGB", b"", version="PTM_2"), "begins with 'PTM_2'"),
    "size.ptm": (ptm("LRGB", b"", size="-3\n2"), "its size is -3 x 2"),
    "huge.ptm": (ptm("LRGB", b"", size="99999\n99999"), "pixels need"),
    "word.ptm": (ptm("LRGB", b"", size="3\nx"), "its size, scale and bias must be 14 numbers"),
    "empty.rti": (b"", "its header ends early"),
    "order.rti": (b"#\n" + struct.pack("<4i", 1, 1, 3, 7) + bytes(999), "49 terms"),
    "nan.rti": (struct.pack("<4i", 1, 1, 3, 2) + b"\xff" * 32 + bytes(12), "are not finite"),
    "ptm.rti": (b"#PTM1.2\n1\n3 2 3\n6 2 1\n", "no HSH of RGB"),
    "a.png": (b"", "is not the suffix of a relightable image"),
}


@pytest.mark.parametrize("name", BAD)
def test_what_is_damaged_is_one_sentence(tmp_path, name):
    data, words = BAD[name]
    (tmp_path / name).write_bytes(data)
    with pytest.raises(ValueError, match=words) as caught:
        ds.exchange.read_rti(tmp_path / name)
    assert "\n" not in str(caught.value)


def test_a_light_behind_the_image_is_refused(tmp_path):
    (tmp_path / "a.ptm").write_bytes(ptm("LRGB", bytes(54)))
    image = ds.exchange.read_rti(tmp_path / "a.ptm")
    with pytest.raises(ValueError, match=r"toward must be three finite numbers with z above 0.* Give for example"):
        image.shade((0, 1, -1))
    with pytest.raises(ValueError, match=r"mask must have the shape of the image, \(2, 3\); got \(3, 2\)"):
        ds.exchange.photographs_of(image, mask=np.ones((3, 2), bool))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Maps without a sharp highlight, and the folders that viewers show."""
    maps, _ = bumpy(32)
    folder = tmp_path_factory.mktemp("rti")
    return maps, {basis: ds.exchange.write_rti(folder / basis, maps, basis=basis) for basis in ("hsh", "ptm")}


@pytest.mark.parametrize("viewer", ["OpenLIME", "Relight"])
@pytest.mark.parametrize("basis", ["hsh", "ptm"])
def test_viewers_show_the_maps(folder, basis, viewer):
    maps, written = folder
    assert_shown(maps, written[basis], viewer)
    assert written[basis].rms < (0.12 if basis == "ptm" else 0.1)


@pytest.mark.thorough
@pytest.mark.parametrize("basis", ["hsh", "ptm"])
@pytest.mark.parametrize("name", handmade_maps.JUDGED)
def test_viewers_show_objects_that_no_setting_was_chosen_on(name, basis, tmp_path):
    maps, _, _ = handmade_maps.judged(name, 64)
    written = ds.exchange.write_rti(tmp_path / "viewer", maps, basis=basis)
    for viewer in rti_viewers.LOWEST:
        assert_shown(maps, written, viewer, turned=False)


def assert_shown(maps, written, viewer, *, turned=True):
    """By the viewers' own formulas, from the files: the right way up, in their colours, as well as is stated.

    `turned`: a flip of the picture, or of the light, is seen; of an object with symmetries it is not.
    """
    place, inside = written.paths[-1].parent, maps.status > 0
    off = []
    for light in ((0.3, 0.2), (-0.5, 0.1), (0.2, -0.6)):
        l = np.array((*light, np.sqrt(1 - np.hypot(*light) ** 2)))
        drawn = np.asarray(ds.srgb_encode(np.clip(maps.shade(ds.DirectionalLight(-l)), 0, 1)))
        seen = rti_viewers.shown(place, light, viewer)
        off.append(np.sqrt(np.mean((seen - drawn)[inside] ** 2)))
        for other in (drawn[::-1], drawn[:, ::-1]) if turned else ():
            assert np.sqrt(np.mean((seen - other)[inside & inside[::-1] & inside[:, ::-1]] ** 2)) > 1.2 * off[-1]
    print(f"{np.mean(off):.4f} rms where {written.rms:.4f} is stated")
    assert np.mean(off) < 1.2 * written.rms + 0.005


@pytest.mark.parametrize("basis", ["hsh", "ptm"])
def test_a_light_at_the_rim_of_the_viewers_disc_shows_a_picture(folder, basis):
    """Lights lower than those of the fit are extrapolated by a PTM, and by HSH only to where the viewer stops."""
    maps, written = folder
    seen = rti_viewers.shown(written[basis].paths[-1].parent, (3.0, -4.0), "OpenLIME")[maps.status > 0]
    assert 0.02 < seen.mean() < 0.9


def shown_by_rtiviewer(path, light):
    """The picture of a PTM by the format's document and RTIViewer's reading: six lines, then colour after colour."""
    *head, body = path.read_bytes().split(b"\n", 6)
    assert head[:2] == [b"PTM_1.2", b"PTM_FORMAT_RGB"]
    columns, rows = int(head[2]), int(head[3])
    scale, bias = np.array(head[4].split(), float), np.array([int(b) for b in head[5].split()])
    assert (len(scale), len(bias)) == (6, 6)
    assert ((bias >= 0) & (bias <= 255)).all()
    of = np.frombuffer(body, np.uint8).reshape(3, rows, columns, 6)[:, ::-1]
    u, v = light
    return np.clip(((of - bias) * scale) @ [u * u, v * v, u * v, u, v, 1.0] / 255.0, 0, 1).transpose(1, 2, 0)


def test_a_ptm_of_maps_comes_back(folder, tmp_path):
    """By RTIViewer's formula and by this library's reader: the right way up, in their colours, as well as is stated."""
    maps, written = folder
    exported = ds.exchange.write_rti(tmp_path / "bumpy.ptm", maps)
    assert exported.paths == (tmp_path / "bumpy.ptm",)
    image, inside, off = ds.exchange.read_rti(exported.paths[0]), maps.status > 0, []
    for light in ((0.3, 0.2), (-0.5, 0.1), (0.2, -0.6)):
        l = np.array((*light, np.sqrt(1 - np.hypot(*light) ** 2)))
        seen = shown_by_rtiviewer(exported.paths[0], light)
        np.testing.assert_allclose(seen, np.clip(image.shade(l), 0, 1), atol=1e-5)
        drawn = np.asarray(ds.srgb_encode(np.clip(maps.shade(ds.DirectionalLight(-l)), 0, 1)))
        off.append(np.sqrt(np.mean((seen - drawn)[inside] ** 2)))
        for turned in (drawn[::-1], drawn[:, ::-1], drawn[..., ::-1]):
            assert np.sqrt(np.mean((seen - turned)[inside & inside[::-1] & inside[:, ::-1]] ** 2)) > 1.2 * off[-1]
    assert np.mean(off) < 1.2 * exported.rms + 0.005
    assert exported.rms < 1.05 * written["ptm"].rms  # bytes are no worse than JPEG
    assert f"{tmp_path / 'bumpy.ptm'}: under 7 other lights" in str(exported)
    with pytest.raises(ValueError, match=r"bumpy.ptm is a PTM, whose basis is ptm; got 'hsh'. Leave basis out"):
        ds.exchange.write_rti(tmp_path / "bumpy.ptm", maps, basis="hsh")


@pytest.mark.thorough
def test_a_fit_starts_from_a_relightable_image(tmp_path, caplog):
    """Pictures of a matte ball, which a polynomial nearly holds: the normals come back to a few degrees."""
    size = 12
    camera = ds.OrthographicCamera((0, 0, 1), height=2.4, shape=(size, size), local_viewer=False)
    surface = ds.intersect(ds.Scene(ds.Object(ds.Sphere())), camera)
    normal, mask = np.asarray(surface.normal, float), np.asarray(surface.mask)
    mask = mask & (normal[..., 2] > 0.7)
    flat = np.zeros((size, size, 6))
    flat[..., 3:5], flat[..., 5] = (
        0.5 * normal[..., :2],
        0.45 * normal[..., 2],
    )  # k_d n.l with z nearly 1 - (x^2 + y^2)/2
    flat[..., :2] = -0.22 * normal[..., 2:]
    image = ds.exchange.RelightableImage("ptm", np.repeat(flat[:, :, None], 3, 2))
    scene, views = ds.exchange.photographs_of(image, mask=mask, srgb=False)
    assert len(views) == 24
    assert "n_s too small" in caplog.text
    maps = ds.fit_texels(scene, views, free=("k_d", "normal"), loss="squares")
    off = np.rad2deg(np.arccos(np.clip((maps.values["normal"] * normal).sum(-1), -1, 1)))[mask & maps.known]
    assert off.size > 0.5 * mask.sum()
    assert np.median(off) < 4.0
