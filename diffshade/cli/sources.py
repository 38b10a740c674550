"""The input of a fit on the command line: a scene and photographs, or a folder with both; and the options."""

from __future__ import annotations

import contextlib
import functools
import logging
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ..core.words import with_names
from .terminal import BOUNDS, FILE, LIGHTS_ON, NAMES, OneOf

if TYPE_CHECKING:
    import numpy as np

    import diffshade as ds

    from ..io.images import ReadAs

_LOGGER = logging.getLogger("diffshade")
FREE = ("k_a", "k_d", "k_s", "n_s")
LOBES = ("phong", "blinn")
LOSSES = ("squares", "huber", "cauchy", "geman-mcclure")

SOURCE = (
    click.argument("source", type=click.Path(path_type=Path)),
    click.argument("photos", nargs=-1, type=click.Path(path_type=Path)),
)
ENCODING = click.option("--srgb/--linear", default=None, help="Encoding of photos  [default: by the file]")
EXIF = click.option("--no-exif", is_flag=True, help="Ignore the exposures that a folder's files state")
VIEWS = (
    click.option("--lit", type=LIGHTS_ON, help="each (default: one per photo), all, or 0,1,0+1"),
    click.option("--mask", type=FILE, help="Pixels to use  [default: mask.png, or the object]"),
    ENCODING,
    EXIF,
)
MODEL = (
    click.option("--free", type=NAMES, default=FREE, help="Parameters to fit  [default: k_a,k_d,k_s,n_s]"),
    click.option("--tied", type=NAMES, default=(), help="Parameters that all lamps share, as attenuation"),
    click.option("--grey", type=NAMES, default=(), help="Colours to keep grey, such as k_s"),
    click.option("--bounds", type=BOUNDS, multiple=True, help="Range of a parameter; may be repeated"),
    click.option(
        "--loss", type=OneOf(LOSSES), default="squares", help="squares (default), huber, cauchy, geman-mcclure"
    ),
    click.option("--noise", type=float, metavar="SIGMA", help="Standard deviation, white = 1  [default: fitted]"),
)
LIGHT_ERROR = click.option(
    "--light-error", type=float, metavar="DEGREES", help="Error of light directions  [default: the folder's]"
)
INTENSITY_ERROR = click.option(
    "--intensity-error", type=float, metavar="SHARE", help="Error of intensities, 0.05 for 5 %  [default: none]"
)
LOBE = click.option("--lobe", type=OneOf(LOBES), help="phong or blinn  [default: the scene's; phong]")
ROOM = click.option("--memory", type=float, metavar="GB", help="Memory for pixels; if exceeded, read in bands")


@dataclass(frozen=True)
class Encodings:
    """The file type of each photograph, and the encoding that it was read as."""

    read: tuple[tuple[str, str], ...]
    why: str
    """What decided: the file type, the file's own statement, or --srgb or --linear."""

    @classmethod
    def of(cls, taken: Sequence[ReadAs], srgb: bool | None) -> Encodings:
        """Return the encodings of files that were read with `srgb`."""
        stated = [of.statement.encoding is not None for of in taken]
        own = "as the files state" if all(stated) else "as stated, or by file type" if any(stated) else "by file type"
        return cls(tuple((of.kind, of.encoding.name) for of in taken), "as requested" if srgb is not None else own)

    @property
    def names(self) -> tuple[str, ...]:
        """The encoding of each photograph: sRGB, linear, or the name of a colour profile."""
        return tuple(encoding for _, encoding in self.read)

    def __str__(self) -> str:
        """Return one line, with the flag for the other encoding."""
        encodings = sorted(set(self.names), key=["sRGB", "linear", *sorted(self.names)].index)
        kinds = [Counter(kind for kind, encoding in self.read if encoding == of) for of in encodings]
        listed = [", ".join(f"{count} {kind}" for kind, count in of.items()) for of in kinds]
        read = "; as ".join(f"{encoding}: {files}" for encoding, files in zip(encodings, listed, strict=True))
        flags = {"sRGB": "--linear", "linear": "--srgb"}
        other = " or ".join(dict.fromkeys(flags.get(encoding, "--srgb or --linear") for encoding in encodings))
        change = "" if self.why == "as requested" else f"; {other} to change"
        return f"photographs read as {read} ({self.why}{change})"


