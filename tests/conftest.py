"""Strict settings for every test, and its tier; the library itself changes no JAX configuration.

Three tiers: the default one, which must stay quick; `-m thorough`, half an hour or so; `-m slow`, statistics over many
fits, and studies of minutes to hours. What stands in `studies/` is thorough unless it is marked slow.
"""

import os
import shutil
import tempfile
from pathlib import Path

os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")  # programs from the cache else say on stderr for which CPU they are

import jax
import pytest
from browser import chromium
from jaxlib.version import __version__ as jaxlib_version
from xdist.scheduler import LoadScopeScheduling

# studies/test_settings.py runs tests again as most users have JAX, with the flag off, and with all types checked
jax.config.update("jax_enable_x64", os.environ.get("DIFFSHADE_TEST_X64", "1") == "1")
jax.config.update("jax_numpy_rank_promotion", "raise")
jax.config.update("jax_numpy_dtype_promotion", "strict")

if os.environ.get("DIFFSHADE_TEST_TYPES") == "1":
    from jaxtyping import install_import_hook

    install_import_hook("diffshade", "beartype.beartype")

# XLA's older way to emit loops compiles in four fifths of the time; jaxlib 0.12 has it no more. Without LLVM's costly
# passes large programs compile in three quarters of that, and run as fast.
QUICKER = "--xla_cpu_use_fusion_emitters=false --xla_llvm_disable_expensive_passes=true"
HAS_QUICKER = tuple(map(int, jaxlib_version.split(".")[:2])) < (0, 11)

LONG = ("test_readme.py", "test_settings.py", "test_notebooks.py")
OF_TEXELS = ("test_robust_texels.py", "test_texels.py")  # their largest programs are the same


class ByModule(LoadScopeScheduling):
    """Each module's tests in one process, those of LONG apart, those of OF_TEXELS together."""

    def _split_scope(self, nodeid):
        if any(f"/{name}::" in nodeid for name in LONG):
            return nodeid
        return "texels" if any(f"/{name}::" in nodeid for name in OF_TEXELS) else super()._split_scope(nodeid)


STUDIES = Path(__file__).with_name("studies")
PROGRAMS = "DIFFSHADE_TEST_PROGRAMS"


def pytest_configure(config):
    """Let the processes of one run share what they compile: most of the time of the tests is the compiler's.

    The default and the thorough tier compile quickly, the slow one as users do.
    """
    if HAS_QUICKER and "thorough" in config.getoption("markexpr") and "XLA_FLAGS" not in os.environ:
        os.environ["XLA_FLAGS"] = QUICKER  # read when the first program is compiled
    if PROGRAMS not in os.environ:
        os.environ[PROGRAMS] = config.programs = tempfile.mkdtemp(prefix="diffshade-programs-")
    jax.config.update("jax_compilation_cache_dir", os.environ[PROGRAMS])
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.3)
    # commands, scripts and notebooks that tests start as processes of their own
    os.environ["JAX_COMPILATION_CACHE_DIR"] = os.environ[PROGRAMS]
    os.environ["JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"] = "0.3"


def pytest_ignore_collect(collection_path, config):
    """Do not even read the studies where none of them is asked for: each process would rewrite their assertions."""
    if collection_path == STUDIES and config.getoption("markexpr") == "not thorough and not slow":
        return True
    return None


def pytest_unconfigure(config):
    if hasattr(config, "programs"):  # the process that made the folder; the others read its name
        shutil.rmtree(config.programs, ignore_errors=True)
        del os.environ[PROGRAMS]


def pytest_itemcollected(item):
    """A test is of one tier, though a case of a thorough one may be slow."""
    if item.get_closest_marker("slow"):
        item.own_markers[:] = [mark for mark in item.own_markers if mark.name != "thorough"]
    elif STUDIES in item.path.parents:
        item.add_marker("thorough")


def pytest_collection_modifyitems(items):
    """Begin with what takes long by itself, so that at the end no process waits for another."""
    items.sort(key=lambda item: item.path.name not in LONG)


def pytest_xdist_make_scheduler(config, log):
    """Give a process all tests that share fixtures or programs; each long test is by itself."""
    return ByModule(config, log)


MAPS = Path("/proc/self/maps")
MOST_MAPS = 30_000


@pytest.fixture(scope="module", autouse=True)
def few_programs():
    """Forget compiled programs before they are too many: each holds memory maps, of which Linux allows 65,530."""
    yield
    if MAPS.exists() and MAPS.read_bytes().count(b"\n") > MOST_MAPS:
        jax.clear_caches()


@pytest.fixture
def file(tmp_path):
    """Write bytes under a name and give the path."""

    def write(name, data):
        (tmp_path / name).write_bytes(data)
        return tmp_path / name

    return write


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    with chromium(tmp_path_factory.mktemp("profile")) as running:
        yield running
