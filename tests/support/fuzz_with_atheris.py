"""Search for a file that a reader answers otherwise than with a result or one sentence, led by the code it reaches.

python fuzz_with_atheris.py SECONDS [NAME ...], with names such as .toml and 8.png (see hostile.py), gives each reader
its share of the seconds and prints how many files it was given; it ends at the first that breaks one, with the file's
place. Needs `pip install 'diffshade[fuzz]'`.
"""

import importlib
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

try:
    atheris: Any = importlib.import_module("atheris")
except ImportError:
    sys.exit("fuzzing led by coverage needs the package atheris. Install it: pip install 'diffshade[fuzz]'.")

MEGABYTES = 6000  # of memory, at which libFuzzer ends a run


def main() -> None:
    """Fuzz each reader in a process of its own: libFuzzer never comes back."""
    from hostile import OTHERS, TEXTS

    names = sys.argv[2:] or [*TEXTS, *OTHERS]
    seconds = max(int(float(sys.argv[1]) / len(names)), 1)
    for name in names:
        with tempfile.TemporaryDirectory() as folder:
            corpus, artifacts = Path(folder) / "corpus", Path.cwd() / "output" / "fuzz"
            corpus.mkdir()
            artifacts.mkdir(parents=True, exist_ok=True)
            options = (f"-max_total_time={seconds}", "-timeout=60", f"-rss_limit_mb={MEGABYTES}", "-max_len=4096")
            command = (sys.executable, __file__, "--one", name, folder, *options, f"-artifact_prefix={artifacts}/")
            done = subprocess.run((*command, str(corpus)), capture_output=True, text=True, errors="replace")
            said = [line for line in done.stderr.splitlines() if line.startswith("Done ")]
            print(f"{name}: {said[-1] if said else 'broken'}", flush=True)
            if done.returncode:
                sys.exit(f"{name} ended with {done.returncode}:\n{done.stdout[-2000:]}\n{done.stderr[-4000:]}")


def one(name: str, folder: Path, options: list[str]) -> None:
    """Fuzz one reader until libFuzzer ends the process."""
    with atheris.instrument_imports(include=["diffshade", "tomllib", "json", "PIL", "tifffile", "trimesh", "zarr"]):
        for needed in ("tifffile", "trimesh", "zarr"):  # by `write_good`
            importlib.import_module(needed)
        from hostile import OTHERS, TEXTS, check_reading, good_texts, write_good

    if name in TEXTS:
        path, base = folder / f"fuzz{name}", good_texts(folder)[name]
    else:
        write_good(folder)
        path, base = folder / name, (folder / name).read_bytes()
    (folder / "corpus" / "good").write_bytes(base)
    readers = (TEXTS | OTHERS)[name]
    check_reading(readers, path, base)
    atheris.Setup([sys.argv[0], *options], lambda data: check_reading(readers, path, data))
    atheris.Fuzz()


if __name__ == "__main__":
    if sys.argv[1] == "--one":
        one(sys.argv[2], Path(sys.argv[3]), sys.argv[4:])
    else:
        main()
