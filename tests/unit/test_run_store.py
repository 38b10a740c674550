"""What a run keeps on disk is what it first made, and folders of another version are refused."""

import errno
import os

import numpy as np
import pytest

from diffshade.parallel.run_store import RunStore


def store(folder):
    return RunStore(folder, "a problem", 4, lambda rows: 3, None)


def test_what_was_made_first_is_kept(tmp_path):
    made = []

    def make():
        made.append(len(made))
        return [np.full(2, float(len(made))), np.array(7.0)]

    first = store(tmp_path / "run")
    before = first.kept("basis", make)
    first.close()
    again = store(tmp_path / "run")
    for array, kept in zip(before, again.kept("basis", make), strict=True):
        np.testing.assert_array_equal(array, kept)
    assert made == [0]
    again.finish(0)
    with pytest.raises(ValueError, match=r"other\.npz.* is missing\. Remove the folder"):
        again.kept("other", make)
    again.close()
    assert len(store(None).kept("basis", make)) == 2


def test_an_array_of_another_version_is_refused(tmp_path):
    run = store(tmp_path / "run")
    run.array("spread", (4, 4), np.float32)
    run.close()
    later = store(tmp_path / "run")
    with pytest.raises(ValueError, match=r"spread\.npy has float32 .*\(4, 4\).*needs float32 of \(4, 6\)\. Remove"):
        later.array("spread", (4, 6), np.float32)
    later.close()


def test_maps_on_a_full_disk_are_refused_before_they_are_mapped(tmp_path, monkeypatch):
    run = store(tmp_path / "run")

    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "posix_fallocate", full, raising=False)
    with pytest.raises(OSError, match=r"cannot write .*spread\.npy: the disk is full"):
        run.array("spread", (4, 4), np.float32)
    run.close()
    assert not (tmp_path / "run" / "spread.npy").exists()
