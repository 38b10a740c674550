"""Words: notes, and the small phrases that messages are made of."""

from __future__ import annotations

import contextlib
import difflib
import itertools
import re
from collections.abc import Container, Iterable, Iterator, Sequence

MAX_NAMED = 3  # things that a message names; of more it gives the number
MAX_LETTERS = 60  # of a name


class Note(str):
    """A sentence of a result about what is not known, with what it is about.

    `kind`: a word or two by which code tells notes apart, such as "lost in noise". `names`: the unknowns or views that
    it names, where there are some.
    """

    kind: str
    names: tuple[str, ...]

    def __new__(cls, text: str, kind: str, names: tuple[str, ...] = ()) -> Note:
        note = super().__new__(cls, text)
        note.kind, note.names = kind, names
        return note

    def __reduce__(self) -> tuple[type, tuple[str, str, tuple[str, ...]]]:
        return Note, (str(self), self.kind, self.names)


def with_article(noun: str) -> str:
    """Return a noun with "a" or "an" before it."""
    return f"{'an' if noun[0] in 'AEIOUaeiou' else 'a'} {noun}"


def did_you_mean(word: str, options: Iterable[str]) -> str:
    """Return the sentence that follows a wrong name: the nearest right one, or all of them but whole paths."""
    options = sorted(set(options))
    # NoFresnel is no other spelling of fresnel, but its opposite
    meant = [o for o in options if word.lower().startswith("no") or not re.match("No[A-Z]", o)]
    lower = {option.lower(): option for option in meant}
    near = difflib.get_close_matches(word.lower(), lower, n=1, cutoff=0.5)
    short = ", ".join(option for option in options if "." not in option[1:] and "*" not in option)
    return f"Did you mean '{lower[near[0]]}'?" if near else f"Known names: {short}."


@contextlib.contextmanager
def errors_at(where: str) -> Iterator[None]:
    """Let an error begin with where it is, unless it does already: what is made of a file's values does not know it."""
    try:
        yield
    except (TypeError, ValueError) as error:
        said = str(error)
        raise ValueError(said if said.startswith(where) else f"{where}: {said}") from None


def unused(name: str, taken: Container[str]) -> str:
    """Return a name that is not taken: with a number after it if need be."""
    numbered = (f"{name}_{i}" for i in itertools.count(2))
    return next(of for of in itertools.chain([name], numbered) if of not in taken)


def listing(names: Sequence[str]) -> str:
    """Return names as a phrase: a, b and c."""
    return " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)


def first_of(things: Sequence[str]) -> str:
    """Return the first of some things as a phrase, and the number of the others."""
    more = f", and {len(things) - MAX_NAMED} more" if len(things) > MAX_NAMED else ""
    return ", ".join(things[:MAX_NAMED]) + more


def count(number: int, noun: str) -> str:
    """Return a number and what it counts."""
    return f"{number:,} {noun}{'' if number == 1 else 's'}"


def with_names(text: str, names: Sequence[str]) -> str:
    """Return a text with photographs' names in place of views[0], views[1] and so on."""
    return re.sub(r"views\[(\d+)\]", lambda found: names[int(found[1])], text)
