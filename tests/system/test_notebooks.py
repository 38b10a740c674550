"""The notebooks run from the top without an error, are committed without outputs, and stay thin."""

import math
import queue
import re
import time
from pathlib import Path
from typing import Any

import nbclient
import nbformat
import pytest
from jupyter_client.channels import AsyncZMQSocketChannel

import diffshade as ds

NOTEBOOKS = sorted((Path(__file__).parents[2] / "notebooks").glob("*.ipynb"))
# the notebooks in which dragging teaches
SLIDERS = ("01_light_and_matter", "05_attenuation", "06_transparency", "07_texel_maps")

# what these do is in test_what_views_cannot_tell.py, test_all_figures.py, test_robust_texels.py, test_live_maps.py,
# test_photographs_fitted.py, test_exchange.py, test_height_meshes.py and test_features.py
ELSEWHERE = (
    "03_what_an_image_can_tell",
    "04_the_figures_of_a_lecture",
    "05_attenuation",
    "06_transparency",
    "07_texel_maps",
    "08_from_photographs_to_threejs",
    "09_maps_that_travel",
)


def beneath_sliders(notebook: nbformat.NotebookNode) -> list[list[dict[str, Any]]]:
    """What each `interact` shows beneath its sliders, which is kept with the widgets and in no cell."""
    widgets = notebook.metadata.get("widgets", {}).get("application/vnd.jupyter.widget-state+json", {}).get("state", {})
    return [widget["state"]["outputs"] for widget in widgets.values() if widget["model_name"] == "OutputModel"]


async def get_message(self: AsyncZMQSocketChannel, timeout: float | None = None) -> dict[str, Any]:
    """Wait for a message and look for it every second: now and then ZeroMQ does not announce one."""
    end = math.inf if timeout is None else time.monotonic() + timeout
    while not await self.socket.poll(1000):
        if time.monotonic() > end:
            raise queue.Empty
    return await self._recv()


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_it_is_thin_and_has_no_outputs(path):
    cells = [cell for cell in nbformat.read(path, as_version=4).cells if cell.cell_type == "code"]
    assert 0 < len(cells) <= 14
    assert not any(cell.outputs or cell.execution_count for cell in cells)
    assert not any(line.startswith(("def ", "class ")) for cell in cells for line in cell.source.splitlines())


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_no_cell_ends_with_sliders(path):
    """`jupyter nbconvert --execute` waits for ever for such a cell, now and then (nbclient issue 312)."""
    cells = [cell.source for cell in nbformat.read(path, as_version=4).cells if cell.cell_type == "code"]
    assert all("plt.subplots(" in cell.rpartition("interact(")[2] for cell in cells if "interact(" in cell)


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_what_it_calls_is_public(path):
    code = "\n".join(cell.source for cell in nbformat.read(path, as_version=4).cells if cell.cell_type == "code")
    assert not set(re.findall(r"\bds\.(\w+)", code)) - set(dir(ds))


@pytest.mark.thorough
@pytest.mark.parametrize(
    "path",
    [pytest.param(path, marks=[pytest.mark.slow] * (path.stem in ELSEWHERE), id=path.stem) for path in NOTEBOOKS],
)
@pytest.mark.filterwarnings("default")  # of the notebook machinery; the kernel below has its own
def test_it_runs_and_draws(path, tmp_path, monkeypatch):
    monkeypatch.setenv("PYTHONWARNINGS", "error::FutureWarning,error::DeprecationWarning:diffshade")
    notebook = nbformat.read(path, as_version=4)
    monkeypatch.setattr(AsyncZMQSocketChannel, "get_msg", get_message)
    nbclient.NotebookClient(notebook, timeout=300, resources={"metadata": {"path": str(tmp_path)}}).execute()
    outputs = [output for cell in notebook.cells if cell.cell_type == "code" for output in cell.outputs]
    pictures = [output for output in outputs if "image/png" in output.get("data", {})]
    assert len(pictures) >= 3
    # what a slider's function raises is shown beneath the slider and stops nothing
    sliders = beneath_sliders(notebook)
    assert bool(sliders) == (path.stem in SLIDERS)
    assert all(["image/png" in output.get("data", {}) for output in shown] == [True] for shown in sliders)
    assert not list(tmp_path.iterdir())
