"""A folder of photographs: read whole, and each thing that can be wrong with it said in one sentence."""

import shutil

import numpy as np
import pytest
import scipy.io

import diffshade as ds
from diffshade.inverse.data.light_lists import as_lp, read_lp


@pytest.fixture
def folder(tmp_path):
    """A small folder in the layout of the benchmark: a hemisphere of 12 x 10 pixels under three lights."""
    row, column = np.mgrid[:10, :12]
    x, y = (column - 5.5) / 5, -(row - 4.5) / 5
    inside = x**2 + y**2 < 0.9
    normal = np.where(inside[..., None], np.stack([x, y, np.sqrt(np.maximum(1 - x**2 - y**2, 0))], -1), 0)
    to_light = np.array([[0, 0, 1], [0.6, 0, 0.8], [0, 0.6, 0.8]])
    for i, l in enumerate(to_light):
        ds.write_image(tmp_path / f"{i}.png", 0.5 * np.maximum(normal @ l, 0)[..., None] * np.ones(3), bits=16)
    (tmp_path / "filenames.txt").write_text("0.png\n1.png\n2.png\n")
    np.savetxt(tmp_path / "light_directions.txt", to_light)
    np.savetxt(tmp_path / "light_intensities.txt", np.ones((3, 3)))
    ds.write_image(tmp_path / "mask.png", inside * 1.0)
    np.save(tmp_path / "normal_gt.npy", normal)
    return tmp_path


def test_every_form_of_the_normals_is_read_and_they_may_be_left_out(folder):
    normal = np.load(folder / "normal_gt.npy")
    for use in (
        lambda: None,
        lambda: scipy.io.savemat(folder / "Normal_gt.mat", {"Normal_gt": normal}),
        lambda: np.savetxt(folder / "normal.txt", normal.reshape(-1, 3)),
    ):
        use()
        scene, views = ds.read_photographs(folder)
        surface = scene.objects[0].surface
        assert isinstance(surface, ds.GBuffer)
        np.testing.assert_allclose(surface.normal, normal, atol=1e-15)
        np.testing.assert_array_equal(surface.mask, np.any(normal, -1))
        for name in ("normal_gt.npy", "Normal_gt.mat"):
            (folder / name).unlink(missing_ok=True)
    (folder / "normal.txt").unlink()
    (surface,) = (item.surface for item in ds.read_photographs(folder, normals=False)[0].objects)
    assert isinstance(surface, ds.GBuffer)
    np.testing.assert_array_equal(surface.normal[np.any(normal, -1)], [(0, 0, 1)] * np.any(normal, -1).sum())
    light, camera = scene.lights[1], views[1].camera
    assert isinstance(light, ds.DirectionalLight)
    np.testing.assert_allclose(light.direction, (-0.6, 0, -0.8))
    np.testing.assert_array_equal(light.intensity, (1, 1, 1))
    assert (len(views), views[1].lit, camera.shape, camera.local_viewer) == (3, (1,), (10, 12), False)
    np.testing.assert_allclose(views[1].image[4, 5], 0.5 * max(normal[4, 5] @ (0.6, 0, 0.8), 0), atol=1e-5)


def test_a_photograph_in_npy_is_opened_and_not_read(folder):
    np.save(folder / "1.npy", ds.read_image(folder / "1.png"))
    (folder / "filenames.txt").write_text("0.png\n1.npy\n\n2.png\n")
    np.savetxt(folder / "light_intensities.txt", [0.5, 1, 2], delimiter=",")
    scene, views = ds.read_photographs(folder)
    assert type(views[1].image).__name__ == "LazyImage"
    assert isinstance(views[0].image, np.ndarray)
    intensities = [light.intensity for light in scene.lights if isinstance(light, ds.DirectionalLight)]
    np.testing.assert_array_equal(intensities, np.outer([0.5, 1, 2], np.ones(3)))


def _remove(name):
    return lambda folder: (folder / name).unlink()


def _write(name, text):
    return lambda folder: (folder / name).write_text(text)