@dataclass(frozen=True)
class Source:
    """A scene and its views, as read from files."""

    scene: ds.Scene
    views: tuple[ds.View, ...]
    names: tuple[str, ...]
    """The name of each view: that of its photograph."""
    folder: Path | None
    """The folder of photographs; None for a scene file."""
    encodings: Encodings
    light_errors: np.ndarray | None = None
    """Of the direction of each light of the scene, degrees about each axis, where the folder says so."""
    has_normals: bool = True
    """Whether the scene says the normals of what the photographs show."""

    def only(self, which: Sequence[int]) -> Source:
        """Return the same with some of the views."""
        views, names = (tuple(of[i] for i in which) for of in (self.views, self.names))
        return replace(self, views=views, names=names)


@dataclass(frozen=True)
class Options:
    """The source and the options of a command, as typed."""

    source: Path
    photos: tuple[Path, ...]
    lit: Any = None
    mask: Path | None = None
    srgb: bool | None = None
    no_exif: bool = False
    free: tuple[str, ...] = FREE
    tied: tuple[str, ...] = ()
    grey: tuple[str, ...] = ()
    bounds: tuple[tuple[str, list[float]], ...] = ()
    lobe: str | None = None
    loss: str | None = "squares"
    noise: float | None = None
    light_error: float | None = None
    intensity_error: float | None = None
    memory: float | None = None

    def read(self, *, normals: bool | None = True) -> Source:
        """Read the scene and the photographs; `normals`: as for `read_photographs`, or None to use them if present."""
        if self.memory is not None and not self.memory > 0:
            raise ValueError(f"--memory must be above 0 GB; got {self.memory:g}. Leave it out for the default.")
        if self.noise is not None and not self.noise > 0:
            raise ValueError(f"--noise must be above 0; got {self.noise:g}. Leave it out if it is unknown.")
        found = self._of_folder(normals) if self.source.is_dir() else self._of_scene()
        return found if self.lobe is None else replace(found, scene=swap_lobe(found.scene, self.lobe))

    def fit(self, source: Source, scene: ds.Scene | None = None, **options: Any) -> ds.Fit:
        """Fit the free parameters to the photographs; error messages use the photographs' names."""
        import diffshade as ds

        from ..inverse.unknowns.names import segments_of

        if self.memory is not None:
            options["memory"] = self.memory * 1e9
        views, tied = source.views, self.tied
        if any("sensor" in segments_of(name) for name in self.free):  # one camera took all photographs
            views = tuple(replace(view, sensor=ds.Sensor()) for view in views)
            tied = tied if "sensor" in tied else (*tied, "sensor")
        error: Any = self.light_error
        if error is None and source.light_errors is not None and (source.light_errors > 0.0).all():
            error = source.light_errors  # of a calibrated folder
        with by_name(source.names):
            return ds.fit(
                source.scene if scene is None else scene,
                views,
                free=self.free,
                tied=tied,
                bounds=dict(self.bounds),
                constraints=[ds.Grey(name) for name in self.grey],
                light_error=error,
                intensity_error=self.intensity_error,
                loss=self.loss or "squares",
                progress=True,
                **options,
            )

    def _of_folder(self, normals: bool | None) -> Source:
        from ..inverse.data.folders import list_folder
        from ..inverse.data.photographs import read_folder

        for name, given in (("PHOTOS", self.photos), ("--lit", self.lit)):
            if given:
                raise ValueError(
                    f"{name} cannot be combined with a folder of photographs. Give a scene file, or leave {name} out."
                )
        if (near := self.source / "scene.toml").is_file() and not (self.source / "light_directions.txt").is_file():
            # calibrate writes such a folder for a pinhole camera
            listed = list_folder(self.source)
            mask = self.mask or listed.mask_file()
            return replace(self, source=near, photos=listed.files, mask=mask)._of_scene()
        read = read_folder(self.source, normals=normals, mask=self.mask, srgb=self.srgb, exif=not self.no_exif)
        views = read.views if self.noise is None else tuple(replace(view, noise=self.noise) for view in read.views)
        encodings = Encodings.of(read.read_as, self.srgb)
        return Source(read.scene, views, read.names, self.source, encodings, read.light_errors, read.has_normals)

    def _of_scene(self) -> Source:
        import diffshade as ds

        from ..inverse.data.photograph_files import photograph_files

        if self.source.suffix.lower() != ".toml":
            state = "is neither" if self.source.exists() else "does not exist"
            raise ValueError(
                f"SOURCE must be a scene (.toml) or a folder of photographs; {self.source} {state}. Give one of them."
            )
        scene, camera = ds.read_scene(self.source), ds.read_camera(self.source)
        if not self.photos:
            raise ValueError(f"{self.source} needs photographs to fit; got none. Give their files after it.")
        mask = None if self.mask is None else ds.read_mask(self.mask)
        views, photographs = [], photograph_files(self.photos, srgb=self.srgb, shape=camera.shape)
        for note in photographs.notes:
            _LOGGER.warning("%s: %s", self.photos[0].parent, note)
        for i, (path, lit) in enumerate(zip(self.photos, self._lights(scene), strict=True)):
            try:
                views.append(ds.View(photographs.read(i), camera, mask, lit=lit, noise=self.noise))
            except (ValueError, TypeError) as error:
                raise ValueError(f"{error}" if f"{path}" in f"{error}" else f"{path}: {error}") from None
        encodings = Encodings.of(photographs.read_as, self.srgb)
        return Source(scene, tuple(views), tuple(str(path) for path in self.photos), None, encodings)

    def _lights(self, scene: ds.Scene) -> list[tuple[int, ...] | None]:
        """Return the lights that are on in each photograph."""
        photos, lights = len(self.photos), len(scene.lights)
        lit = self.lit or ("all" if photos == 1 else "each")
        if lit == "all":
            return [None] * photos
        if lit == "each":
            if photos != lights:
                raise ValueError(
                    f"{photos} photographs with one light each need {photos} lights; {self.source} has {lights}. Give "
                    "as many photographs as lights, or --lit all, or for example --lit 0,1,0+1."
                )
            return [(i,) for i in range(photos)]
        if len(lit) != photos:
            raise ValueError(
                f"--lit must name the lights of each of the {photos} photographs; got {len(lit)}. Give for example "
                f"--lit {','.join(str(i % max(lights, 1)) for i in range(photos))}."
            )
        return list(lit)


def with_options(*options: Callable[..., Any]) -> Callable[..., Any]:
    """Give a command a source and these options, as one `Options`."""
    names = Options.__dataclass_fields__

    def wrap(command: Callable[..., Any]) -> Callable[..., Any]:
        @functools.wraps(command)
        def run(**typed: Any) -> Any:
            own = {name: value for name, value in typed.items() if name not in names}
            return command(Options(**{name: typed[name] for name in typed if name in names}), **own)

        for option in reversed([*SOURCE, *options]):
            run = option(run)
        return run

    return wrap


def swap_lobe(scene: ds.Scene, lobe: str) -> ds.Scene:
    """Return a scene whose materials have another lobe."""
    import equinox as eqx

    import diffshade as ds

    shape = {"phong": ds.Phong, "blinn": ds.Blinn}[lobe]()
    return eqx.tree_at(lambda s: [item.material.lobe for item in s.objects], scene, [shape] * len(scene.objects))


@contextlib.contextmanager
def by_name(names: tuple[str, ...]) -> Iterator[None]:
    """Replace views by their photographs' names in error messages."""
    try:
        yield
    except ValueError as error:
        raise ValueError(with_names(f"{error}", names)) from None
