"""Measure the quick ratios again and say which got worse than the committed baseline; exit with 1 if one did.

A ratio is diffshade's time over another program's in the same rounds, so that a smaller one is better on any machine;
time is what all threads computed, so that others who use the machine change little. It got worse where it is more than
30 % above the baseline in each of several tries. What cannot be measured here (PyTorch is not installed, say) is said
and passed by. `--write` makes what is measured the new baseline: say in the commit why it changed.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path

BASELINE = Path(__file__).with_name("baseline.json")
WORSE = 0.30
ROUNDS = 15
Ratios = dict[str, float]


def shading_ratios() -> Ratios:
    """Forward and gradient, beside NumPy, PyTorch and numba."""
    import shading
    from timing import ratio, take_turns

    found = {}
    for what, size in (("forward", 256), ("forward", 1024), ("gradient", 512)):
        programs = {"forward": shading.forward, "gradient": shading.gradient}[what](size, compiled=False)
        seconds = take_turns(programs, ROUNDS, f"{what} {size}", time.process_time)
        first = next(iter(seconds))
        for name in list(seconds)[1:]:
            found[f"{what} {size}: {first} / {name}"] = ratio(seconds, first, name)
    return found


def cold_start_ratios() -> Ratios:
    """A fit from a cold process, in the time that it takes to import jax: of processors, which others do not change.

    Once of a photograph under the lamp that the scene has, and once under one five degrees beside it.
    """
    import cold_start
    import numpy as np
    from timing import in_a_process

    code = "import os, json, jax; t = os.times(); print(json.dumps({'cpu': t.user + t.system}))"
    right, *_, off = cold_start.WAYS
    rounds: dict[str, list[float]] = {right: [], off: []}
    for _ in range(3):
        found, jax_alone = cold_start.measure(1, ways=(right, off)), in_a_process("-c", code)["cpu"]
        for way, of_way in rounds.items():
            of_way.append(found[way][0]["cpu"] / jax_alone)
    names = {right: "import and ds.fit", off: "import and ds.fit, lamp off"}
    return {f"cold start 256: {names[way]} / import jax": float(np.median(of)) for way, of in rounds.items()}


def texel_ratios() -> Ratios:
    """A fit of texels, beside SciPy's loop and vmapped optimistix, by the clock: its threads are a part of it."""
    import texels

    found = {}
    for lights, channels in texels.CASES:
        _, ratios, _ = texels.measured(lights, channels, blocks=16, rounds=5)
        of = f"texels, {lights * channels} observations"
        for name in (texels.SCIPY, texels.OPTIMISTIX):
            found[f"{of}: {texels.PROGRAM} / {name}"] = 1.0 / ratios[name]
        found[f"{of}: {texels.CALL} / {texels.PROGRAM}"] = ratios[texels.CALL]
    return found


def band_ratios() -> Ratios:
    """A band of 31 beside a channel of RGB."""
    import bands

    return bands.band_ratios()


# A benchmark joins the check with a function of its own: name of the ratio -> diffshade's time over another's.
MEASURES: tuple[Callable[[], Ratios], ...] = (shading_ratios, cold_start_ratios, texel_ratios, band_ratios)


def measure() -> Ratios:
    """Return every quick ratio."""
    return {name: value for of in MEASURES for name, value in of().items()}


def worse(baseline: Mapping[str, float], now: Mapping[str, float], by: float = WORSE) -> list[str]:
    """Return the names of the ratios that are above the baseline by more than a share of it, or are no number."""
    return [name for name, was in baseline.items() if name in now and not now[name] <= (1.0 + by) * was]


def main() -> None:
    """Measure, compare, and exit with 1 where a ratio got worse."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tries", type=int, default=3, help="tries in each of which it must be worse (default: 3)")
    parser.add_argument("--write", action="store_true", help="make what is measured the new baseline")
    arguments = parser.parse_args()
    if arguments.tries < 1:
        sys.exit(f"--tries must be at least 1; got {arguments.tries}. Leave it out for 3.")
    now = measure()
    if arguments.write:
        write(now)
        return
    if not BASELINE.exists():
        sys.exit(f"there is no {BASELINE.name} to compare with. Make one: python benchmarks/check.py --write.")
    baseline = json.loads(BASELINE.read_text(encoding="utf-8"))["ratios"]
    for _ in range(arguments.tries - 1):
        if not worse(baseline, now):
            break
        now = {name: min(now.get(name, value), value) for name, value in measure().items()}
    sys.exit(report(baseline, now))


def report(baseline: Mapping[str, float], now: Mapping[str, float]) -> int:
    """Print each ratio beside its baseline; return 1 where one got worse, else 0."""
    for name in sorted({*baseline, *now}):
        if name not in now:
            print(f"  not measured here: {name}")
        elif name not in baseline:
            print(f"  {now[name]:8.4f}  (new)             {name}")
        else:
            print(f"  {now[name]:8.4f}  ({now[name] / baseline[name] - 1:+.0%} of {baseline[name]:.4f})  {name}")
    found = worse(baseline, now)
    for name in found:
        print(f"worse by more than {WORSE:.0%}: {name}, {now[name]:.4f} against {baseline[name]:.4f}.", file=sys.stderr)
    return int(bool(found))


def write(ratios: Mapping[str, float]) -> None:
    """Write the baseline, whole or not at all."""
    from timing import conditions

    from diffshade.io.files import replacing

    rounded = {name: float(f"{value:.3g}") for name, value in ratios.items()}
    with replacing(BASELINE) as path:
        text = json.dumps({"measured": conditions(), "ratios": rounded}, indent=1)
        path.write_text(text + "\n", encoding="utf-8")
    print(f"wrote {BASELINE.name}: {len(rounded)} ratios.")


if __name__ == "__main__":
    main()
