"""What a photograph that is planned would be."""

import numpy as np
from synthetic import ATTENUATION, CAMERA, photograph

import diffshade as ds


def with_shot(scene: ds.Scene, shot: ds.Shot) -> tuple[ds.Scene, ds.View]:
    """Return the scene with the shot's lamp, and the photograph that it would be, without noise."""
    lit = (0,)
    if isinstance(shot.light, ds.PointLight):
        lamp = ds.PointLight(shot.light.position, 1.0, ATTENUATION)
        scene, lit = ds.Scene(scene.objects, (*scene.lights, lamp)), (len(scene.lights),)
    camera = shot.camera or CAMERA
    image = float(shot.exposure) * photograph(scene, camera, lit)
    return scene, ds.View(image, camera, lit=lit, exposure=shot.exposure, saturation=np.inf)
