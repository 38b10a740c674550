"""The line of progress: what it says, and where it says nothing."""

import threading

import pytest

from diffshade.core import progress


@pytest.fixture
def clock(monkeypatch):
    now = [0.0]
    monkeypatch.setattr(progress.time, "monotonic", lambda: now[0])
    return now


def test_the_time_left_is_as_the_share_grows(clock):
    pace = progress._Pace()
    assert pace.words(0.0) == ["0%"]
    clock[0] = 10.0
    assert pace.words(0.25) == ["25%", "about 30 s left"]
    clock[0] = 110.0
    assert pace.words(0.5) == ["50%", "about 2 min left"]
    assert pace.words(None) == []
    clock[0] = 30_000.0
    assert pace.words(0.75) == ["75%", "about 2.8 h left"]


def test_what_is_begun_half_way_or_anew_has_a_pace_of_its_own(clock):
    pace = progress._Pace()
    assert pace.words(0.5) == ["50%"]  # gone on with
    clock[0] = 10.0
    assert pace.words(0.75) == ["75%", "about 10 s left"]
    assert pace.words(0.0) == ["0%"]  # something new
    clock[0] = 20.0
    assert pace.words(0.5) == ["50%", "about 10 s left"]


@pytest.mark.parametrize("terminal", [True, False])
def test_a_terminal_sees_it_after_two_seconds_and_a_pipe_never(monkeypatch, capsys, terminal):
    class Soon(threading.Timer):
        def start(self):
            assert self.interval == 2.0
            self.function()

    monkeypatch.setattr(progress.threading, "Timer", Soon)
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "100")
    monkeypatch.setenv("TTY_COMPATIBLE", f"{int(terminal)}")
    with progress.showing("work") as report_progress:
        report_progress("cutting", 0.25)
        report_progress("cutting", 0.5)
    out, err = capsys.readouterr()
    assert out == ""
    assert ("work: cutting, 50%, about" in err) == terminal
    assert terminal or err == ""
