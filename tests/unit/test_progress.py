"""The line of progress: what it says, and where it says nothing."""

import os
import re
import subprocess
import sys
import time

import pytest

from diffshade import progress

PROGRAM = """
import time
from diffshade.progress import showing
with showing("work") as tell:
    for i in range(30):
        tell("cutting", i / 30)
        time.sleep(0.1)
    tell("sewing")
    time.sleep(0.2)
"""


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


@pytest.mark.skipif(os.name == "nt", reason="there are no such terminals on Windows.")
def test_a_terminal_sees_it_after_two_seconds_and_a_pipe_never():
    import pty

    command = [sys.executable, "-c", PROGRAM]
    master, slave = pty.openpty()
    began = time.monotonic()
    environment = os.environ | {"TERM": "xterm", "COLUMNS": "100"}
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=slave, env=environment) as running:
        os.close(slave)
        shown, first = b"", None
        while True:
            try:
                piece = os.read(master, 4096)
            except OSError:  # the terminal is closed
                break
            if not piece:
                break
            shown += piece
            if first is None and b"cutting" in shown:
                first = time.monotonic() - began
        assert running.wait(timeout=60) == 0
    os.close(master)
    assert first is not None
    assert first >= 2.0
    text = shown.decode()
    assert re.search(r"work: cutting, \d+%, about \d+ s left", text)
    piped = subprocess.run(command, capture_output=True, text=True, check=True)
    assert piped.stdout == piped.stderr == ""
