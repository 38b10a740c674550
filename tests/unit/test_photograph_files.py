"""Files of one camera: turned alike, what they state said once, clipped colours of other primaries."""

import tracemalloc

import colour_profiles as by
import numpy as np
import pytest

import diffshade as ds
from diffshade.calibration.photographs import gather
from diffshade.inverse.data.photograph_files import photograph_files

ADOBE = by.profile("Adobe-like", by.gamma(by.ADOBE_GAMMA), by.ADOBE_XYZ)
LUT = by.profile("Proof", by.gamma(1), kind=b"RGB Lab ")
TALL, WIDE = np.full((16, 8, 3), 0.5), np.full((8, 16, 3), 0.5)


@pytest.fixture
def files(tmp_path):
    """Write JPEGs, each with options, and return them."""

    def write(*options, image=WIDE):
        paths = [tmp_path / f"{i}.jpg" for i in range(len(options))]
        for path, option in zip(paths, options, strict=True):
            path.write_bytes(by.saved(option.pop("image", image), "JPEG", **option))
        return paths

    return write


def stating(*orientations):
    return [{"exif": by.exif(orientation=of)} if of else {} for of in orientations]


@pytest.mark.parametrize(
    ("stated", "shape", "turned", "said"),
    [
        ((0, 1, 0), None, (1, 1, 1), []),
        ((1, 8, 3, 1, 1), None, (1,) * 5, ["1.jpg and 2.jpg state the EXIF orientation 3 and 8, and the others 1."]),
        ((6, 6, 6, 1), (16, 8), (6,) * 4, ["3.jpg states the EXIF orientation 1, and the others 6.", "turned upright"]),
        ((6, 6), None, (6, 6), ["state the EXIF orientation 6 and are turned upright; mask, normals and lights"]),
        ((6, 6), (8, 16), (1, 1), ["but the mask or camera has the size of what is stored: they are not turned."]),
        ((3, 3), (8, 16), (3, 3), ["state the EXIF orientation 3 and are turned upright"]),
        ((6, 1), None, (1, 1), ["0.jpg states the EXIF orientation 6, and the others 1."]),
        ((6, 1), (16, 8), (6, 6), ["1.jpg states the EXIF orientation 1, and the others 6.", "are turned upright"]),
        ((6, 6, 8), (8, 16), (1,) * 3, ["orientation 6 and 8, but the mask or camera has the size of what is stored"]),
        ((1, *(6,) * 4, *(1,) * 9), None, (1,) * 14, ["4 photographs, such as 1.jpg, state the EXIF orientation 6"]),
    ],
)
def test_one_camera_has_one_orientation(files, stated, shape, turned, said):
    found = photograph_files(files(*stating(*stated)), srgb=None, shape=shape)
    assert found.orientations == turned
    assert len(found.notes) == len(said)
    assert all(part in note for part, note in zip(said, found.notes, strict=True))
    assert {image.shape[:2] for image in found.images()} == {(16, 8) if turned[0] > 4 else (8, 16)}


def test_a_file_that_was_turned_by_hand_is_not_turned_again(files):
    turned = files(*stating(6, 6, 6), {"image": TALL})
    found = photograph_files(turned, srgb=None)
    assert found.orientations == (6, 6, 6, 1)
    assert {image.shape for image in found.images()} == {TALL.shape}


def test_what_is_not_used_is_one_line(files):
    paths = files(*({"icc_profile": LUT} for _ in range(12)))
    (note,) = photograph_files(paths, srgb=None).notes
    assert note == "12 photographs state the colour profile 'Proof'. That is not used: read as sRGB."


@pytest.mark.parametrize("srgb", [True, False])
def test_what_is_requested_wins_and_the_contradiction_is_one_line(files, srgb):
    paths = files(*({"icc_profile": ADOBE} for _ in range(3)))
    found = photograph_files(paths, srgb=srgb)
    name = "sRGB" if srgb else "linear"
    assert found.notes == (f"3 photographs state Adobe-like; read as {name}, as requested.",)
    assert abs(found.read(0).mean() - (ds.srgb_decode(0.5) if srgb else 0.5)) < 0.01


def test_files_that_state_nothing_or_the_usual_say_nothing(files):
    srgb = {"exif": by.exif(space=1, orientation=1)}
    for srgbs in (None, True):
        assert photograph_files(files(srgb, {}, dict(srgb)), srgb=srgbs).notes == ()


