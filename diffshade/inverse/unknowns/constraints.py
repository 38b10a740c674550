"""Constraints: what a user knows about free numbers beside their bounds."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Grey:
    """The channels of `name` are equal: one unknown for the three of each colour (or of each n_s with three).

    `name`: any run of whole segments of a dotted path, as in `fit`; it must be free.
    """

    name: str


@dataclass(frozen=True)
class Proportional:
    r"""A number is proportional to another one, channel by channel.

    $$ name = factor \cdot to $$

    `name`, `to`: runs of whole segments of a dotted path, as in `fit`. Without a factor, it is an unknown, at least 0.

    `Proportional("k_s", "k_d")` is a highlight of the surface's own colour. With a factor, `name` is fixed by this
    constraint and must not be free.
    """

    name: str
    to: str
    factor: float | None = None
