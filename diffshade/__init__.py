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

## Scenes

`Scene`, `Object`, `Sphere`, `Plane`, `Box`, `GBuffer`, `read_mesh`, `normal_map`, `height_map`, `Camera`,
`OrthographicCamera`, `DepthCueing`, `Fog`, `read_scene`, `read_camera`, `write_scene`

## Materials

`Material`, `Phong`, `Blinn`, `NoFresnel`, `Schlick`, `Dielectric`, `Chequer`, `material`, `material_names`,
`with_lobe`, `Refit`

## Lights

`PointLight`, `DirectionalLight`, `SpotLight`, `AreaLight`, `MeasuredLight`, `Profile`, `RadialAttenuation`,
`read_lamp`, `as_spot`, `SpotFit`, `fit_falloff`, `Falloff`

## Pictures

`render`, `shade`, `intersect`, `read_image`, `write_image`, `read_mask`, `open_image`, `LazyImage`, `srgb_encode`,
`srgb_decode`, `write_figures`

## Fits

`View`, `Noise`, `fit`, `Fit`, `Prediction`, `Grey`, `Proportional`, `read_photographs`, `sensitivity`,
`image_sensitivity`, `draw_comparison`, `write_comparison`, `write_report`, `LostProcess`

## What a fit can tell

`examine`, `Examination`, `foresee`, `Foresight`, `compare`, `ModelChoice`, `plan`, `Plan`, `Shot`, `bootstrap`

## Texels

`fit_texels`, `TexelMaps`

## Other programs

`write_material`, `Exported`, `read_material`, `read_materials`, `read_lights`
"""

from .attenuation import DepthCueing as DepthCueing
from .attenuation import Fog as Fog
from .attenuation import RadialAttenuation as RadialAttenuation
from .cameras import Camera as Camera
from .cameras import OrthographicCamera as OrthographicCamera
from .diagnosis.examination import Examination as Examination
from .diagnosis.examination import examine as examine
from .diagnosis.foresight import Foresight as Foresight
from .diagnosis.foresight import foresee as foresee
from .diagnosis.model_choice import ModelChoice as ModelChoice
from .diagnosis.model_choice import compare as compare
from .diagnosis.planning import Plan as Plan
from .diagnosis.planning import Shot as Shot
from .diagnosis.planning import plan as plan
from .diagnosis.resampling import bootstrap as bootstrap
from .exchange.falloff import Falloff as Falloff
from .exchange.falloff import fit_falloff as fit_falloff
from .exchange.lamps import SpotFit as SpotFit
from .exchange.lamps import as_spot as as_spot
from .exchange.lamps import read_lamp as read_lamp
from .exchange.material_files import Exported as Exported
from .exchange.material_files import read_lights as read_lights
from .exchange.material_files import read_material as read_material
from .exchange.material_files import read_materials as read_materials
from .exchange.material_files import write_material as write_material
from .exchange.refits import Refit as Refit
from .exchange.refits import with_lobe as with_lobe
from .fresnel import Dielectric as Dielectric
from .fresnel import NoFresnel as NoFresnel
from .fresnel import Schlick as Schlick
from .gbuffers import GBuffer as GBuffer
from .gbuffers import height_map as height_map
from .gbuffers import normal_map as normal_map
from .images import read_image as read_image
from .images import read_mask as read_mask
from .images import srgb_decode as srgb_decode
from .images import srgb_encode as srgb_encode
from .images import write_image as write_image
from .inverse.constraints import Grey as Grey
from .inverse.constraints import Proportional as Proportional
from .inverse.fitting import fit as fit
from .inverse.hosts import LostProcess as LostProcess
from .inverse.outcome import Fit as Fit
from .inverse.outcome import Prediction as Prediction
from .inverse.photographs import read_photographs as read_photographs
from .inverse.sensitivity import image_sensitivity as image_sensitivity
from .inverse.sensitivity import sensitivity as sensitivity
from .inverse.views import Noise as Noise
from .inverse.views import View as View
from .lazy_images import LazyImage as LazyImage
from .lazy_images import open_image as open_image
from .lights import AreaLight as AreaLight
from .lights import DirectionalLight as DirectionalLight
from .lights import PointLight as PointLight
from .lights import SpotLight as SpotLight
from .materials import Blinn as Blinn
from .materials import Material as Material
from .materials import Phong as Phong
from .measured_lights import MeasuredLight as MeasuredLight
from .measured_lights import Profile as Profile
from .meshes import read_mesh as read_mesh
from .named_materials import material as material
from .named_materials import material_names as material_names
from .patterns import Chequer as Chequer
from .rendering import intersect as intersect
from .rendering import render as render
from .rendering import shade as shade
from .report.comparison import draw_comparison as draw_comparison
from .report.comparison import write_comparison as write_comparison
from .report.lecture import write_figures as write_figures
from .report.page import write_report as write_report
from .scene_files import read_camera as read_camera
from .scene_files import read_scene as read_scene
from .scene_files import write_scene as write_scene
from .scenes import Object as Object
from .scenes import Scene as Scene
from .surfaces import Box as Box
from .surfaces import Plane as Plane
from .surfaces import Sphere as Sphere
from .texels.fitting import fit_texels as fit_texels
from .texels.maps import TexelMaps as TexelMaps
