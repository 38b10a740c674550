"""Where the measured data is: photographs, lamps and materials that have no licence to be copied into the project."""

import os
from pathlib import Path

import pytest

FOLDER = Path(os.environ.get("DIFFSHADE_DATA", Path(__file__).parents[3] / "shared" / "data"))


def measured(name: str) -> Path:
    """Return a folder of the measured data, or skip the test with a sentence."""
    if not (FOLDER / name).is_dir():
        pytest.skip(f"the measured data '{name}' is not at {FOLDER}; set DIFFSHADE_DATA to the folder that holds it.")
    return FOLDER / name
