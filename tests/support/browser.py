"""A headless Chromium for the tests, by Selenium; a test that asks for one is skipped where there is none."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

NAMES = ("chromium", "chromium-browser", "google-chrome")
# WebGL by software; nothing is to go to the network
ARGUMENTS = (
    "--headless --no-sandbox --no-first-run --disable-quic --disable-background-networking --disable-component-update "
    "--disable-sync --use-gl=angle --use-angle=swiftshader --enable-unsafe-swiftshader"
)


@contextmanager
def chromium(folder: Path) -> Iterator[Any]:
    """Start a browser with an empty profile in a folder, and end it."""
    program, driver = next(filter(None, map(shutil.which, NAMES)), None), shutil.which("chromedriver")
    if program is None or driver is None:
        pytest.skip("this test needs Chromium and its driver: apt-get install chromium chromium-driver.")
    webdriver = pytest.importorskip("selenium.webdriver", reason="this test needs Selenium: pip install selenium.")
    options = webdriver.ChromeOptions()
    options.binary_location = program
    for argument in (*ARGUMENTS.split(), f"--user-data-dir={folder}"):
        options.add_argument(argument)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    browser = webdriver.Chrome(options=options, service=webdriver.ChromeService(driver))
    try:
        yield browser
    finally:
        browser.quit()
