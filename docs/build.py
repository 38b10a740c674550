"""Build the documentation: python docs/build.py [FOLDER] [--figures NAME ...]. Any warning ends it.

The figures of the lectures take two minutes; `--figures snell` shows one of them, and `--figures` none.

pdoc makes the pages from the docstrings, the README and the Markdown files in docs/pages and docs/studies. Mathematics
becomes MathML at build time. A page fetches nothing and opens offline: the only scripts are pdoc's search box and its
index, search.js, beside the pages, as the figures are. The topics are those of diffshade's own docstring.
"""

from __future__ import annotations

import argparse
import importlib
import inspect
import json
import os
import re
import warnings
from collections.abc import Collection, Iterable, Iterator, Mapping
from html import escape, unescape
from pathlib import Path
from types import ModuleType

try:
    import latex2mathml.converter  # noqa: F401 - for the formulas of pdoc
    import pdoc.doc
    import pdoc.render
    import pdoc.render_helpers
    import written
    from markupsafe import Markup
    from pdoc.docstrings import embed_images, google
    from pygments.formatters import HtmlFormatter

    import diffshade as ds
    from diffshade.report.lecture import FIGURES
    from diffshade.report.lecture.dark import darken
except ModuleNotFoundError as error:
    package = (error.name or "").partition(".")[0]
    raise SystemExit(f"the documentation needs {package}, which is not here. Run pip install -e '.[docs]'.") from None

ROOT = Path(__file__).resolve().parents[1]
NAMES = "diffshade.html"
LECTURES = "lectures.html"  # the page that shows the figures, which lie in a folder beside the pages
# the texts, in the order of the menu: file, page, title
TEXTS = (
    ("README.md", "index.html", "Overview"),
    ("docs/pages/install.md", "install.html", "Installing"),
    ("docs/pages/command-line.md", "command-line.html", "The command line"),
    ("docs/pages/render.md", "render.html", "Rendering"),
    ("docs/pages/fit.md", "fit.html", "Fitting photographs"),
    ("docs/pages/trust.md", "trust.html", "How far to trust a fit"),
    ("docs/pages/calibration.md", "calibration.html", "Calibrating lights"),
    ("docs/pages/texels.md", "texels.html", "Texels"),
    ("docs/pages/heights.md", "heights.html", "Heights and meshes"),
    ("docs/pages/exchange.md", "exchange.html", "Other programs"),
    ("docs/pages/objective.md", "objective.html", "An objective of your own"),
    ("docs/pages/extend.md", "extend.html", "Your own lobe, light or law"),
    ("docs/pages/large-images.md", "large-images.html", "Large images, devices"),
    ("docs/pages/accuracy-and-speed.md", "accuracy-and-speed.html", "Accuracy and speed"),
    ("benchmarks/SCALING.md", "scaling.html", "Cost of a pixel"),
    ("docs/pages/lectures.md", LECTURES, "The lectures"),
    ("CONTRIBUTING.md", "contributing.html", "Working on it"),
    ("docs/pages/versions.md", "versions.html", "Versions"),
    ("CHANGELOG.md", "changelog.html", "Changes"),
)
ROOMS = {
    "lights": "Lights of photographs",
    "lamps": "Measured lamps",
    "heights": "Heights",
    "exchange": "Files of other programs",
    "lecture": "Figures of a lecture",
    "extension": "Parts of your own",
}
# what was measured, and how rules were chosen; pages link to them, and the menu does not list them
STUDIES = tuple(
    (path.relative_to(ROOT).as_posix(), f"{path.stem}.html", path.read_text(encoding="utf-8").partition("\n")[0][2:])
    for path in sorted((ROOT / "docs" / "studies").glob("*.md"))
)


def topics() -> dict[str, list[str]]:
    """Return the public names at the top by topic, as the package's docstring lists them."""
    _, *parts = re.split(r"^## (.+)\n", ds.__doc__ or "", flags=re.MULTILINE)
    found = {topic: re.findall(r"`(\w+)`", text) for topic, text in zip(parts[::2], parts[1::2], strict=True)}
    return {topic: names for topic, names in found.items() if topic != "Rooms"}


def public_names(room: ModuleType) -> list[str]:
    """Return the names that a public module offers."""
    names = [name for name, of in vars(room).items() if not name.startswith("_") and not inspect.ismodule(of)]
    return getattr(room, "__all__", names)


def modules() -> dict[str, dict[str, list[str]]]:
    """Return the names that stand on the page of each public module, by topic, with the results of its functions.

    A result that nobody constructs is not a public name: it is documented after what returns it.
    """
    found = {"diffshade": topics()}
    for room, title in ROOMS.items():
        found[f"diffshade.{room}"] = {title: public_names(getattr(ds, room))}
    public = {name for by_topic in found.values() for names in by_topic.values() for name in names}
    for module, by_topic in found.items():
        home = importlib.import_module(module)
        for topic, names in by_topic.items():
            by_topic[topic] = [of for name in names for of in (name, *_results(home, name, public))]
        shown = [name for names in by_topic.values() for name in names]
        vars(home).update({name: getattr(home, name) for name in shown}, __all__=shown)  # what pdoc shows
    return found


