"""JavaScript: the materials that code creates by `new THREE.MeshPhongMaterial({...})`, with values written out."""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterator
from typing import Any

from ..io.parsing import NUMBER, number, short, without_long_comments

_NEW = re.compile(r"(?:\b([\w$]{1,80})\s{0,9}[=:]\s{0,9})?\bnew\s{1,9}(?:THREE\.)?(\w{1,40}Material)\s{0,9}\(\s{0,9}")
_KEY = re.compile(r"\s*[\"']?([\w$]{1,80})[\"']?\s*:")
_HEX = re.compile(r"0[xX][0-9a-fA-F]{1,8}", re.ASCII)
_COLOUR = re.compile(r"(?:new\s+)?(?:THREE\.)?Color\(([^()]*)\)(?:\s*\.\s*(setRGB|setHex|set)\(([^()]*)\))?", re.ASCII)


class Expression(str):
    """Code that is no number, word or colour written out."""


def created(text: str, where: str) -> list[tuple[str, str, dict[str, Any]]]:
    """Return the materials that code creates, in their order: the variable of each, its class, and its settings.

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
        found.append((match.group(1) or "", match.group(2), settings))
    return found


def without_comments(text: str) -> str:
    """Return code without its comments; words in quotes may hold no //, but addresses as in http://."""
    return re.sub(r"(?<!:)//[^\n]*", " ", without_long_comments(text))


def _outside_quotes(text: str, start: int = 0) -> Iterator[tuple[int, str, int]]:
    """Yield each character outside words in quotes: its place, itself, and how many brackets are open after it."""
    depth, quote = 0, ""
    for i in range(start, len(text)):
        c = text[i]
        if quote:
            quote = "" if c == quote and text[i - 1] != "\\" else quote
        elif c in "\"'`":
            quote = c
        else:
            depth += (c in "([{") - (c in ")]}")
            yield i, c, depth


def _end_of(text: str, start: int, where: str) -> int:
    """Return where the bracket that opens at `start` is closed."""
    end = next((i for i, _, depth in _outside_quotes(text, start) if depth == 0), None)
    if end is None:
        raise ValueError(f"{where} ends within the settings of a material. Give the whole file.")
    return end


def _pairs(body: str) -> list[tuple[str, str]]:
    """Return the keys and values of an object literal's inside."""
    commas = [i for i, c, depth in _outside_quotes(body) if c == "," and depth == 0]
    found = []
    for start, end in itertools.pairwise([-1, *commas, len(body)]):
        part = body[start + 1 : end]
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
