"""JavaScript: the materials that code creates by `new THREE.MeshPhongMaterial({...})`, with values written out."""

from __future__ import annotations

import re
from typing import Any, NamedTuple

from ..io.parsing import NUMBER, number, short

_NEW = re.compile(r"(?:\b([\w$]{1,80})\s{0,9}[=:]\s{0,9})?\bnew\s{1,9}(?:THREE\.)?(\w{1,40}Material)\s{0,9}\(\s{0,9}")
_KEY = re.compile(r"\s*[\"']?([\w$]{1,80})[\"']?\s*:")
_HEX = re.compile(r"0[xX][0-9a-fA-F]{1,8}", re.ASCII)
_COLOUR = re.compile(r"(?:new\s+)?(?:THREE\.)?Color\(([^()]*)\)(?:\s*\.\s*(setRGB|setHex|set)\(([^()]*)\))?", re.ASCII)
_CLOSING = {"{": "}", "[": "]", "(": ")"}


class Expression(str):
    """Code that is no number, word or colour written out."""


class Created(NamedTuple):
    """A material that code creates: the variable it is assigned to, its class, and its settings."""

    variable: str
    kind: str
    settings: dict[str, Any]


def created(text: str, where: str) -> list[Created]:
    """Return the materials that code creates, in their order.

    A value is a number, a word, true or false, a list of three linear numbers (`new THREE.Color().setRGB(r, g, b)`),
    or an `Expression`.
    """
    text = without_comments(text)
    found, at = [], 0
    while match := _NEW.search(text, at):
        at = match.end()
        settings: dict[str, Any] = {}
        if text.startswith("{", at):
            end = _end_of(text, at, where)
            settings = {key: _value(value, f"{where}: {key}") for key, value in _pairs(text[at + 1 : end])}
            at = end
        found.append(Created(match.group(1) or "", match.group(2), settings))
    return found


def without_comments(text: str) -> str:
    """Return code without its comments; words in quotes may hold no //, but addresses as in http://."""
    first, *comments = text.split("/*")  # a regular expression would take quadratic time
    text = " ".join([first, *(comment.partition("*/")[2] for comment in comments)])
    return re.sub(r"(?<!:)//[^\n]*", " ", text)


def _end_of(text: str, start: int, where: str) -> int:
    """Return where the bracket that opens at `start` is closed."""
    open_, quote = [], ""
    for i in range(start, len(text)):
        c = text[i]
        if quote:
            quote = "" if c == quote and text[i - 1] != "\\" else quote
        elif c in "\"'`":
            quote = c
        elif c in _CLOSING:
            open_.append(_CLOSING[c])
        elif open_ and c == open_[-1]:
            open_.pop()
            if not open_:
                return i
    raise ValueError(f"{where} ends within the settings of a material. Give the whole file.")


def _pairs(body: str) -> list[tuple[str, str]]:
    """Return the keys and values of an object literal's inside."""
    parts, start, depth, quote = [], 0, 0, ""
    for i, c in enumerate(body):
        if quote:
            quote = "" if c == quote and body[i - 1] != "\\" else quote
        elif c in "\"'`":
            quote = c
        elif c in "([{":
            depth += 1
        elif c in ")]}":
            depth -= 1
        elif c == "," and depth == 0:
            parts.append(body[start:i])
            start = i + 1
    parts.append(body[start:])
    found = []
    for part in parts:
        if key := _KEY.match(part):
            found.append((key.group(1), part[key.end() :].strip()))
        elif part.strip():
            found.append((part.strip()[:80], part.strip()))  # a spread, or a variable of the same name
    return found


def _value(text: str, where: str) -> Any:
    if NUMBER.fullmatch(text):
        return number(text, where)
    if _HEX.fullmatch(text):
        return int(text, 16)
    if text in ("true", "false"):
        return text == "true"
    if len(text) >= 2 and text[0] == text[-1] and text[0] in "\"'`":
        return text[1:-1]
    if colour := _COLOUR.fullmatch(text):
        first, method, second = colour.groups()
        return _colour(text, first if method is None else second, where)
    return Expression(text)


def _colour(text: str, inside: str, where: str) -> Any:
    """Return the value of a THREE.Color: a number or word of sRGB, or linear numbers."""
    words = [word.strip() for word in inside.split(",")]
    if len(words) == 1 and words[0]:
        return _value(words[0], where)
    if words[3:] not in ([], ["THREE.LinearSRGBColorSpace"], ["LinearSRGBColorSpace"]) or len(words) < 3:
        return Expression(text)
    if not all(map(NUMBER.fullmatch, words[:3])):
        raise ValueError(
            f"{where} must be three numbers and LinearSRGBColorSpace; got {short(inside)}. Correct the file."
        )
    return [number(word, where) for word in words[:3]]