def _results(home: ModuleType, name: str, public: set[str]) -> Iterator[str]:
    """Put the classes that a name returns, and that are not documented yet, into its module, and yield their names."""
    owner = getattr(home, name)
    for member in [owner] if inspect.isfunction(owner) else vars(owner).values() if inspect.isclass(owner) else []:
        returned = member.__annotations__.get("return", "") if inspect.isfunction(member) else ""
        for word in re.findall(r"\w+", str(returned)):
            made = written.class_named(word)
            if made is not None and word not in public and not word.startswith("Abstract"):
                public.add(word)
                setattr(home, word, made)
                yield from (word, *_results(home, word, public))


def is_shown(doc: pdoc.doc.Doc) -> bool:
    """Whether a member of a class stands on the page: what a user calls or reads, not how classes work together."""
    owner = written.owner(doc)
    made_by_user = hasattr(owner, "check_together")
    if "." not in doc.qualname:
        return True
    if doc.name == "__init__":
        return made_by_user
    if doc.name.startswith("_") or any(doc.name in vars(base) for base in owner.__mro__[1:]):
        return False
    # the constructor of what a user makes shows its fields
    return doc.kind != "variable" or bool(doc.docstring) or not made_by_user


def to_html(markdown: str) -> Markup:
    """Return Markdown as HTML. In a formula, letters that are a word, such as f_{rad}, become one identifier.

    A displayed formula gets a box of its own, which scrolls where the formula is wider than the page.
    """
    words = r"(?:<mi>[a-z]</mi>){3,}|(?:<mi>[a-z]</mi>){2}(?=</mrow>)"
    html = pdoc.render_helpers.to_html(markdown)
    html = re.sub(words, lambda word: word[0].replace("</mi><mi>", ""), html)
    boxed = r'<math[^>]* display="block".*?</math>'
    return Markup(re.sub(boxed, r'<span class="formula">\g<0></span>', html, flags=re.DOTALL))


def docstring_html(docstring: str) -> Markup:
    """Return a docstring as HTML: Markdown with Google's sections, such as `Args:`, each a list under its name."""
    return to_html(re.sub(r"^###### (\w+:)$", r"**\1**\n", google(docstring), flags=re.MULTILINE))


def text(source: str) -> str:
    """Return one of the repository's texts with its pictures embedded and its links leading to the pages here."""
    path = ROOT / source
    pages = {file: page for file, page, _ in (*TEXTS, *STUDIES)}

    def link(found: re.Match[str]) -> str:
        file = os.path.normpath(path.parent.relative_to(ROOT) / found[1])
        return f"]({pages.get(Path(file).as_posix(), found[1])}{found[2] or ''})"

    found = embed_images(path.read_text(encoding="utf-8"), path)
    return re.sub(r"\]\(([\w./-]+\.md)(#[\w-]+)?\)", link, found)


def draw(folder: Path, figures: Iterable[str]) -> None:
    """Draw the figures of the lectures, each for a light page and for a dark one."""
    (folder / "figures").mkdir(exist_ok=True)
    for name in figures:
        figure = ds.lecture.draw_figure(name)
        figure.savefig(folder / "figures" / f"{name}.png")
        darken(figure).savefig(folder / "figures" / f"{name}-dark.png")


def with_figures(markdown: str, figures: Iterable[str]) -> str:
    """Link the names of figures to the pictures, which are put at the end of the text."""
    shown = ["", "## Figures", ""]
    for name in figures:
        markdown = markdown.replace(f"`{name}`", f"[`{name}`](#figure-{name})")
        what = (FIGURES[name].__doc__ or "").removeprefix("Draw ").partition(".\n")[0]
        dark = f'<source srcset="figures/{name}-dark.png" media="(prefers-color-scheme: dark)">'
        picture = f'<picture>{dark}<img src="figures/{name}.png" alt="{escape(what)}" loading="lazy"></picture>'
        shown += [f'<figure id="figure-{name}">{picture}<figcaption><code>{name}</code></figcaption></figure>', ""]
    return markdown + "\n".join(shown)


def link_code(html: str, pages: Mapping[str, Collection[str]]) -> str:
    """Link code such as `ds.fit` to the entry of its name, and let long names break after a dot or an underscore."""

    def link(found: re.Match[str]) -> str:
        room, name = (f"diffshade.{found[1]}", found[2]) if found[1] else ("diffshade", found[2])
        is_named = name.partition(".")[0] in pages[room]
        return f'<a href="{room}.html#{name}">{found[0]}</a>' if is_named else found[0]

    html = re.sub(rf"<code>ds\.(?:({'|'.join(ROOMS)})\.)?(\w+(?:\.\w+)?)[^<]*</code>", link, html)
    return re.sub(r"<code>[\w.]{16,}</code>", lambda code: re.sub(r"(?<!>ds)[._]", r"\g<0><wbr>", code[0]), html)


