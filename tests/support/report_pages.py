"""Report pages taken apart, and lights of every kind for their live ball."""

import base64
import hashlib
from html.parser import HTMLParser

import diffshade as ds

FADING = ds.RadialAttenuation(0.5, 0.1, 0.05, clamp=True)
LIGHTS = (
    ds.PointLight((2, 2, 3), 9.0, ds.RadialAttenuation(1.0, 0.1, 0.5)),
    ds.DirectionalLight((1, -1, -1), (0.7, 0.6, 0.5)),
    ds.SpotLight((0.5, 1.5, 3), (0, -0.5, -1), 1.2, cutoff=25, exponent=3, softness=8, attenuation=FADING),
    ds.AreaLight((-2, 1, 2), (1, 0, 0), (0, -0.6, 0.8), 0.8, samples=(3, 2)),
)


class Page(HTMLParser):
    """A page taken apart: its elements with their attributes, and the text in each."""

    def __init__(self, path):
        super().__init__()
        self.elements, self.open = [], []
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag, attrs):
        self.elements.append((tag, dict(attrs), []))
        if tag not in ("meta", "link", "img", "input", "wbr"):
            self.open.append(self.elements[-1])

    def handle_endtag(self, tag):
        assert self.open.pop()[0] == tag

    def handle_data(self, data):
        if self.open:
            self.open[-1][2].append(data)

    def all(self, tag):
        return [(attributes, "".join(text)) for name, attributes, text in self.elements if name == tag]

    def scripts(self):
        """Return the programs, but not the data that stand in tags of scripts."""
        return [text for attributes, text in self.all("script") if "type" not in attributes]

    def assert_it_runs_its_own_scripts_alone(self):
        """Assert that it asks for nothing from elsewhere, by its policy and by its elements."""
        (policy,) = [a["content"] for a, _ in self.all("meta") if a.get("http-equiv") == "Content-Security-Policy"]
        assert policy.startswith("default-src 'none'; img-src data:;")
        assert "unsafe" not in policy
        for text in self.scripts() + [text for _, text in self.all("style")]:
            digest = base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()
            assert f"'sha256-{digest}'" in policy
        for tag, attributes, _ in self.elements:
            assert not [name for name in attributes if name.startswith("on") or name == "style"]
            for name in ("src", "href"):
                assert attributes.get(name, "data:").startswith("data:"), tag
