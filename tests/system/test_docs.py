"""The package's docstring lists what is public, and every function says what it refuses."""

import inspect
import re

import pytest

import diffshade as ds

PUBLIC = {name: getattr(ds, name) for name in dir(ds)}


def test_the_package_lists_every_public_name_under_one_topic():
    listed = re.findall(r"`(\w+)`", (ds.__doc__ or "").partition("\n## ")[2])
    assert sorted(listed) == sorted(PUBLIC)


@pytest.mark.parametrize("name", [name for name, value in PUBLIC.items() if inspect.isfunction(value)])
def test_a_function_says_what_it_raises(name):
    if inspect.signature(PUBLIC[name]).parameters:  # what takes nothing refuses nothing
        assert re.search(r"\b[Rr]aises\b", PUBLIC[name].__doc__)
