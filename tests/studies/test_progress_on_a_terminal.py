"""The line of progress on a real terminal, after real seconds."""

import os
import re
import subprocess
import sys
import time

import pytest

PROGRAM = """
import time
from diffshade.core.progress import showing
with showing("work") as tell:
    for i in range(30):
        tell("cutting", i / 30)
        time.sleep(0.1)
    tell("sewing")
    time.sleep(0.2)
"""


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
    assert re.search(r"work: cutting, \d+%.*0:00:0\d.*0:00:0\d.*left", text)
    piped = subprocess.run(command, capture_output=True, text=True, check=True)
    assert piped.stdout == piped.stderr == ""
