"""Build the documentation: python docs/build.py [FOLDER], by default output/docs. Any warning ends it.

The pages are pdoc's, from the docstrings and the README. Mathematics becomes MathML here, so that a page runs no script
of anyone else's, fetches nothing and opens offline. The topics are those of diffshade's own docstring.
"""

from __future__ import annotations

import argparse
import re
import warnings
from pathlib import Path

try:
    import latex2mathml.converter  # noqa: F401 - for the formulas of pdoc
    import pdoc.doc
    import pdoc.render
    import pdoc.render_helpers
    import written
    from markupsafe import Markup
    from pdoc.docstrings import embed_images
    from pygments.formatters import HtmlFormatter

    import diffshade as ds
except ModuleNotFoundError as error:
    package = (error.name or "").partition(".")[0]
    raise SystemExit(f"the documentation needs {package}, which is not here. Run pip install -e '.[docs]'.") from None

ROOT = Path(__file__).resolve().parents[1]
# what the README links to, and the README
TEXTS = {
    "README.md": "index.html",
    "CONTRIBUTING.md": "contributing.html",
    "CHANGELOG.md": "changelog.html",
    "benchmarks/SCALING.md": "scaling.html",
}


def topics() -> dict[str, list[str]]:
    """Return the public names by topic, as the package's docstring lists them."""
    _, *parts = re.split(r"^## (.+)\n", ds.__doc__ or "", flags=re.MULTILINE)
    return {topic: re.findall(r"`(\w+)`", text) for topic, text in zip(parts[::2], parts[1::2], strict=True)}


def is_shown(doc: pdoc.doc.Doc) -> bool:
    """Whether a member of a class stands on the page: what a user calls or reads, not how classes work together."""
    owner = getattr(ds, doc.qualname.partition(".")[0])
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
    """Return Markdown as HTML; letters that are a word in a formula, such as f_{rad}, are set as one."""
    words = r"(?:<mi>[a-z]</mi>){3,}|(?:<mi>[a-z]</mi>){2}(?=</mrow>)"
    html = pdoc.render_helpers.to_html(markdown)
    return Markup(re.sub(words, lambda word: word[0].replace("</mi><mi>", ""), html))


def text(source: str) -> str:
    """Return one of the repository's texts with its pictures within and its links to the pages here."""
    path = ROOT / source
    found = embed_images(path.read_text(encoding="utf-8"), path)
    for other, page in TEXTS.items():
        found = found.replace(f"]({other})", f"]({page})")
    return found


def build(folder: Path) -> None:
    """Write every page."""
    names = [name for some in topics().values() for name in some]
    ds.__all__ = names  # what pdoc shows  # pyright: ignore[reportAttributeAccessIssue]
    pdoc.render_helpers.markdown_extensions["latex"] = None
    pdoc.render.env.tests["shown"] = is_shown
    pdoc.render.env.filters |= {
        "signature": written.signature,
        "annotation": written.annotation,
        "to_html": to_html,
        "link_names": lambda html: Markup(written.link_names(html, names)),
    }
    dark = HtmlFormatter(style="github-dark").get_style_defs(".pdoc-code")
    pdoc.render.env.globals |= {"topics": topics(), "dark_code": Markup(dark)}
    pdoc.render.configure(docformat="markdown", search=False, show_source=False, template_directory=ROOT / "docs")
    module = pdoc.doc.Module(ds)
    (folder / "diffshade.html").write_text(pdoc.render.html_module(module, {"diffshade": module}), encoding="utf-8")
    page = pdoc.render.env.get_template("text.html.jinja2")
    for source, name in TEXTS.items():
        html = pdoc.render_helpers.to_html(text(source))
        (folder / name).write_text(page.render(html=html, here=name), encoding="utf-8")


def main() -> None:
    """Read the arguments, build, and say where."""
    parser = argparse.ArgumentParser(description="Build the documentation.")
    parser.add_argument("folder", nargs="?", type=Path, default=ROOT / "output" / "docs")
    folder = parser.parse_args().folder
    if Path(ds.__file__).parents[1] != ROOT:
        raise SystemExit(
            f"the diffshade to document is not in this clone but {ds.__file__}. Run pip install -e '.[docs]'."
        )
    folder.mkdir(parents=True, exist_ok=True)
    warnings.simplefilter("error")
    build(folder)
    print(folder / "index.html")


if __name__ == "__main__":
    main()
