"""Places: where the numbers of a scene and its views are. What is asked of a number is asked of its place."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, TypeAlias

import numpy as np
from jaxtyping import Float

from ...core.fields import Array, Parameter, quantities
from ...model.scenes import Scene
from ..data.views import View

OF_RGB = ("red", "blue")  # gains of a sensor, which other bands have none of
OF_VIEWS = ("exposure", "black", "sensor")  # what can be free of a view


@dataclass(frozen=True)
class Place:
    """Where a number, a vector or a colour is; its path, such as `objects.0.material.k_d`, is its printed form."""

    owner: str
    """"objects", "lights" or "views"; "scene" for what the scene has besides."""
    item: int | None
    """Which of the objects, lights or views; None for the scene."""
    fields: tuple[str | int, ...]
    """The fields that lead there: ("material", "k_d")."""
    channel: int | None = None
    """Which number of a vector or a colour; None for all of them."""
    name: str = dataclasses.field(default="", compare=False)
    """An object's own name, which is printed in place of its number."""

    @cached_property
    def segments(self) -> tuple[str, ...]:
        """The segments of its path."""
        start = () if self.item is None else (self.owner, self.name or str(self.item))
        return (*start, *map(str, self.fields))

    @cached_property
    def path(self) -> str:
        """Its path, by which a user names it."""
        return ".".join(self.segments)

    def __str__(self) -> str:
        return self.path

    @property
    def part(self) -> str | int:
        """The part of its owner that has it: "surface", "material", "sensor", or a light's "position" itself."""
        return self.fields[0]

    @property
    def field(self) -> str | int:
        """The field that it is."""
        return self.fields[-1]

    @property
    def holder(self) -> tuple[str, int | None, tuple[str | int, ...]]:
        """What has the field; equal for places that are beside each other, such as k_d and k_s of one material."""
        return self.owner, self.item, self.fields[:-1]

    def beside(self, field: str) -> Place:
        """Return the place of another field of the same holder."""
        return dataclasses.replace(self, fields=(*self.fields[:-1], field))

    @property
    def whole(self) -> Place:
        """The place of the vector or colour that it is a number of."""
        return dataclasses.replace(self, channel=None)

    def at(self, channel: int) -> Place:
        """Return the place of one of its numbers."""
        return dataclasses.replace(self, channel=channel)

    def value_in(self, scene: Any, views: Any) -> Any:
        """Return what is there in a scene and its views, or in trees of their structure, whatever the channel."""
        node = scene if self.owner == "scene" else views if self.owner == "views" else getattr(scene, self.owner)
        for key in self.fields if self.item is None else (self.item, *self.fields):
            node = node[key] if isinstance(key, int) else getattr(node, key)
        return node


Known: TypeAlias = Mapping[Place, tuple[Array, dataclasses.Field]]
"""Everything that can be unknown: the value and the field of each place."""


def everything(scene: Scene, views: Sequence[View]) -> Iterator[tuple[Place, Array, dataclasses.Field]]:
    """Yield every number, vector and colour that can be unknown: its place, its value and its field."""
    for (owner, *rest), value, spec in quantities(scene):
        if owner not in ("objects", "lights"):
            yield Place("scene", None, (owner, *rest)), value, spec
            continue
        item = int(rest[0])
        name = scene.objects[item].name if owner == "objects" else ""
        yield Place(str(owner), item, tuple(rest[1:]), name=name), value, spec
    for i, view in enumerate(views):
        for fields, value, spec in quantities(view):
            if fields[0] in OF_VIEWS and not (scene.bands and spec.name in OF_RGB):
                yield Place("views", i, fields), value, spec


def numbers_of(value: Array, parameter: Parameter) -> Float[np.ndarray, " n"]:
    """Return the numbers of a value; of a direction those of the unit vector, the only part that has a meaning."""
    numbers = np.ravel(np.asarray(value, np.float64))
    return numbers / (np.linalg.norm(numbers) or 1.0) if parameter.role == "direction" else numbers
