"""What a fit is made of, as it is typed: a scene and its photographs, or a folder that holds both; and what is free."""

from __future__ import annotations

import contextlib
import functools
import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from .terminal import FILE, Bounds, Lit, Names, One

if TYPE_CHECKING:
    from ..inverse.data.views import View
    from ..inverse.result import Fit
    from ..model.scenes import Scene

FREE = ("k_a", "k_d", "k_s", "n_s")
LOBES = ("phong", "blinn")
LOSSES = ("squares", "huber", "cauchy", "geman-mcclure")

SOURCE = (
    click.argument("source", type=click.Path(path_type=Path)),
    click.argument("photos", nargs=-1, type=click.Path(path_type=Path)),
)
ENCODING = click.option("--srgb/--linear", default=None, help="Encoding of photos  [default: by kind of file]")
VIEWS = (
    click.option("--lit", type=Lit(), help="Lights on: each (default), all, or as in 0,1,0+1"),
    click.option("--mask", type=FILE, help="Pixels that count  [default: mask.png, the object's]"),
    ENCODING,
)
MODEL = (
    click.option("--free", type=Names(), default=FREE, help="What is not known  [default: k_a,k_d,k_s,n_s]"),
    click.option("--tied", type=Names(), default=(), help="One number for all lamps, such as attenuation"),
    click.option("--grey", type=Names(), default=(), help="Colours that are grey, such as k_s"),
    click.option("--bounds", type=Bounds(), multiple=True, help="May be given several times"),
    click.option("--loss", type=One(LOSSES), default="squares", help="squares (default), huber, cauchy, geman-mcclure"),
    click.option("--noise", type=float, metavar="SIGMA", help="Of a sample, 1 is white  [default: found]"),
)
LOBE = click.option("--lobe", type=One(LOBES), help="phong or blinn  [default: the scene's; phong]")
ROOM = click.option("--memory", type=float, metavar="GB", help="For pixels at work; more are read in bands")


@dataclass(frozen=True)
class Encodings:
    """What each photograph was read as: the kind of its file, and whether it was decoded from the sRGB curve."""

    read: tuple[tuple[str, bool], ...]
    asked: bool
    """Whether --srgb or --linear decided, rather than the kind of file."""

    @classmethod
    def of(cls, files: Iterable[Path], srgb: bool | None) -> Encodings:
        """Look at files that were read with `srgb`."""
        from ..io.images import read_as

        return cls(tuple(read_as(file, srgb=srgb) for file in files), srgb is not None)

    @property
    def names(self) -> tuple[str, ...]:
        """What each was read as, in a word."""
        return tuple(_curve(srgb) for _, srgb in self.read)

    def __str__(self) -> str:
        """Return one line, with the flag that would read them otherwise."""
        curves = sorted({srgb for _, srgb in self.read}, reverse=True)
        kinds = [Counter(kind for kind, srgb in self.read if srgb == curve) for curve in curves]
        listed = [", ".join(f"{count} {kind}" for kind, count in of.items()) for of in kinds]
        said = "; as ".join(f"{_curve(curve)}: {of}" for curve, of in zip(curves, listed, strict=True))
        other = " or ".join(f"--{_curve(not curve).lower()}" for curve in curves)
        return f"photographs read as {said} ({'as asked' if self.asked else f'by kind of file; {other} to change'})"


def _curve(srgb: bool) -> str:
    return "sRGB" if srgb else "linear"


@dataclass(frozen=True)
class Source:
    """A scene and its views, as read."""

    scene: Scene
    views: tuple[View, ...]
    names: tuple[str, ...]
    """A name of each view: its photograph's."""
    folder: Path | None
    """Where a folder of photographs is; None of a scene file."""
    encodings: Encodings


