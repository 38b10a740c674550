"""Faults of a set-up: what each changes in the pictures, its plausible sizes, its words. A new fault is an entry."""

from __future__ import annotations

from functools import partial

import numpy as np

from ...core.thresholds import SLIGHT, SMALL, TINY
from ...model.lobes import EXPONENTS
from . import changes, other_scenes, regional
from . import fault_words as words
from .found import Fault
from .linearised import BLUR_SIGMAS

LOOK_AT_IT = (
    "Look for shadows, light from other things and patterns of the material; mask them out with View.mask, or add them "
    "to the scene."
)
VARIES = "changes across the object as no light of the scene makes it change"

FAULTS = (
    Fault(
        "exposure",
        "views[{f.which}] is {f.size:.3g} times as bright as {others}",
        "Give it exposure={exposure:.3g} or free 'views.{f.which}.exposure', and check its lights: a wrong intensity "
        "or distance looks the same.",
        changes.of_exposure,
        changes.exposures,
        words.of_exposure,
        size=lambda which, amount: 1.0 + float(amount[0]),
        relative=True,
        of_most="{count} of the {of} views are darker or brighter than the other views predict, by factors of "
        "{smallest:.3g} to {largest:.3g}. Check the lights' intensities, distances and attenuation and whether the "
        "material model is complete, or free 'exposure'.",
    ),
    Fault(
        "light",
        "judging by the shading in {f.views_in_words}, lights.{f.which} is {f.size:.2g} degrees off as seen from the "
        "surface",
        "Measure the light again, or free 'lights.{f.which}.{place}', which is near {near}.",
        changes.of_light,
        changes.places,
        words.of_light,
        size=lambda which, amount: float(np.linalg.norm(amount)),
        of_most="{count} of the {of} lights are {smallest:.2g} to {largest:.2g} degrees off, judging by the shading. "
        "Check the axes of directions and normals, that directions point the way the light travels, and whether the "
        "material model is complete.",
    ),
    Fault(
        "shadow",
        "predicted light is missing, as in a cast shadow: {f.where}",
        "Exclude these pixels with View.mask, or fit with loss='cauchy'.",
        regions=regional.shadows,
        confirmed=regional.in_shadow,
        described=regional.where_shadows_are,
    ),
    Fault(
        "rim",
        "the rim in {f.views_in_words} is brighter than predicted{f.where}",
        "Possible causes are interreflection or another form of highlight. Exclude the rim with View.mask, or fit with "
        "loss='cauchy'.",
        regions=regional.bright_rims,
        confirmed=regional.at_bright_rims,
        described=regional.how_bright_rims_are,
    ),
    Fault(
        "vignetting",
        "the images darken towards their corners by about {f.size:.0%} (vignetting)",
        "Divide them by 1 - {f.size:.2g} rho^2, with rho the distance from the centre over that of a corner, or use a "
        "smaller aperture, or give the views a Sensor() and free 'sensor.vignetting.second'.",
        changes.of_vignetting,
        plausible=(0.0, 0.9),
    ),
    Fault(
        "gamma",
        "the images look like linear ones raised to the power {f.size:.4g} (gamma)",
        "Raise them to the power {inverse:.4g}, read them with the camera's own curve, or give the views a Sensor() "
        "and free 'sensor.gamma'.",
        changes.of_gamma,
        words=lambda f: {"inverse": 1.0 / f.size},
        size=lambda which, amount: float(np.exp(amount[0])),
        plausible=(0.15, 6.0),
    ),
    Fault(
        "gamma of a colour",
        "{colour} looks like linear light raised to the power {f.size:.4g} (gamma), the other colours do not",
        "Raise it to the power {inverse:.4g}, or read the images with the camera's own curves.",
        changes.of_gamma_of_one,
        words=lambda f: {"colour": words.colour(f.given.scene.channels[f.which]), "inverse": 1.0 / f.size},
        size=lambda which, amount: float(np.exp(amount[0])),
        plausible=(0.15, 6.0),
    ),
    Fault(
        "blur",
        "the images are blurred by about {f.size:.2g} pixels (standard deviation), or the highlights have wider edges "
        "than the lobe",
        "Focus, shrink the images, or give View(sensor=ds.Sensor(blur={f.size:.2g})).",
        changes.of_blur,
        size=lambda which, amount: BLUR_SIGMAS[which] * float(np.sqrt(np.maximum(amount[0], 0.0))),
        plausible=(0.0, 4.0),
    ),
    Fault(
        "pixels",
        "each pixel is an average over its area, as cameras make it, and renderers with several samples a pixel; the "
        "fit shades its middle",
        "Give View(sensor=ds.Sensor(blur=0.29)), or the blur of the whole image, and the fit takes averages too.",
        changes.of_pixels,
        plausible=(0.2, 4.0),  # 1 is exactly that, and a lens adds to it
    ),
    Fault(
        "chroma",
        "the colours are blurred and the brightness is not, as in JPEG files, which keep colours at half the size",
        "Use raw, TIFF or PNG files, or fit grey images.",
        changes.of_chroma,
        size=lambda which, amount: 0.5 * float(np.sum(amount)),  # of red and of blue
        plausible=(0.2, 3.0),  # 1 is exactly that
        inexact=True,  # it depends on how the file rounded the colours, too
    ),
    Fault(
        "lobe",
        "the highlights fit {other}'s lobe better than {own}'s",
        "Give Material(lobe=ds.{other}()), or compare both with ds.compare.",
        other_scenes.of_lobe,
        words=words.of_lobe,
        plausible=(0.4, 1.7),  # 1 is exactly the other lobe
    ),
    Fault(
        "viewer",
        "the highlights are those of a viewer {where}",
        "Give the camera local_viewer={local}.",
        other_scenes.of_viewer,
        words=words.of_viewer,
        plausible=(0.4, 1.7),  # 1 is exactly the other viewer
        inexact=True,  # n_s may be far off, and the change with it
    ),
    Fault(
        "rough",
        "the surface is rough, as clay, plaster and stone are: it reflects more towards the light than by Lambert's "
        "law (Oren and Nayar 1994: B / A is {f.size:.2g})",
        "No material of a scene does so. Exclude with View.mask what turns away from the camera, where it shows most.",
        other_scenes.of_roughness,
        plausible=(0.0, 1.0),
    ),
    Fault(
        "coat",
        "the colour lies under a clear coat, as of plastic, glaze and varnish: less light passes it at grazing angles",
        "No material of a scene does so. Exclude with View.mask what turns away from the camera, where it shows most.",
        other_scenes.of_coat,
        plausible=(0.0, 3.0),  # 1 is all that a coat reflects
    ),
    Fault(
        "microfacets",
        "the highlights have the tails of microfacets (GGX), as of Blender's Principled BSDF, of glTF, and of most "
        "plastics and metals",
        "Give the material highlights=ds.Highlight(k_s=0.1, n_s={n_s:.2g}) and free both, or a lobe of your own with "
        "such tails (ds.extension.AbstractLobe).",
        other_scenes.of_microfacets,
        words=lambda f: {"n_s": words.shared_exponent(f) / 4.0},
        plausible=(0.4, 2.5),  # 1 is exactly these
    ),
    Fault(
        "translucent",
        "light enters the surface and comes out nearby, as in wax, marble and skin: it is lit beyond where its light "
        "ends",
        "No material of a scene does so. Exclude with View.mask what is near the edge of the light.",
        other_scenes.of_translucency,
        plausible=(0.0, 1.0),
    ),
    Fault(
        "missing highlight",
        "there is a highlight, with n_s near {n_s:.2g}, that the scene does not have: its k_s is 0, and not free",
        "Free 'k_s' and 'n_s'.",
        other_scenes.of_missing_highlight,
        words=lambda f: {"n_s": EXPONENTS[1:][f.which]},
        plausible=(0.0, np.inf),
    ),
    Fault(
        "highlight",
        "the highlights have a second, {wider} part, with n_s near {n_s:.2g}",
        "{free}Give the material highlights=ds.Highlight(k_s=0.1, n_s={n_s:.2g}) and free both.",
        other_scenes.of_second_highlight,
        words=words.of_highlight,
        plausible=(0.0, np.inf),
    ),
    Fault(
        "highlight by colour",
        "the highlights are wider in one colour than in another: n_s is near {n_s}",
        "Give the material n_s={n_s}, a number for each channel.",
        changes.of_highlight_by_colour,
        words=words.by_colour,
        size=lambda which, amount: float(np.ptp(amount)),
        plausible=(SLIGHT, np.inf),
    ),
    Fault(
        "radius",
        "{surface}.radius seems to be about {radius:.3g}, but the scene has {given:.3g}",
        "Measure it again, or free 'surface.radius' and give each View a mask.",
        partial(changes.of_sphere, "radius"),
        partial(changes.of_spheres, "radius"),
        words.of_sphere,
        at_rims=False,
    ),
    Fault(
        "center",
        "{surface}.center seems to be off by about {f.length:.2g}, near {center}",
        "Measure it again, or free 'surface.center' and give each View a mask.",
        partial(changes.of_sphere, "center"),
        partial(changes.of_spheres, "center"),
        words.of_sphere,
        at_rims=False,
    ),
    Fault(
        "rotation",
        "all lights together are turned by about {f.length:.2g} degrees around the axis {axis}",
        "Check the axes of the lights and of the camera, or free {places}.",
        changes.of_rotation,
        changes.places,
        words.of_rotation,
    ),
    Fault(
        "attenuation",
        "the lamps' light {falls}, unlike the scene's attenuation",
        "Give the lights RadialAttenuation(0, 0, 1) or (1, 0, 0), or free 'attenuation'.",
        other_scenes.of_attenuation,
        words=words.of_falloff,
        mended=lambda f: other_scenes.with_lamps(f.given, partial(other_scenes.falling, f.which)),
        plausible=(0.2, 2.0),  # 1 is exactly the square of the distance, or no attenuation
    ),
    Fault(
        "distance",
        "the lamps are {f.size:.4g} times as far away as the scene says",
        "Measure their distances again, or free 'position'.",
        other_scenes.of_distance,
        mended=lambda f: other_scenes.with_lamps(f.given, partial(other_scenes.farther, f.size)),
        size=lambda which, amount: 1.0 + float(amount[0]),
        plausible=(0.5, 2.0),
    ),
    Fault(
        "near",
        "the lights are about {f.size:.2g} times as far away as the camera, not at infinity, and their light {falls}",
        "Give them as ds.PointLight, with RadialAttenuation(0, 0, 1) if it falls off.",
        other_scenes.of_near,
        words=words.of_falloff,
        mended=lambda f: other_scenes.with_near_lamps(f.given, f.which, f.size),
        size=lambda which, amount: 1.0 / float(amount[0] or TINY),
        plausible=(SMALL, np.inf),
    ),
    Fault(
        "size",
        "the lights are no points, but about {f.size:.2g} times as wide as they are far",
        "Give them as ds.AreaLight, or use smaller ones.",
        other_scenes.of_size,
        size=lambda which, amount: float(np.sqrt(np.maximum(amount[0], 0.0))),
        plausible=(0.0, 1.0),
        inexact=True,  # the first order in its square is drawn
    ),
    Fault(
        "ellipsoid",
        "the sphere is longer in one direction than in another, by about {f.size:.2%}, or its radius is another",
        "Measure its radius again, or free 'surface.radius' and give each View a mask; if it is not round, give its "
        "shape as a mesh or a GBuffer.",
        other_scenes.of_ellipsoid,
        size=lambda which, amount: float(np.ptp(np.linalg.eigvalsh(other_scenes.stretch(amount)))),
        plausible=(0.0, 0.2),
    ),
    Fault(
        "ambient",
        "there is light of about {f.size:.2g} from everywhere that the scene does not have",
        "Free 'k_a', or give the scene its ambient light.",
        changes.of_ambient,
        size=lambda which, amount: float(np.mean(amount)),
        plausible=(0.0, np.inf),
    ),
    Fault(
        "elsewhere",
        "there is light from elsewhere that the scene does not have: what faces {toward} gets most of it, {more:.2g} "
        "more than what gets least",
        "Add that lamp, or what the surroundings give back, to the scene, or keep it away.",
        other_scenes.of_elsewhere,
        words=words.of_elsewhere,
        size=lambda which, amount: float(np.linalg.norm(amount)),
        plausible=(0.0, np.inf),
    ),
    Fault(
        "shift",
        "{f.views_in_words} {are} shifted by about {f.length:.2g} pixels against the scene",
        "Check the camera's pose and principal point, and the objects' places.",
        changes.of_shift,
        words=lambda f: {"are": "is" if len(f.views) == 1 else "are"},
        size=lambda which, amount: float(np.linalg.norm(amount)),
        plausible=(0.0, 10.0),
    ),
    Fault(
        "floor",
        "{zeros:,} samples are exactly 0, where their noise was cut off, so that the dark is too bright on average",
        "Give the views floor=0 and noise={noise:.2g}, and fit with clipped='tobit'.",
        changes.of_floor,
        words=lambda f: {
            "zeros": sum(samples.zeros for samples in f.given.solved.problem.data.samples),
            "noise": f.given.rmse,
        },
    ),
    Fault(
        "bound",
        "the photographs want {names} beyond {bounds}",
        "Check the bounds; where they are right, something else in the description is wrong.",
        changes.of_bound,
        words=words.of_bound,
        size=lambda which, amount: float(np.max(amount)),
        plausible=(0.0, np.inf),
    ),
    Fault(
        "black",
        "{pixels} brighter than the scene says{too} (a black level, haze, or a lit background)",
        "{remedy}, or give the scene its background.",
        changes.of_black,
        words=lambda f: {"too": ", beside the object too" if f.fault.beside else "", **words.of_black(f)},
        size=lambda which, amount: float(np.max(amount)),
        plausible=(0.0, np.inf),
        beside=True,
    ),
    Fault("uneven light", "the light " + VARIES, LOOK_AT_IT, changes.of_uneven_light, unnamed=True),
    Fault("uneven view", "the light in {f.views_in_words} " + VARIES, LOOK_AT_IT, changes.of_uneven_view, unnamed=True),
    Fault("colour", "a colour " + VARIES, LOOK_AT_IT, changes.of_colour, unnamed=True),
    Fault(
        "stray light", "there is light that the scene does not have", LOOK_AT_IT, changes.of_stray_light, unnamed=True
    ),
)
