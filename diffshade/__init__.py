r"""diffshade: the classic illumination model as a differentiable JAX program, and the tool to run it backwards.

$$ I = k_e + k_a I_a + \sum_l f_{rad} f_{ang} I_l (k_d (n \cdot l)_+ + W (v \cdot r)_+^{n_s}) $$

Vectors are unit length and point away from the surface: the normal n, l to the light, v to the viewer, r the mirror
direction of l. Right-handed, y up, the camera looks along -z. Images have row 0 on top and channels last, and are
linear radiance, unclamped. Angles are degrees, lengths scene units, intensities plain multipliers. A number where a
colour is meant is grey. E1 to E14 are the equations of the model, where a docstring names one.

Arrays in annotations have their shapes: `Float[np.ndarray, "h w c"]` is H by W by C. `Numbers` is what people type: a
number, a list, an array. A field is NumPy float64 or a JAX array: a `Scalar`, a `Vector` or `Colour` of 3, an
`Exponent` of 1 or 3, a `Coefficient` that is a colour or a pattern. What is out of the range that a docstring states
raises ValueError, and what is of another kind TypeError: one sentence, with the remedy, before anything is written.

f_rad and f_ang are the attenuation of a light I_l by distance and by angle, W the Fresnel weight of k_s, and x_+ is x
or 0. `docs/pages/lectures.md` has E1 to E14.

What is named `errors` are standard errors: the truth lies within one of them 68 % of the time. 95 % of the time it lies
within 1.96 of those of a number, and within `TexelMaps.errors_95` of maps. They contain what a fit knows of the light,
the noise and its own misfit; an error is infinite where nothing is known, and notes say what no photograph tells. That
of a direction is an angle, in degrees; `light_error`, which fits take, is that about each axis.

Directions named `direction` are those in which light travels. Lists of directions (`calibrate`, `light_directions.txt`,
`--light`) point towards the light.

JAX runs threads of its own, which a fork does not copy: after the first render or fit a process that is forked from
this one hangs when it computes. Start several with `multiprocessing.get_context("spawn")`, which concurrent.futures
takes as `mp_context`, or fork them before anything is computed.

## Scenes

`Scene`, `Object`, `Sphere`, `Plane`, `Box`, `Mesh`, `GBuffer`, `normal_map`, `height_map`, `Camera`,
`OrthographicCamera`, `DepthCueing`, `Fog`, `read_scene`, `read_camera`, `write_scene`

## Materials

`Material`, `Highlight`, `Phong`, `Blinn`, `Brushed`, `NoFresnel`, `Schlick`, `Dielectric`, `Chequer`, `Texture`,
`material`, `material_names`, `measured_material_names`

## Lights

`PointLight`, `DirectionalLight`, `SpotLight`, `AreaLight`, `RadialAttenuation`, `Flaps`

## Pictures

`render`, `shade`, `intersect`, `read_image`, `write_image`, `read_mask`, `open_image`, `srgb_encode`, `srgb_decode`

## Fits

`View`, `Noise`, `Sensor`, `Vignetting`, `fit`, `Fit`, `fit_function`, `Grey`, `Proportional`, `read_photographs`,
`merge_exposures`, `fit_texels`, `TexelMaps`, `read_maps`, `LostProcess`

## What a fit can tell

`examine`, `forecast`, `compare`, `plan`, `Shot`, `bootstrap`, `fit_bands`, `sensitivity`, `image_sensitivity`,
`draw_comparison`, `write_figure`, `write_report`

## Rooms

`lights` of photographs, measured `lamps`, `heights` from normals, `exchange` with other programs, the figures of a
`lecture`; and `extension`, for lobes, lights and laws of your own.
"""


def __getattr__(name: str) -> object:
    """Import what is needed to import the public names, so that the command heeds Ctrl-C at once, and then this one."""
    import lazy_loader

    one, all_of, names = lazy_loader.attach_stub(__name__, __file__)
    globals().update(__getattr__=one, __dir__=all_of, __all__=names)
    return names if name == "__all__" else one(name)


def __dir__() -> list[str]:
    names = __getattr__("__all__")
    assert isinstance(names, list)
    return names
