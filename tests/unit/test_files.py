"""A file is written whole or not at all, and where that cannot be it is said before anything is done."""

import errno
import os
import shutil
from pathlib import Path

import numpy as np
import pytest

from diffshade.io.files import replacing, reserve


@pytest.mark.parametrize("name", ["image.png", "IMAGE.PNG", "archive.tar.gz", "no_suffix", "täst ü.tif"])
def test_the_whole_file_takes_the_place_of_the_old_one(tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    (tmp_path / name).write_text("old")
    for target in (tmp_path / name, name):
        with replacing(target) as temporary:
            assert temporary.parent == Path(os.path.realpath(tmp_path))
            assert temporary.suffix == Path(name).suffix
            assert not temporary.exists()
            temporary.write_text(f"new {target}")
        assert (tmp_path / name).read_text() == f"new {target}"
    assert os.listdir(tmp_path) == [name]


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt, SystemExit])
@pytest.mark.parametrize("before", [None, "old"])
def test_an_error_leaves_the_old_file_and_nothing_else(tmp_path, error, before):
    target = tmp_path / "scene.toml"
    if before is not None:
        target.write_text(before)
    for written in ("half", None):

        def write(written=written):
            with replacing(target) as temporary:
                if written:
                    temporary.write_text(written)
                raise error

        with pytest.raises(error):
            write()
        assert os.listdir(tmp_path) == ([] if before is None else ["scene.toml"])
        assert before is None or target.read_text() == before


def test_where_nothing_can_be_written_the_block_is_not_entered(tmp_path, monkeypatch):
    for target, error, message in (
        (tmp_path / "results" / "a.txt", FileNotFoundError, r"there is no folder .*results\. Create it first\.$"),
        (tmp_path, IsADirectoryError, r"it is a folder\. Give the name of a file\.$"),
        (tmp_path / "a.txt", PermissionError, r"is not writable\. Choose another one\.$"),
    ):
        if error is PermissionError:
            monkeypatch.setattr(os, "access", lambda *_: False)  # the tests may run as root, whom no mode stops
        with pytest.raises(error, match=rf"^cannot write {target}: .*{message}"), replacing(target):
            pytest.fail("entered")


def test_a_link_stays_a_link_and_has_its_own_suffix(tmp_path):
    (tmp_path / "real").mkdir()
    (tmp_path / "link.png").symlink_to(tmp_path / "real" / "a.txt")
    with replacing(tmp_path / "link.png") as temporary:
        assert (temporary.parent, temporary.suffix) == (Path(os.path.realpath(tmp_path / "real")), ".png")
        temporary.write_text("new")
    assert (tmp_path / "link.png").is_symlink()
    assert (tmp_path / "real" / "a.txt").read_text() == "new"


@pytest.mark.skipif(os.name != "posix", reason="modes are POSIX's")
def test_the_mode_is_that_of_any_new_file(tmp_path):
    (tmp_path / "plain").write_text("")
    with replacing(tmp_path / "a.txt") as temporary:
        temporary.write_text("")
    assert (tmp_path / "a.txt").stat().st_mode == (tmp_path / "plain").stat().st_mode


@pytest.mark.parametrize(
    "raised", [OSError(errno.ENOSPC, "No space left on device", ".x.npy"), OSError("9 requested and 1 written")]
)
def test_a_full_disk_is_named_with_its_file_which_stays_as_it_was(tmp_path, monkeypatch, raised):
    (tmp_path / "maps.npy").write_text("old")
    usage = shutil.disk_usage(tmp_path)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: usage._replace(free=0))

    def write():
        with replacing(tmp_path / "maps.npy") as temporary:
            temporary.write_text("half")
            raise raised

    with pytest.raises(OSError, match=r"cannot write .*maps\.npy: the disk is full\. Free some space") as refused:
        write()
    assert "\n" not in str(refused.value)
    assert os.listdir(tmp_path) == ["maps.npy"]
    assert (tmp_path / "maps.npy").read_text() == "old"


def test_a_fault_of_the_program_is_not_laid_to_a_full_disk(tmp_path, monkeypatch):
    usage = shutil.disk_usage(tmp_path)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: usage._replace(free=0))
    with pytest.raises(ValueError, match="no number"), replacing(tmp_path / "a.npy"):
        raise ValueError("no number")
    cause = RuntimeError("Failed to write pixel data")  # OpenEXR's
    with pytest.raises(OSError, match="the disk is full") as refused, replacing(tmp_path / "a.exr"):
        raise cause
    assert refused.value.__cause__ is cause


def test_the_space_of_a_file_is_taken_where_the_system_cannot_reserve(tmp_path, monkeypatch):
    def refuses(*_):
        raise OSError(errno.EOPNOTSUPP, "not here")

    for change in (lambda: None, lambda: monkeypatch.setattr(os, "posix_fallocate", refuses, raising=False)):
        change()
        path = tmp_path / "array.npy"
        made = np.lib.format.open_memmap(path, "w+", np.float64, (300_000,))
        made.flush()
        reserve(path, made.offset)
        assert path.stat().st_blocks * 512 >= 8 * 300_000
        np.testing.assert_array_equal(np.load(path), np.zeros(300_000))