BAD = {
    "no folder": (shutil.rmtree, "there is no folder .*Give a folder of photographs"),
    "empty list": (_write("filenames.txt", "\n"), "filenames.txt names no photograph"),
    "a name that leads out": (_write("filenames.txt", "../0.png\n"), r"must name photographs in its own folder; got"),
    "a list that is no text": (lambda folder: (folder / "filenames.txt").write_bytes(b"\0"), "is not a list of .*zero"),
    "no directions": (_remove("light_directions.txt"), "there is no file .*light_directions.txt"),
    "no image": (
        lambda folder: [file.unlink() for file in (*folder.glob("?.png"), folder / "filenames.txt")],
        "holds no photograph",
    ),
    "a distance of 0": (_write("light_distances.txt", "3\n0\ninf\n"), "must hold distances above 0.*got 0.*inf"),
    "too few distances": (_write("light_distances.txt", "3\n"), "one line for each of the 3 photographs; got 1"),
    "several lists": (
        lambda folder: [
            (folder / "filenames.txt").unlink(),
            *((folder / name).write_text("0\n") for name in ("a.lp", "b.lp")),
        ],
        "several lists of lights, a.lp and b.lp",
    ),
    "several masks": (
        lambda folder: [
            (folder / "mask.png").rename(folder / "mask1.png"),
            shutil.copy(folder / "mask1.png", folder / "mask2.png"),
        ],
        "several masks, mask1.png and mask2.png",
    ),
    "no photograph": (_remove("1.png"), "there is no file .*1.png"),
    "photograph of another size": (
        lambda folder: ds.write_image(folder / "1.png", np.zeros((4, 4, 3)), bits=16),
        r"1.png must have the size of the other photographs, \(10, 12\); got \(4, 4\). Crop",
    ),
    "mask of another size": (
        lambda folder: ds.write_image(folder / "mask.png", np.ones((4, 4))),
        r"the mask must have the size of the photographs, \(10, 12\); got \(4, 4\). Crop",
    ),
    "truncated photograph": (
        lambda folder: (folder / "1.png").write_bytes((folder / "1.png").read_bytes()[:-40]),
        r"1.png: it is no PNG, or is empty, truncated or damaged. Make or copy the file again",
    ),
    "too few lights": (
        _write("light_directions.txt", "0 0 1\n1 0 1\n"),
        "light_directions.txt must have one line for each of the 3 photographs; got 2",
    ),
    "too many intensities": (_write("light_intensities.txt", "1 1 1\n" * 4), "light_intensities.txt .*; got 4"),
    "two numbers": (_write("light_directions.txt", "0 0 1\n0 1\n0 0 1\n"), "3 numbers a line; got 2 on line 2"),
    "two numbers everywhere": (_write("light_directions.txt", "0 1\n" * 3), "3 numbers a line; got 2 on line 1"),
    "one and three": (_write("light_intensities.txt", "1\n1 1 1\n1\n"), "1 or 3 numbers a line; got 3 on line 2"),
    "a word": (_write("light_directions.txt", "0 0 1\n0 up 1\n0 0 1\n"), "must hold numbers only: .*'up'"),
    "a light from nowhere": (
        _write("light_directions.txt", "0 0 1\n0 0 0\n0 0 1\n"),
        r"directions towards the lights; got \[0.0, 0.0, 0.0\], which is no direction, on line 2",
    ),
    "no mask": (_remove("mask.png"), r"there is no mask .*mask\.png.* mask= .*--mask"),
    "no normals": (_remove("normal_gt.npy"), "has no normals. Add one of normal_gt.npy, Normal_gt.mat, normal.txt"),
    "normals of another size": (
        lambda folder: np.save(folder / "normal_gt.npy", np.zeros((4, 4, 3))),
        r"normal_gt.npy must have the mask's shape \(10, 12, 3\); got \(4, 4, 3\)",
    ),
    "normals that are none": (_write("normal_gt.npy", "nonsense"), "normal_gt.npy holds no normals"),
    "normals of length 0": (
        lambda folder: np.save(folder / "normal_gt.npy", np.zeros((10, 12, 3))),
        "unit normal .* at every pixel of its mask; at row 0",
    ),
}


@pytest.mark.parametrize("case", BAD)
def test_what_is_wrong_with_a_folder_is_one_sentence_that_names_it(folder, case):
    spoil, message = BAD[case]
    spoil(folder)
    with pytest.raises((OSError, ValueError), match=message) as caught:
        ds.read_photographs(folder)
    assert "\n" not in str(caught.value)


