"""RAW files of cameras: linear, black taken off, no white balance; named in one sentence where rawpy is missing."""

import sys

import numpy as np
import pytest

import diffshade as ds

pytest.importorskip("rawpy", reason="RAW files are read with the extra 'raw'.")
pytest.importorskip("tifffile", reason="the RAW files of these tests are made with tifffile, of the extra 'zarr'.")
from image_files import turned
from raw_files import BLACK, LEAST, WHITE, write_dng

from diffshade.io.encodings import LINEAR
from diffshade.io.exif import stated_exposures
from diffshade.io.image_statements import statement_of
from diffshade.io.images import read_as

STEP = 1.0 / (WHITE - BLACK)


def test_a_raw_file_is_linear_without_black_white_balance_or_brightening(tmp_path):
    for k in (1, 2):  # twice the light is twice as bright, whatever the brightest pixel
        image = ds.read_image(write_dng(tmp_path / "a.dng", (300 * k, 900 * k, 600 * k)))
        assert image.shape == (LEAST, LEAST, 3)
        np.testing.assert_allclose(image, np.broadcast_to(np.array([300, 900, 600]) * k * STEP, image.shape), atol=4e-5)
    full = ds.read_image(write_dng(tmp_path / "b.dng", (WHITE - BLACK, 900, 2 * WHITE)))
    np.testing.assert_array_equal(full[..., [0, 2]], 1.0)  # clipped, as `View` knows by the largest sample
    assert read_as(tmp_path / "b.dng")[:2] == ("RAW", LINEAR)


def test_a_raw_file_states_its_exposure(tmp_path):
    files = [write_dng(tmp_path / f"{i}.dng", (1, 1, 1), exposure=of) for i, of in enumerate([(50, 4), (100, 8), None])]
    np.testing.assert_allclose(stated_exposures(files), [1 / 50 / 16, 1 / 100 / 64, np.nan], rtol=1e-6)


@pytest.mark.parametrize("orientation", range(1, 9))
def test_a_raw_file_is_turned_as_it_states(tmp_path, orientation):
    stored = ds.read_image(write_dng(tmp_path / "a.dng", (900, 900, 900), width=30))
    upright = ds.read_image(write_dng(tmp_path / "b.dng", (900, 900, 900), width=30, orientation=orientation))
    np.testing.assert_array_equal(turned(upright, orientation), stored)
    assert statement_of(tmp_path / "b.dng")[2:] == (orientation, (LEAST, 30))


def test_of_a_raw_file_and_a_jpeg_the_raw_file_is_read(tmp_path, caplog):
    for i in range(3):
        write_dng(tmp_path / f"{i}.dng", (300 * (i + 1), 300 * (i + 1), 300 * (i + 1)))
        ds.write_image(tmp_path / f"{i}.jpg", np.zeros((LEAST, LEAST, 3)))
    np.savetxt(tmp_path / "light_directions.txt", [[0, 0, 1]] * 3)
    ds.write_image(tmp_path / "mask.png", np.ones((LEAST, LEAST)))
    _, views = ds.read_photographs(tmp_path, normals=False)
    assert [round(view.image.mean() / STEP) for view in views] == [300, 600, 900]
    assert "0.jpg, 1.jpg and 2.jpg are left out: the RAW file of the same name is read" in caplog.text


def test_a_damaged_raw_file_is_one_sentence(tmp_path):
    whole = write_dng(tmp_path / "a.dng", (1, 2, 3)).read_bytes()
    for size in (0, 10, 300, len(whole) - 400, len(whole) - 10):
        (tmp_path / "a.dng").write_bytes(whole[:size])
        with pytest.raises(OSError, match=r"a.dng: it is no RAW, or is empty, truncated or damaged"):
            ds.read_image(tmp_path / "a.dng")


def test_without_rawpy_a_raw_file_is_refused_with_the_remedy(tmp_path, monkeypatch):
    file = write_dng(tmp_path / "a.dng", (1, 2, 3))
    monkeypatch.setitem(sys.modules, "rawpy", None)
    with pytest.raises(
        ImportError, match=r"a.dng without the package rawpy. Install it: pip install 'diffshade\[raw\]'"
    ):
        ds.read_image(file)


def test_raw_files_are_not_written(tmp_path):
    with pytest.raises(ValueError, match=r"a.dng: RAW is only read. Write .png"):
        ds.write_image(tmp_path / "a.dng", np.zeros((4, 4)))
