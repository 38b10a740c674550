import os
from pathlib import Path

import pytest

from diffshade.files import replacing


def test_the_whole_file_takes_the_place_of_the_old_one(tmp_path):
    target = tmp_path / "scene.toml"
    target.write_text("old")
    with replacing(target) as temporary:
        temporary.write_text("new")
        assert target.read_text() == "old"
    assert target.read_text() == "new"
    assert os.listdir(tmp_path) == ["scene.toml"]


@pytest.mark.parametrize("name", ["image.png", "IMAGE.PNG", "archive.tar.gz", "no_suffix", "täst ü.tif"])
def test_the_temporary_path_is_a_new_one_beside_with_the_same_suffix(tmp_path, name):
    with replacing(tmp_path / name) as temporary:
        assert temporary.parent == Path(os.path.realpath(tmp_path))
        assert temporary.suffix == Path(name).suffix
        assert not temporary.exists()
        temporary.write_bytes(b"x")
    assert os.listdir(tmp_path) == [name]


def test_a_string_and_a_relative_path_do(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with replacing("a.txt") as temporary:
        temporary.write_text("a")
    assert (tmp_path / "a.txt").read_text() == "a"


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt, SystemExit])
@pytest.mark.parametrize("before", [None, "old"])
def test_an_error_leaves_the_old_file_and_nothing_else(tmp_path, error, before):
    target = tmp_path / "scene.toml"
    if before is not None:
        target.write_text(before)

    def write():
        with replacing(target) as temporary:
            temporary.write_text("half")
            raise error

    with pytest.raises(error):
        write()
    assert os.listdir(tmp_path) == ([] if before is None else ["scene.toml"])
    assert before is None or target.read_text() == before


def test_an_error_before_anything_is_written_is_the_one_that_is_raised(tmp_path):
    with pytest.raises(ZeroDivisionError), replacing(tmp_path / "a.txt"):
        raise ZeroDivisionError
    assert os.listdir(tmp_path) == []


def test_a_missing_folder_is_one_sentence_and_the_block_is_not_entered(tmp_path):
    target = tmp_path / "results" / "a.txt"
    message = r"^cannot write .*a\.txt: there is no folder .*results\. Create it first\.$"
    with pytest.raises(FileNotFoundError, match=message), replacing(target):
        pytest.fail("entered")


def test_a_folder_is_not_replaced(tmp_path):
    message = r"^cannot write .*: it is a folder\. Give the name of a file\.$"
    with pytest.raises(IsADirectoryError, match=message), replacing(tmp_path):
        pytest.fail("entered")


def test_a_folder_that_cannot_be_written_to(tmp_path, monkeypatch):
    monkeypatch.setattr(os, "access", lambda *_: False)  # the tests may run as root, whom no mode stops
    with pytest.raises(PermissionError, match="is not writable"), replacing(tmp_path / "a.txt"):
        pytest.fail("entered")


def test_a_link_stays_a_link(tmp_path):
    (tmp_path / "real").mkdir()
    (tmp_path / "real" / "a.txt").write_text("old")
    (tmp_path / "link.txt").symlink_to(tmp_path / "real" / "a.txt")
    with replacing(tmp_path / "link.txt") as temporary:
        temporary.write_text("new")
    assert (tmp_path / "link.txt").is_symlink()
    assert (tmp_path / "real" / "a.txt").read_text() == "new"


def test_the_suffix_is_that_of_the_link_not_of_the_file(tmp_path):
    (tmp_path / "link.png").symlink_to(tmp_path / "real")
    with replacing(tmp_path / "link.png") as temporary:
        assert temporary.suffix == ".png"
        temporary.write_text("new")
    assert (tmp_path / "real").read_text() == "new"


@pytest.mark.skipif(os.name != "posix", reason="modes are POSIX's")
def test_the_mode_is_that_of_any_new_file(tmp_path):
    (tmp_path / "plain").write_text("")
    with replacing(tmp_path / "a.txt") as temporary:
        temporary.write_text("")
    assert (tmp_path / "a.txt").stat().st_mode == (tmp_path / "plain").stat().st_mode
