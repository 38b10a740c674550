"""A page of maps in a browser: its controls are set, and its picture is read, a pixel for each texel."""

import base64
import io
import json
import time

import imageio.v3 as iio
import numpy as np
from report_pages import Page

import diffshade as ds

SET = """
const [name, value] = arguments, all = [...document.querySelectorAll(`#object [name="${name}"]`)];
const control = all.length > 1 ? all.find((of) => of.value === value) : all[0];
if (control.type === "checkbox" || control.type === "radio") control.checked = value !== false;
else control.value = value;
control.dispatchEvent(new Event("input", { bubbles: true }));
"""
AT_REST = "return document.querySelector('#object canvas').dataset.resting === 'true'"
DRAWN = "return document.querySelector('#object canvas').toDataURL()"
SIZE = """
const [width, height] = [...arguments].map((side) => `${side}px`);
Object.assign(document.querySelector(".frame").style, { width, height, minHeight: 0 });
"""


class Stage:
    """A page of maps in a browser, whose canvas has a pixel for each texel of the page."""

    def __init__(self, browser, path):
        self.browser = browser
        (text,) = [text for a, text in Page(path).all("script") if a.get("id") == "maps-scene"]
        self.told = json.loads(text)
        self.width, self.height = self.told["layers"][0]["size"]
        browser.get(path.as_uri())
        self.wait()
        self.resize()
        self.set("compare", False)

    def resize(self, scale=1):
        """Make the canvas so many pixels wide a texel."""
        self.browser.execute_script(SIZE, scale * self.width, scale * self.height)
        self.wait()

    def wait(self):
        end = time.monotonic() + 60
        time.sleep(0.1)
        while not self.browser.execute_script(AT_REST):
            assert time.monotonic() < end, self.browser.get_log("browser")
            time.sleep(0.05)

    def set(self, name, value):
        self.browser.execute_script(SET, name, value)
        self.wait()

    def value(self, name):
        return float(self.browser.find_element("name", name).get_attribute("value"))

    def draw(self, **controls):
        """The picture with controls set, as displayed, from 0 to 1."""
        for name, value in controls.items():
            self.set(name, value)
        uri = self.browser.execute_script(DRAWN)
        image = iio.imread(io.BytesIO(base64.b64decode(uri.split(",")[1])))[..., :3] / 255
        assert image.shape == (self.height, self.width, 3)
        return image

    def shown(self, radiance, view=0, exposure=1.0):
        """What a picture of this radiance in the light of a photograph looks like, from 0 to 1."""
        told = self.told["views"][view]
        return ds.srgb_encode(np.clip(exposure * (told["gain"] * radiance + told["black"]), 0, 1))

    def radiance(self, drawn, view=0, exposure=1.0):
        """The radiance of a picture in the light of a photograph, as far as it is not clipped."""
        told = self.told["views"][view]
        return (ds.srgb_decode(drawn) / exposure - told["black"]) / told["gain"]
