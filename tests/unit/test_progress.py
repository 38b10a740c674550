"""The line of progress: what it says, and where it says nothing."""

import threading
import time

import pytest

from diffshade.core import progress


@pytest.mark.parametrize("terminal", [True, False])
def test_a_terminal_sees_it_after_two_seconds_and_a_pipe_later(monkeypatch, capsys, terminal):
    class Soon(threading.Timer):
        def start(self):
            assert self.interval == 2.0
            self.function()

    monkeypatch.setattr(progress.threading, "Timer", Soon)
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "100")
    monkeypatch.setenv("TTY_COMPATIBLE", f"{int(terminal)}")
    with progress.showing("work") as report_progress:
        for share in (0.25, 0.5, 0.75, 0.5):
            report_progress("cutting", share)
        report_progress("sewing")
    out, err = capsys.readouterr()
    assert out == ""
    assert ("work: cutting" in err or "work: sewing" in err) == terminal
    assert terminal or err == ""


def test_a_pipe_sees_a_line_when_the_words_have_changed(monkeypatch, capsys):
    monkeypatch.setattr(progress, "BETWEEN", 0.05)
    monkeypatch.setenv("TTY_COMPATIBLE", "0")
    with progress.showing("work") as report_progress:
        report_progress("cutting", 0.25)
        time.sleep(0.4)
        report_progress("sewing")
        time.sleep(0.4)
    assert capsys.readouterr().err.splitlines() == ["work: cutting, 25%", "work: sewing"]
