"""Signatures as they are written: `Float[np.ndarray, "h w c"]`, not what Python makes of it."""

from __future__ import annotations

import ast
import dataclasses
import inspect
import re
import sys
import textwrap
from collections.abc import Callable, Collection, Iterator, Mapping
from typing import Any

import pdoc.doc


class Words:
    """A piece of source, to stand where Python has an object."""

    def __init__(self, text: str) -> None:
        self.text = text

    def __repr__(self) -> str:
        return self.text


def owner(doc: pdoc.doc.Doc[Any]) -> Any:
    """Return the public name that a member is of, or that it is."""
    return getattr(sys.modules[doc.modulename], doc.qualname.partition(".")[0])


def class_named(name: str) -> type | None:
    """Return a class of diffshade by its name, which no two have."""
    for module, of in list(sys.modules.items()):
        if module.startswith("diffshade.") and getattr(vars(of).get(name), "__module__", "") == module:
            return vars(of)[name] if inspect.isclass(vars(of)[name]) else None
    return None


def signature(doc: pdoc.doc.Function) -> inspect.Signature:
    """Return the signature of a function or method, or of a class for its constructor."""
    if doc.name == "__init__" and not _has_own_constructor(owner(doc)):
        return _of_class(owner(doc))
    function = inspect.unwrap(doc.obj if not isinstance(doc.obj, staticmethod | classmethod) else doc.obj.__func__)
    node = _source(function)
    written = {arg.arg: arg.annotation for arg in ast.walk(node) if isinstance(arg, ast.arg)}
    found = inspect.signature(function)
    parameters = [p.replace(annotation=_words(written[name])) for name, p in found.parameters.items() if name != "self"]
    return inspect.Signature(parameters, return_annotation=_words(node.returns))


def annotation(doc: pdoc.doc.Variable) -> str:
    """Return the annotation of a field or a property, with the colon before it; "" where there is none."""
    if "." not in doc.qualname:
        return ""
    member = inspect.getattr_static(owner(doc), doc.name, None)
    getter = getattr(member, "fget", None) or getattr(member, "func", None)
    node = _source(getter).returns if getter else dict(_fields(owner(doc))).get(doc.name)
    return f": {ast.unparse(node)}" if node else ""


def _has_own_constructor(cls: type) -> bool:
    return any(isinstance(line, ast.FunctionDef) and line.name == "__init__" for line in _source(cls).body)


def _of_class(cls: type) -> inspect.Signature:
    written, fields = dict(_fields(cls)), {field.name: field for field in dataclasses.fields(cls)}
    parameters = []
    for name, parameter in inspect.signature(cls).parameters.items():
        made: Any = fields[name].default_factory
        default = parameter.default if made is dataclasses.MISSING else Words(f"{made.__name__}()")
        parameters.append(parameter.replace(annotation=_words(written[name]), default=default))
    return inspect.Signature(parameters)


def _fields(cls: type) -> Iterator[tuple[str, ast.expr]]:
    """The annotated fields of a class and, before them, of its bases."""
    for base in reversed(cls.__mro__):
        if base.__module__.startswith("diffshade."):
            for line in _source(base).body:
                if isinstance(line, ast.AnnAssign) and isinstance(line.target, ast.Name):
                    yield line.target.id, line.annotation


def _source(thing: type | Callable[..., Any]) -> Any:
    return ast.parse(textwrap.dedent(inspect.getsource(thing))).body[0]


def _words(node: ast.expr | None) -> Any:
    return inspect.Parameter.empty if node is None else Words(ast.unparse(node))


def link_names(html: str, pages: Mapping[str, Collection[str]]) -> str:
    """Link those names that are highlighted and stand on the page of a module."""

    def link(found: re.Match[str]) -> str:
        name = found[1]
        page = next((f"{module}.html" for module, names in pages.items() if name in names), None)
        return f'<a href="{page}#{name}">{name}</a>' if page else found[0]

    return re.sub(r'<span class="n[nc]?">(\w+)</span>', link, html)
