"""The documentation builds without a warning, has every public name, and its pages need nothing from elsewhere."""

import json
import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path

import pytest
from browser import chromium
from public_names import ROOMS, TOP

ROOT = Path(__file__).parents[2]


class Page(HTMLParser):
    """What a page says outside of code, the places in it, and where it points."""

    def __init__(self, text: str):
        super().__init__()
        self.prose: list[str] = []
        self.places: set[str] = set()
        self.links: list[str] = []
        self.tags: list[str] = []
        self.sources: list[str] = []
        self._code = 0
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        given = dict(attrs)
        self.tags.append(tag)
        self._code += tag in ("code", "pre", "style", "script")
        self.places |= {given["id"] or ""} if "id" in given else set()
        self.links += [given["href"] or ""] if "href" in given else []
        self.sources += [given["src"] or ""] if "src" in given else []

    def handle_endtag(self, tag):
        self._code -= tag in ("code", "pre", "style", "script")

    def handle_data(self, data):
        if not self._code:
            self.prose.append(data)


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    for name in ("pdoc", "latex2mathml"):
        pytest.importorskip(name, reason=f"the documentation needs {name}: pip install 'diffshade[docs]'.")
    folder = tmp_path_factory.mktemp("docs")
    done = subprocess.run(
        [sys.executable, ROOT / "docs" / "build.py", folder, "--figures", "snell", "lobes"],
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    return folder


@pytest.fixture(scope="module")
def pages(site):
    return {path.name: Page(path.read_text(encoding="utf-8")) for path in sorted(site.glob("*.html"))}


def test_every_public_name_is_there(pages):
    assert set(TOP) <= pages["diffshade.html"].places
    assert {"Fit.predict", "TexelMaps.write", "Material.foley", "Material.__init__"} <= pages["diffshade.html"].places
    assert {"examine", "Examination", "FittedValues"} <= pages["diffshade.html"].places  # results, too
    assert {"find_lights", "FoundLights", "Calibration.write"} <= pages["diffshade.lights.html"].places


def test_every_formula_became_mathematics(pages):
    for page in (pages["diffshade.html"], pages["lectures.html"]):
        prose = "".join(page.prose)
        assert "$" not in prose
        assert "\\" not in prose  # of LaTeX that is not known
        assert "merror" not in page.tags
    page = pages["diffshade.html"]
    assert page.tags.count("math") >= sum(value.__doc__.count("$$") for value in TOP.values()) // 2 > 20


def test_no_markdown_is_left(pages):
    for name, page in pages.items():
        assert not re.search(r"^#+ |^\| .* \|$|\]\(|^```", "".join(page.prose), re.MULTILINE), name


def test_a_page_needs_nothing_from_elsewhere(site, pages):
    # README, names, CONTRIBUTING, CHANGELOG and SCALING
    texts = sum(len(list((ROOT / "docs" / folder).glob("*.md"))) for folder in ("pages", "studies"))
    assert len(pages) == 5 + len(ROOMS) + texts
    for page in pages.values():
        assert not {"iframe", "link"} & set(page.tags)
        assert page.tags.count("script") == 1  # the search box, which loads search.js from beside the page
        figures = [source for source in page.sources if not source.startswith("data:image/")]
        assert figures == (["figures/snell.png", "figures/lobes.png"] if page is pages["lectures.html"] else [])
    assert {path.name for path in site.iterdir()} == {*pages, "figures", "search.js"}
    drawn = {path.name for path in (site / "figures").iterdir()}
    assert drawn == {"snell.png", "snell-dark.png", "lobes.png", "lobes-dark.png"}
    assert {"figure-snell", "figure-lobes"} <= pages["lectures.html"].places
    assert pages["lectures.html"].links.count("#figure-snell") == 2  # in the tables of both lectures
    (script,) = re.findall(r"<script>.*?</script>", (site / "index.html").read_text(encoding="utf-8"), re.DOTALL)
    assert "http" not in script


def test_the_search_finds_every_name_and_every_section(site, pages):
    (index,) = re.findall(r"const docs = (.*);$", (site / "search.js").read_text(encoding="utf-8"), re.MULTILINE)
    entries = json.loads(index)
    names = [entry["fullname"] for entry in entries]
    assert len(names) == len(set(names))
    assert {f"diffshade.{name}" for name in TOP} <= set(names)
    for entry in entries:
        assert entry["qualname"] in pages[f"{entry['modulename']}.html"].places
    assert {entry["modulename"] for entry in entries} == {name.removesuffix(".html") for name in pages}


def test_no_link_leads_nowhere(pages):
    for here, page in pages.items():
        for link in page.links:
            if not link.startswith(("http", "mailto:")):
                file, _, place = link.partition("#")
                assert (file or here) in pages, f"{here} links to {link}"
                assert not place or place in pages[file or here].places, f"{here} links to {link}"


@pytest.mark.slow
@pytest.mark.parametrize("width", [360, 1280])
def test_pages_fit_their_window(site, tmp_path, width):
    with chromium(tmp_path) as browser:
        size = {"width": width, "height": 800, "deviceScaleFactor": 1, "mobile": width < 600}
        browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
        for path in sorted(site.glob("*.html")):
            browser.get(path.as_uri())
            assert browser.execute_script("return document.documentElement.scrollWidth") <= width, path.name
            heights = browser.execute_script("return [...document.querySelectorAll('math')].map(m => m.clientHeight)")
            assert all(height > 8 for height in heights)
            assert browser.get_log("browser") == []


@pytest.mark.slow
def test_the_search_box_works_from_a_file(site, tmp_path):
    with chromium(tmp_path) as browser:
        browser.get((site / "fit.html").as_uri())
        browser.find_element("css selector", "input[type=search]").send_keys("RadialAttenuation")
        results = ".search-result > a"
        browser.implicitly_wait(10)  # until the index is loaded
        assert browser.find_element("css selector", results).is_displayed()
        places = [found.get_attribute("href") for found in browser.find_elements("css selector", results)]
        assert any(place.endswith("diffshade.html#RadialAttenuation") for place in places)
        browser.find_element("css selector", results).click()
        assert browser.current_url in places
