"""The comparison of benchmarks/check.py; what it measures is no matter of tests."""

import importlib
import json
import sys
from pathlib import Path

import pytest

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"


@pytest.fixture
def check(monkeypatch, tmp_path):
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    module = importlib.import_module("check")
    monkeypatch.setattr(module, "BASELINE", tmp_path / "baseline.json")
    monkeypatch.setattr(sys, "argv", ["check.py"])
    yield module
    for name in ("check", "timing"):
        sys.modules.pop(name, None)


def test_only_what_is_more_than_30_percent_above_the_baseline_is_worse(check):
    baseline = {"a": 0.1, "b": 0.1, "c": 0.1, "d": 0.1, "elsewhere": 0.1}
    now = {"a": 0.129, "b": 0.131, "c": 0.01, "d": float("nan"), "new": 9.0}
    assert check.worse(baseline, now) == ["b", "d"]
    assert check.worse(baseline, now, by=0.5) == ["d"]


@pytest.mark.parametrize(
    ("tries", "code"),
    [
        ([0.10], 0),
        ([0.20, 0.12], 0),  # the second try is near the baseline: the first was somebody else's load
        ([0.20, 0.30, 0.19], 1),
    ],
)
def test_what_is_worse_in_every_try_ends_with_1(check, monkeypatch, capsys, tries, code):
    check.BASELINE.write_text(json.dumps({"measured": "", "ratios": {"ds.shade / NumPy": 0.1}}))
    measured = iter(tries)
    monkeypatch.setattr(check, "measure", lambda: {"ds.shade / NumPy": next(measured)})
    with pytest.raises(SystemExit) as end:
        check.main()
    assert end.value.code == code
    assert next(measured, None) is None
    assert ("worse by more than 30%: ds.shade / NumPy, 0.1900 against 0.1000" in capsys.readouterr().err) == bool(code)


def test_what_is_not_measured_is_said_and_passed_by(check, capsys):
    assert check.report({"with PyTorch": 0.1}, {"with texels": 0.2}) == 0
    said = capsys.readouterr().out
    assert "not measured here: with PyTorch" in said
    assert "(new)" in said


def test_a_baseline_is_written_and_compares_with_itself(check, monkeypatch):
    ratios = {"ds.shade / NumPy": 0.123456, "cold": 4.0}
    monkeypatch.setattr(check, "measure", lambda: ratios)
    monkeypatch.setattr(sys, "argv", ["check.py", "--write"])
    check.main()
    monkeypatch.setattr(sys, "argv", ["check.py"])
    with pytest.raises(SystemExit) as end:
        check.main()
    assert end.value.code == 0


def test_the_committed_baseline_holds_positive_ratios():
    ratios = json.loads((BENCHMARKS / "baseline.json").read_text(encoding="utf-8"))["ratios"]
    assert ratios
    assert all(0 < value < 100 for value in ratios.values())


def test_a_check_without_a_baseline_says_how_to_make_one(check, monkeypatch):
    monkeypatch.setattr(check, "measure", dict)
    with pytest.raises(SystemExit, match="--write"):
        check.main()