@dataclass(frozen=True)
class Asked:
    """What was typed."""

    source: Path
    photos: tuple[Path, ...]
    lit: Any = None
    mask: Path | None = None
    srgb: bool | None = None
    free: tuple[str, ...] = FREE
    tied: tuple[str, ...] = ()
    grey: tuple[str, ...] = ()
    bounds: tuple[tuple[str, list[float]], ...] = ()
    lobe: str | None = None
    loss: str = "squares"
    noise: float | None = None
    memory: float | None = None

    def read(self, *, normals: bool | None = True) -> Source:
        """Read the scene and the photographs; `normals`: as of `read_photographs`, None for those there are."""
        if self.memory is not None and not self.memory > 0:
            raise ValueError(f"--memory must be above 0 GB; got {self.memory:g}. Leave it out for what is usual.")
        if self.noise is not None and not self.noise > 0:
            raise ValueError(f"--noise must be above 0; got {self.noise:g}. Leave it out where it is not known.")
        found = self._of_folder(normals) if self.source.is_dir() else self._of_scene()
        return found if self.lobe is None else replace(found, scene=with_lobe(found.scene, self.lobe))

    def fit(self, source: Source, scene: Scene | None = None, **options: Any) -> Fit:
        """Fit what is free to the photographs; what goes wrong is said by the photographs' names."""
        import diffshade as ds

        if self.memory is not None:
            options["memory"] = self.memory * 1e9
        with by_name(source.names):
            return ds.fit(
                source.scene if scene is None else scene,
                source.views,
                free=self.free,
                tied=self.tied,
                bounds=dict(self.bounds),
                constraints=[ds.Grey(name) for name in self.grey],
                loss=self.loss,
                progress=True,
                **options,
            )

    def _of_folder(self, normals: bool | None) -> Source:
        from ..inverse.data.photographs import has_normals, mask_file, photograph_names, read_photographs

        for name, given in (("PHOTOS", self.photos), ("--lit", self.lit)):
            if given:
                raise ValueError(
                    f"{name} and a folder of photographs do not go together. Give a scene file, or leave it out."
                )
        if (near := self.source / "scene.toml").is_file() and not (self.source / "light_directions.txt").is_file():
            # as calibrate writes what a camera near by took
            photos = tuple(self.source / name for name in photograph_names(self.source))
            mask = self.mask or mask_file(self.source)
            return replace(self, source=near, photos=photos, mask=mask)._of_scene()
        shaped = has_normals(self.source) if normals is None else normals
        scene, views = read_photographs(self.source, normals=shaped, mask=self.mask, srgb=self.srgb)
        if self.noise is not None:
            views = tuple(replace(view, noise=self.noise) for view in views)
        names = tuple(photograph_names(self.source))
        encodings = Encodings.of((self.source / name for name in names), self.srgb)
        return Source(scene, views, names, self.source, encodings)

    def _of_scene(self) -> Source:
        import diffshade as ds

        from ..inverse.data.photographs import read_photograph

        if self.source.suffix.lower() != ".toml":
            there = "is neither" if self.source.exists() else "is not there"
            raise ValueError(
                f"SOURCE is a scene (.toml) or a folder of photographs; {self.source} {there}. Give one of them."
            )
        scene, camera = ds.read_scene(self.source), ds.read_camera(self.source)
        if not self.photos:
            raise ValueError(f"{self.source} needs photographs to be fitted to; got none. Give their files after it.")
        mask = None if self.mask is None else ds.read_mask(self.mask)
        views = []
        for path, lit in zip(self.photos, self._lights(scene), strict=True):
            try:
                image = read_photograph(path, srgb=self.srgb)
                views.append(ds.View(image, camera, mask, lit=lit, noise=self.noise))
            except (ValueError, TypeError) as error:
                raise ValueError(f"{error}" if f"{path}" in f"{error}" else f"{path}: {error}") from None
        encodings = Encodings.of(self.photos, self.srgb)
        return Source(scene, tuple(views), tuple(str(path) for path in self.photos), None, encodings)

    def _lights(self, scene: Scene) -> list[tuple[int, ...] | None]:
        """Return the lights that are on in each photograph."""
        photos, lights = len(self.photos), len(scene.lights)
        lit = self.lit or ("all" if photos == 1 else "each")
        if lit == "all":
            return [None] * photos
        if lit == "each":
            if photos != lights:
                raise ValueError(
                    f"{photos} photographs, each under one light, need as many lights; {self.source} has {lights}. "
                    "Give as many, or say which were on: --lit all, or for example --lit 0,1,0+1."
                )
            return [(i,) for i in range(photos)]
        if len(lit) != photos:
            raise ValueError(
                f"--lit must say the lights of each of the {photos} photographs; got {len(lit)}. Give for example "
                f"--lit {','.join(str(i % max(lights, 1)) for i in range(photos))}."
            )
        return list(lit)


def asked(*options: Callable[..., Any]) -> Callable[..., Any]:
    """Give a command a source and these options, as one `Asked`."""
    names = Asked.__dataclass_fields__

    def wrap(command: Callable[..., Any]) -> Callable[..., Any]:
        @functools.wraps(command)
        def run(**typed: Any) -> Any:
            own = {name: value for name, value in typed.items() if name not in names}
            return command(Asked(**{name: typed[name] for name in typed if name in names}), **own)

        for option in reversed([*SOURCE, *options]):
            run = option(run)
        return run

    return wrap


def with_lobe(scene: Scene, lobe: str) -> Scene:
    """Return a scene whose materials have another lobe."""
    import equinox as eqx

    import diffshade as ds

    shape = {"phong": ds.Phong, "blinn": ds.Blinn}[lobe]()
    return eqx.tree_at(lambda s: [item.material.lobe for item in s.objects], scene, [shape] * len(scene.objects))


@contextlib.contextmanager
def by_name(names: tuple[str, ...]) -> Iterator[None]:
    """Call a view by its photograph's name in what goes wrong."""
    try:
        yield
    except ValueError as error:
        raise ValueError(re.sub(r"views\[(\d+)\]", lambda found: names[int(found[1])], f"{error}")) from None