def test_lamps_at_a_distance_have_their_direction_and_intensity_in_the_middle(folder):
    (folder / "light_distances.txt").write_text("4\ninf\n2\n")
    scene, views = ds.read_photographs(folder, normals=False)
    one, far, other = scene.lights
    assert isinstance(one, ds.PointLight)
    assert isinstance(far, ds.DirectionalLight)
    assert isinstance(other, ds.PointLight)
    height = 2.2
    np.testing.assert_allclose(other.position, np.array([0, 0.6, 0.8]) * 2 * height)
    assert float(other.attenuation(np.array(2 * height))) == pytest.approx(1.0)
    buffer = ds.intersect(scene, views[0].camera)
    position = np.asarray(buffer.position)
    np.testing.assert_allclose(position[np.asarray(buffer.mask)][:, 2], 0.0)
    np.testing.assert_allclose(position[4:6, 5:7].mean((0, 1)), 0.0, atol=1e-6)


LIST = "3\nC:\\shots\\0.jpg 0 0 1\nimages/1.JPG 0.6 0 0.8\n2.png 0 0.6 0.8\n"


def test_a_list_of_lights_names_the_photographs_and_the_directions(folder, caplog):
    for name in ("filenames.txt", "light_directions.txt", "light_intensities.txt"):
        (folder / name).unlink()
    (folder / "dome.lp").write_text(LIST)
    shutil.copy(folder / "0.png", folder / "ref.png")
    scene, views = ds.read_photographs(folder)
    assert len(views) == 3
    light = scene.lights[1]
    assert isinstance(light, ds.DirectionalLight)
    np.testing.assert_allclose(light.direction, (-0.6, 0, -0.8))
    assert "ref.png is left out: not in dome.lp" in caplog.text
    assert "no light_intensities.txt: all lights are taken to have the intensity 1" in caplog.text
    _, names, directions, _ = read_lp(folder / "dome.lp")
    assert names == ("0.jpg", "1.JPG", "2.png")
    (folder / "again.lp").write_text("\n".join(as_lp(names, directions)))
    np.testing.assert_allclose(read_lp(folder / "again.lp").directions, directions, atol=1e-9)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "must begin with the count"),
        ("lights\n", "must have a name and three numbers a line; got 'lights' on line 1"),
        ("4\n" + LIST.split("\n", 1)[1], "must have 4 lines after its first, as that says; got 3"),
        (LIST.replace("0.6 0 0.8", "0 nan 0.8"), r"directions towards the lights; got \[0.0, nan, 0.8\].* on line 3"),
        (LIST.replace("0.6 0 0.8", "x 0 8"), "three numbers a line; got .* on line 3"),
        (LIST.replace("2.png", "other/0.tif"), "names '0.png' twice"),
        ("0\n", "must begin with the count"),
    ],
)
def test_what_is_wrong_with_a_list_of_lights_is_one_sentence(folder, text, said):
    (folder / "filenames.txt").unlink()
    (folder / "dome.lp").write_text(text)
    with pytest.raises(ValueError, match=said):
        ds.read_photographs(folder)


def test_photographs_are_found_in_natural_order_without_the_reference(folder, caplog):
    (folder / "filenames.txt").unlink()
    for i, name in enumerate(("shot2.png", "shot10.png", "shot1.png")):
        (folder / f"{i}.png").rename(folder / name)
    shutil.copy(folder / "shot1.png", folder / "ref.png")
    (folder / "mask.png").rename(folder / "the mask.png")
    _, views = ds.read_photographs(folder)
    first, second = (ds.read_image(folder / f"shot{i}.png") for i in (1, 2))
    np.testing.assert_array_equal(views[0].image, first)
    np.testing.assert_array_equal(views[1].image, second)
    assert "ref.png is left out: the others are named as shot1.png" in caplog.text


def test_names_and_a_list_of_lights_go_together(folder):
    (folder / "light_directions.txt").unlink()
    (folder / "dome.lp").write_text(LIST)
    (folder / "filenames.txt").write_text("2.png\n0.png\n")
    np.savetxt(folder / "light_intensities.txt", np.ones((2, 3)))
    scene, views = ds.read_photographs(folder)
    assert len(views) == 2
    light = scene.lights[0]
    assert isinstance(light, ds.DirectionalLight)
    np.testing.assert_allclose(light.direction, (0.0, -0.6, -0.8))