def member_entries(doc: pdoc.doc.Doc) -> Iterator[dict[str, str]]:
    """Yield what the search finds of a public name and of its members."""
    entry = {"fullname": doc.fullname, "modulename": doc.modulename, "qualname": doc.qualname, "kind": doc.kind}
    entry["doc"] = docstring_html(doc.docstring)
    if isinstance(doc, pdoc.doc.Function):
        entry["signature"] = pdoc.render_helpers.format_signature(written.signature(doc), colon=False)
        entry["funcdef"] = doc.funcdef
    yield entry
    if isinstance(doc, pdoc.doc.Class):
        for member in doc.own_members:
            if is_shown(member):
                yield from member_entries(member)


def text_entries(html: str, page: str, title: str) -> Iterator[dict[str, str]]:
    """Yield what the search finds of a text: its sections."""
    seen: dict[str, int] = {}
    plain = re.sub(r"<img[^>]*>", "", html)
    for place, heading, body in re.findall(r'<h\d id="([^"]*)">(.*?)</h\d>(.*?)(?=<h\d id=|\Z)', plain, re.DOTALL):
        name = f"{title}: {unescape(re.sub('<[^>]*>', '', heading))}"
        seen[name] = seen.get(name, 0) + 1
        name += f" ({seen[name]})" if seen[name] > 1 else ""  # the index keeps one entry a name
        entry = {"fullname": name, "modulename": page.removesuffix(".html"), "qualname": place}
        yield {**entry, "kind": "text", "doc": body.strip()}


def build(folder: Path, figures: Collection[str]) -> None:
    """Write every page, the figures, and the index of the search."""
    draw(folder, figures)
    found = modules()
    names = {module: {name for of in by_topic.values() for name in of} for module, by_topic in found.items()}
    pdoc.render_helpers.markdown_extensions["latex"] = None
    pdoc.render.env.tests["shown"] = is_shown
    pdoc.render.env.filters |= {
        "signature": written.signature,
        "annotation": written.annotation,
        "to_html": docstring_html,
        "link_names": lambda html: Markup(written.link_names(html, names)),
    }
    dark = HtmlFormatter(style="github-dark").get_style_defs(".pdoc-code")
    menu = [(page, title) for _, page, title in TEXTS]
    menu[1:1] = [(f"{module}.html", "Names at the top" if module == "diffshade" else module[10:]) for module in found]
    pdoc.render.env.globals |= {"dark_code": Markup(dark), "menu": menu, "module": None}
    pdoc.render.configure(docformat="markdown", show_source=False, template_directory=ROOT / "docs")
    entries: list[dict[str, str]] = []
    for name, by_topic in found.items():
        pdoc.render.env.globals |= {"topics": by_topic, "page": f"{name}.html"}
        module = pdoc.doc.Module(importlib.import_module(name))
        (folder / f"{name}.html").write_text(pdoc.render.html_module(module, {name: module}), encoding="utf-8")
        entries += [entry for of in names[name] for entry in member_entries(module.members[of])]
    template = pdoc.render.env.get_template("text.html.jinja2")
    for source, page, title in (*TEXTS, *STUDIES):
        markdown = with_figures(text(source), figures) if page == LECTURES else text(source)
        html = link_code(to_html(markdown), names)
        contents = getattr(pdoc.render_helpers.to_html(markdown), "toc_html", "")
        filled = template.render(html=html, contents=contents, here=page, title=title)
        (folder / page).write_text(filled, encoding="utf-8")
        entries += text_entries(html, page, title)
    index = pdoc.render.env.get_template("search.js.jinja2").render(search_index=json.dumps(entries))
    (folder / "search.js").write_text(index, encoding="utf-8")


def main() -> None:
    """Read the arguments, build, and say where."""
    parser = argparse.ArgumentParser(description="Build the documentation.")
    parser.add_argument("folder", nargs="?", type=Path, default=ROOT / "output" / "docs")
    parser.add_argument("--figures", nargs="*", choices=FIGURES, default=FIGURES, help="to show  [default: all]")
    arguments = parser.parse_args()
    folder = arguments.folder
    if Path(ds.__file__).parents[1] != ROOT:
        raise SystemExit(
            f"the diffshade to document is not in this clone but {ds.__file__}. Run pip install -e '.[docs]'."
        )
    folder.mkdir(parents=True, exist_ok=True)
    warnings.simplefilter("error")
    build(folder, arguments.figures)
    print(folder / "index.html")


if __name__ == "__main__":
    main()