def test_those_that_differ_are_named(files):
    (note,) = photograph_files(files({"icc_profile": ADOBE}, {"icc_profile": ADOBE}, {}), srgb=None).notes
    assert note.startswith("2.jpg is read as sRGB, by the type of file, and the others as Adobe-like.")


def test_a_clipped_colour_clips_all_that_depend_on_it(tmp_path):
    image = np.full((4, 4, 3), 0.5)
    image[0] = 0.9, 1.0, 0.8  # green is clipped: red in the primaries of sRGB is not known
    (tmp_path / "a.png").write_bytes(by.png(image, 16, (b"gAMA", (100_000).to_bytes(4, "big")), (b"cHRM", CHRM)))
    read = photograph_files([tmp_path / "a.png"], srgb=None).read(0)
    np.testing.assert_array_equal(read[0], 1.0)
    np.testing.assert_allclose(read[1:], 0.5, atol=1e-4)
    assert ds.read_image(tmp_path / "a.png")[0, 0, 2] < 0.9  # a picture to look at keeps its colours


CHRM = by.chromaticities(0.3127, 0.329, 0.64, 0.33, 0.21, 0.71, 0.15, 0.06)


def test_a_missing_file_is_named(tmp_path):
    assert photograph_files([], srgb=None).notes == ()
    with pytest.raises(FileNotFoundError, match=r"there is no file .*a\.png\. Add it"):
        photograph_files([tmp_path / "a.png"], srgb=None)


@pytest.mark.parametrize(
    ("name", "bits", "channels"), [("a.jpg", 8, 3), ("a.png", 8, 1), ("a.png", 8, 4), ("a.png", 16, 3), ("a.exr", 0, 3)]
)
def test_what_is_held_as_it_is_stored_is_decoded_as_files_are_read(tmp_path, name, bits, channels):
    if name == "a.exr":
        pytest.importorskip("OpenEXR")
    path = tmp_path / name
    image = np.random.default_rng(0).random((9, 7, channels))
    ds.write_image(path, image, bits=16 if bits == 16 else None)
    files = photograph_files([path], srgb=None)
    held = files.hold(0)
    np.testing.assert_array_equal(held[:], ds.read_image(path))
    np.testing.assert_array_equal(held[2:5], ds.read_image(path)[2:5])
    np.testing.assert_array_equal(files.read(0), ds.read_image(path))


def photographs_of_a_mirror_ball(folder, shape):
    """Six photographs of a dark ball in the middle, a light's highlight in each; its circle, and their files."""
    row, column = np.mgrid[: shape[0], : shape[1]]
    y, x, radius = shape[0] // 2, shape[1] // 2, shape[0] // 4
    ball = np.hypot(row - y, column - x) < radius
    for i, turned in enumerate((-3, -1, 1, 3, -2, 2)):
        glint = np.hypot(row - y + radius // 8, column - x - turned * radius // 8) < radius / 12
        ds.write_image(folder / f"{i}.png", np.repeat((ball * 0.1 + 0.8 * glint)[..., None], 3, -1))
    return (x, y, radius), [folder / f"{i}.png" for i in range(6)]


def test_photographs_of_a_mirror_ball_take_the_memory_of_their_files(tmp_path):
    """A byte for each sample; decoded, each photograph would take eight."""
    circle, files = photographs_of_a_mirror_ball(tmp_path, (300, 400))
    sizes = []
    for count in (2, 6):
        tracemalloc.start()
        taken = gather(files[:count], None, None, mirror=True, circle=circle)
        sizes.append(tracemalloc.get_traced_memory()[0])
        tracemalloc.stop()
        assert len(taken.images) == count
    each = (sizes[1] - sizes[0]) / 4
    assert 0.9 < each / (300 * 400 * 3) < 1.2


@pytest.mark.thorough
def test_a_calibration_holds_no_photograph_decoded(tmp_path):
    """One photograph alone takes 24 bytes a pixel when it is decoded, and the rays of its pixels 100."""
    for scale in (1, 8):  # the first for what is imported and compiled
        height, width = 120 * scale, 160 * scale
        circle, files = photographs_of_a_mirror_ball(tmp_path, (height, width))
        if scale > 1:
            tracemalloc.start()
        found = ds.lights.calibrate(files[:3], ball="mirror")
        np.testing.assert_allclose(found.balls[0].radius, circle[2], atol=1.0)
    peak = tracemalloc.get_traced_memory()[1] / (height * width)
    tracemalloc.stop()
    assert peak < 60.0
    assert all(isinstance(view.image, np.ndarray) for view in found.views)  # a fit takes them for no lazy images
