"""A scene and its camera as TOML: back exactly as they were, and one sentence for what is wrong."""

from re import escape

import jax
import numpy as np
import pytest
from refusals import refuses

import diffshade as ds

SCENE = ds.Scene(
    [
        ds.Object(ds.Sphere((0.1, 1 / 3, -2e-300), 1e10), ds.Material(0.05, (0.7, 0.25, 0.2), 0.4, 40.5)),
        ds.Object(ds.Sphere(), ds.Material(lobe=ds.Blinn())),
    ],
    [
        ds.PointLight((2, 3, 4), 20, ds.RadialAttenuation(1.0, 0.1, 0.5, clamp=True)),
        ds.DirectionalLight((1, -1, -1), (0.1, 0.2, 0.3)),
        ds.SpotLight((2, 3, 4), (-2, -3, -4), 5, 30, 2.5, ds.RadialAttenuation(0, 0, 1), 3),
    ],
    ambient=(0.9, 1, 0.8),
    background=0.1,
)
GLASS = ds.Material(0.1, k_t=(0.9, 0.8, 1 / 3), eta=1.5, fresnel=ds.Dielectric(), n_s=(3, 20, 90), k_e=(0.1, 0, 0.2))
FLOOR = ds.Material(k_a=ds.Chequer(0.1, (0.9, 0.8, 0.3), 0.7, True, (1, 0, 0), (0, 0, 1)), k_t=ds.Chequer(0, 1))
WHOLE = ds.Scene(
    [
        ds.Object(ds.Box((1, 2, 3), (0.1, 0.2, 1 / 3), (10, 20, 30)), GLASS, name="ice"),
        ds.Object(ds.Plane((0, -1, 0), (0.1, 2, 0)), FLOOR, name="floor"),
        ds.Object(ds.Plane()),
        ds.Object(ds.Box(), ds.Material(k_s=0.04, fresnel=ds.Schlick(), lobe=ds.Blinn(), k_t=0)),
        ds.Object(ds.Sphere(), ds.material("emerald")),
    ],
    [
        ds.AreaLight((1, 2, 3), (1, 0, 0), (0, 0.1, 1), (3, 2, 1), 80, 2, ds.RadialAttenuation(0.5, 0.1, 0.2), (3, 5)),
        ds.SpotLight((2, 3, 4), (-2, -3, -4), flaps=ds.Flaps(x_min=-1, y_max=1 / 3, softness=0.1)),
        ds.AreaLight((1, 2, 3), (1, 0, 0), (0, 0.1, 1)),
    ],
    atmosphere=ds.DepthCueing(1 / 3, 7, s_f=0.9, s_b=0.1, I_dc=(0.1, 0.2, 0.3), radial=True),
)
SCENES = {
    "the first": SCENE,
    "everything": WHOLE,
    "fog": ds.Scene(ds.Object(ds.Sphere()), atmosphere=ds.Fog(0.2, I_dc=0.5)),
    "squared fog": ds.Scene(ds.Object(ds.Sphere()), atmosphere=ds.Fog(0.2, squared=True, radial=True)),
    "plain depth cueing": ds.Scene(ds.Object(ds.Sphere()), atmosphere=ds.DepthCueing(1, 2)),
}
CAMERAS = [
    ds.Camera((0.5, 1, 4), target=(0.1, 0, 0), up=(0, 0.1, 1), fov=35, shape=(12, 16), local_viewer=False),
    ds.OrthographicCamera((0.5, 1, 4), height=1 / 3, shape=(12, 16)),
    ds.Camera.from_intrinsics([[20.5, 0, 7.7], [0, 21.1, 6.4], [0, 0, 1]], shape=(12, 16), eye=(0.5, 1, 4)),
]


def assert_same(a, b):
    assert jax.tree.structure(a) == jax.tree.structure(b)
    for x, y in zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True):
        assert type(x) is type(y) is np.ndarray
        assert x.dtype == y.dtype
        np.testing.assert_array_equal(x, y)


@pytest.mark.parametrize("camera", CAMERAS, ids=lambda camera: type(camera).__name__)
def test_it_comes_back_exactly(tmp_path, camera):
    path = tmp_path / "scene.toml"
    ds.write_scene(path, SCENE, camera=camera)
    assert_same(ds.read_scene(path), SCENE)
    assert_same(ds.read_camera(path), camera)
    once = path.read_bytes()
    ds.write_scene(str(path), ds.read_scene(str(path)), camera=ds.read_camera(str(path)))
    assert path.read_bytes() == once


@pytest.mark.parametrize("name", SCENES)
def test_every_kind_of_thing_comes_back_exactly(tmp_path, name):
    path = tmp_path / "scene.toml"
    ds.write_scene(path, SCENES[name])
    back = ds.read_scene(path)
    assert_same(back, SCENES[name])
    assert [item.name for item in back.objects] == [item.name for item in SCENES[name].objects]
    once = path.read_bytes()
    ds.write_scene(path, back)
    assert path.read_bytes() == once
    with pytest.raises(ValueError, match=rf"{escape(str(path))} has no table \[camera\]. Add one"):
        ds.read_camera(path)


WRITTEN = """
ambient = 0.3

[camera]
eye = [0, 0, 4]
fov = 35
shape = [12, 16]

[[objects]]
surface = "Sphere"
material = { k_d = 0.7, k_s = [0.1, 0.2, 0.3], lobe = "Blinn" }

[[lights]]
position = [2, 3, 4]
attenuation = { quadratic = 1 }

[[lights]]
type = "DirectionalLight"
direction = [0, 0, -1]
intensity = 2
"""
NEW = """
atmosphere = { type = "Fog", density = 0.2, I_dc = 0.5 }
[[objects]]
surface = { type = "Box", size = [1, 2, 3] }
name = "ice"
material = { k_t = 0.9, eta = 1.5, fresnel = "Schlick", k_d = { a = 0.1, b = [0.9, 0.8, 0.7], smooth = true } }
[[objects]]
surface = "Plane"
material = { eta = 1.5, fresnel = { type = "Dielectric" } }
[[lights]]
type = "AreaLight"
corner = [0, 0, 2]
edge_u = [1, 0, 0]
edge_v = [0, 1, 0]
samples = 4
"""


@pytest.fixture
def write(tmp_path):
    """Return a function that writes the file above with one thing in it changed."""
    path = tmp_path / "scene.toml"

    def to_file(old="", new=""):
        assert old in WRITTEN
        path.write_text(WRITTEN.replace(old, new, 1))
        return path

    return to_file


def test_what_people_write(write):
    """Types and values that are not given are the defaults; a type alone may be a string."""
    path = write()
    material = ds.Material(k_d=0.7, k_s=(0.1, 0.2, 0.3), lobe=ds.Blinn())
    attenuation = ds.RadialAttenuation(quadratic=1)
    lights = [ds.PointLight((2, 3, 4), attenuation=attenuation), ds.DirectionalLight((0, 0, -1), 2)]
    assert_same(ds.read_scene(path), ds.Scene(ds.Object(ds.Sphere(), material), lights, 0.3))
    assert_same(ds.read_camera(path), ds.Camera((0, 0, 4), fov=35, shape=(12, 16)))
    path.write_text(NEW)
    ice = ds.Material(k_t=0.9, eta=1.5, fresnel=ds.Schlick(), k_d=ds.Chequer(0.1, (0.9, 0.8, 0.7), smooth=True))
    objects = [
        ds.Object(ds.Box(size=(1, 2, 3)), ice, name="ice"),
        ds.Object(ds.Plane(), ds.Material(eta=1.5, fresnel=ds.Dielectric())),
    ]
    light = ds.AreaLight((0, 0, 2), (1, 0, 0), (0, 1, 0), samples=(4, 4))
    assert_same(ds.read_scene(path), ds.Scene(objects, light, atmosphere=ds.Fog(0.2, I_dc=0.5)))


BAD = [  # what stands there, what is written instead, and what is said after the file's name
    # misspelt, at every level
    ("ambient", "ambiant", " has no key 'ambiant'. Did you mean 'ambient'?"),
    ("[camera]", "[camra]", " has no key 'camra'. Did you mean 'camera'?"),
    ("surface =", "surfase =", ": objects[0] has no key 'surfase'. Did you mean 'surface'?"),
    ("k_d =", "kd =", ": objects[0].material has no key 'kd'. Did you mean 'k_d'?"),
    ('"Sphere"', "{ radios = 2 }", ": objects[0].surface has no key 'radios'. Did you mean 'radius'?"),
    ("position", "positon", ": lights[0] has no key 'positon'. Did you mean 'position'?"),
    ("quadratic", "quadratik", ": lights[0].attenuation has no key 'quadratik'. Did you mean 'quadratic'?"),
    ('"Blinn"', '{ type = "Blinn", n_s = 3 }', ": objects[0].material.lobe has no key 'n_s'"),
    ('"Sphere"', '"Sphera"', ": objects[0].surface has no type 'Sphera'. Did you mean 'Sphere'?"),
    ('"Blinn"', '"Blin"', ": objects[0].material.lobe has no type 'Blin'. Did you mean 'Blinn'?"),
    ('"DirectionalLight"', '"DirectLight"', ": lights[1] has no type 'DirectLight'. Did you mean 'DirectionalLight'?"),
    ('"DirectionalLight"', '"xyzzy"', ": lights[1] has no type 'xyzzy'."),
    ('"DirectionalLight"', "5", ": lights[1] has no type '5'. Known names: "),
    ('"DirectionalLight"', '["a"]', ": lights[1] has no type '['a']'. Known names: "),
    ("ambient = 0.3", 'atmosphere = "Fogg"', ": atmosphere has no type 'Fogg'. Did you mean 'Fog'?"),
    ("k_d = 0.7", 'fresnel = "Schlik"', ": objects[0].material.fresnel has no type 'Schlik'. Did you mean 'Schlick'?"),
    ("k_d = 0.7", "k_d = { a = 1, b = 0, perod = 2 }", ".material.k_d has no key 'perod'. Did you mean 'period'?"),
    # missing
    ("position = [2, 3, 4]\n", "", ": lights[0] needs the key 'position' of a PointLight. Add it."),
    ('surface = "Sphere"\n', "", ": objects[0] needs the key 'surface' of a"),
    (WRITTEN[WRITTEN.index("[[obj") : WRITTEN.index("[[li")], "", " needs the key 'objects' of a Scene. Add it."),
    ("k_d = 0.7", "k_d = { a = 1 }", ": objects[0].material.k_d needs the key 'b' of a Chequer. Add it."),
    # of the wrong type
    ("{ quadratic = 1 }", "1", ": lights[0].attenuation must be a table of constant, linear, quadratic, clamp; got 1."),
    ("{ quadratic = 1 }", "[1, 0]", ".attenuation must be a table of constant, linear, quadratic, clamp; got [1, 0]."),
    ("{ quadratic = 1 }", "[]", ".attenuation must be a table of constant, linear, quadratic, clamp; got []."),
    ('"Sphere"', "[{ radius = 2 }]", ".surface must be a table of center, radius; got [{'radius': 2}]."),
    ("ambient = 0.3\n", "ambient = 0.3\nbackground = []\n", ": Scene.background must be a colour of 1 or 3"),
    ("quadratic = 1", 'clamp = "true"', ": lights[0].attenuation.clamp must be true or false; got 'true'."),
    ("quadratic = 1", "clamp = 1", ": lights[0].attenuation.clamp must be true or false; got 1. Write one of the two."),
    ("k_d = 0.7", 'k_d = "red"', ": objects[0].material: Material.k_d must be a colour of 1 or 3 numbers; got 'red'."),
    ("k_d = 0.7", 'k_d = { a = 1, b = 0, smooth = "yes" }', ".k_d.smooth must be true or false; got 'yes'."),
    ('surface = "Sphere"', 'surface = "Sphere"\nname = 5', ": objects[0].name must be a word; got 5."),
    ("ambient = 0.3", "ambient = { a = 1 }", ": ambient must be a number, a word or a list; got a table."),
    ("ambient = 0.3", "ambient = 2020-01-01", ": ambient must be a number, a word or a list; got 2020-01-01."),
    ('{ k_d = 0.7, k_s = [0.1, 0.2, 0.3], lobe = "Blinn" }', '"jade"', "those of material('jade')."),
    # out of range
    ("k_d = 0.7", "n_s = -1", "material: Material.n_s must be at least 0; got -1. Give a value"),
    ("[0.1, 0.2, 0.3]", "[0.1, 0.2]", ": objects.0.material.k_s has 2 numbers, but a scene without bands has red, gre"),
    ("[2, 3, 4]", "[2, nan, 4]", ": lights[0]: PointLight.position must be finite; got (2, nan, 4)."),
    ("[0, 0, -1]", "[0, 0, 0]", ": lights[1]: DirectionalLight.direction must not be the zero vector; got [0, 0, 0]."),
    ("{ quadratic = 1 }", "{ constant = 0 }", ": lights[0].attenuation: RadialAttenuation needs one of constant,"),
    ("k_d = 0.7", "k_d = { a = 1, b = 0, period = 0 }", ": Chequer.period must be above 0; got 0."),
    ("ambient = 0.3", "atmosphere = { z_f = 3, z_b = 2 }", ": atmosphere: DepthCueing.z_f must be less than z_b;"),
    ("k_d = 0.7", "k_t = 1.5", ": objects[0].material: Material.k_t must be between 0 and 1; got (1.5, 1.5, 1.5)."),
    ('surface = "Sphere"', 'surface = "Sphere"\nname = "my ball"', ": objects[0]: Object.name must be one word"),
    (
        '"Sphere"',
        '{ type = "Box", size = [1, 0, 1] }',
        ": objects[0].surface: Box.size must be above 0; got (1, 0, 1).",
    ),
    # of a light without a type, which it may be; and what is no TOML
    ('type = "DirectionalLight"', "", "lights[1] without a type is a PointLight, which has no key 'direction'."),
    ("[2, 3, 4]\natt", "[0, 3, 0]\ndirection = [0, 1, 0]\natt", "has no key 'direction'. Write type = \"SpotLight\"."),
    ("position = [2, 3, 4]", "corner = [0, 3, 0]\nedge_u = [1, 0, 0]", "'corner'. Write type = \"AreaLight\"."),
    ("ambient = 0.3", "ambient 0.3", " is no TOML: "),
    ("ambient = 0.3", "ambient = " + "[" * 3000, " is no scene: its lists are nested too deeply. Write them flat."),
]
BAD_CAMERAS = [
    ("fov", "fow", ": camera has no key 'fow'. Did you mean 'fov'?"),
    (
        "[camera]",
        '[camera]\ntype = "Ortographic"',
        ": camera has no type 'Ortographic'. Did you mean 'Ortho",
    ),
    ("[camera]", '[camera]\ntype = "OrthographicCamera"', ": camera has no key 'fov'."),
    ("eye = [0, 0, 4]\n", "", ": camera needs the key 'eye' of a Camera. Add it."),
    ("fov = 35", 'local_viewer = "false"', ": camera.local_viewer must be true or false; got 'false'."),
    (
        "fov = 35",
        "fov = 180",
        ": camera: Camera.fov must be above 0 and below 180; got 180.",
    ),
    ("[12, 16]", "[12, 16, 3]", ": camera: Camera.shape must be (height, width) in pixels, two whole numbers above"),
    ("[camera]", "[[camera]]", ": camera must be a table of eye, target, up, fov, shape, local_"),
]


@pytest.mark.parametrize(
    ("old", "new", "message", "read"),
    [*((*case, ds.read_scene) for case in BAD), *((*case, ds.read_camera) for case in BAD_CAMERAS)],
)
def test_what_is_bad_is_one_sentence_that_says_where(write, old, new, message, read):
    path = write(old, new)
    with pytest.raises(ValueError, match=escape(message)) as caught:
        read(path)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


def test_a_wrong_boolean_of_the_camera_does_not_keep_the_scene_from_being_read(write):
    assert len(ds.read_scene(write("fov = 35", 'local_viewer = "false"')).lights) == 2


@pytest.mark.parametrize("read", [ds.read_scene, ds.read_camera])
def test_what_is_no_file_or_no_toml(tmp_path, read):
    for path in (tmp_path / "nowhere.toml", tmp_path):
        with pytest.raises(FileNotFoundError, match=escape(f"there is no scene file {path}. Give the path of a TOML")):
            read(path)
    for content in (b"\xff\xfe", b"[[objects]", b"a = 1\na = 2"):
        (tmp_path / "scene.toml").write_bytes(content)
        with pytest.raises(ValueError, match=r"scene\.toml is no TOML: .*\. Mend that line\.$"):
            read(tmp_path / "scene.toml")


def test_arrays_over_the_pixels_stand_beside_the_file(tmp_path):
    """Those of a G-buffer and of a map come back exactly, from names in the file's own folder alone."""
    path, rng = tmp_path / "scene.toml", np.random.default_rng(0)
    normal = np.broadcast_to((0.0, 0.6, 0.8), (4, 5, 3))
    mask = rng.random((4, 5)) > 0.3
    for position in (None, rng.random((4, 5, 3))):
        surface = ds.GBuffer(normal, position, mask)
        scene = ds.Scene(ds.Object(surface, ds.Material(k_d=rng.random((4, 5, 3)), n_s=9.0)), ds.PointLight((1, 2, 3)))
        ds.write_scene(path, scene)
        assert_same(ds.read_scene(path), scene)
    names = {file.name for file in tmp_path.iterdir()} - {"scene.toml"}
    arrays = ("surface.normal", "surface.position", "surface.mask", "material.k_d")
    assert names == {f"scene.objects.0.{name}.npy" for name in arrays}
    text = path.read_text()
    path.write_text(text.replace("scene.objects.0.surface.normal", "../scene.objects.0.surface.normal"))
    with pytest.raises(ValueError, match=r"normal must be the name of a \.npy file beside it; got '\.\./scene"):
        ds.read_scene(path)
    path.write_text(text)
    cut = tmp_path / "scene.objects.0.surface.normal.npy"
    cut.write_bytes(cut.read_bytes()[:200])
    with pytest.raises(ValueError, match=r"surface\.normal\.npy is damaged: .* Write it again\.$"):
        ds.read_scene(path)
    cut.unlink()
    with pytest.raises(FileNotFoundError, match=r"surface\.normal\.npy\. Copy the whole folder"):
        ds.read_scene(path)


def test_a_texture_has_no_form_in_toml(tmp_path):
    path = tmp_path / "scene.toml"
    path.write_text("old")
    scene = ds.Scene(ds.Object(ds.Sphere(), ds.Material(k_d=ds.Texture(np.ones((2, 2))))))
    with pytest.raises(ValueError, match=r"a Texture has no form in TOML\. Write its arrays with numpy\.save"):
        ds.write_scene(path, scene)
    assert path.read_text() == "old"


SPECTRAL = """
bands = [450, 550, 650, 850]
[camera]
eye = [0, 0, 4]
[[objects]]
surface = "Sphere"
[objects.material]
n_s = 40
[objects.material.foley]
O_d = [0.1, 0.5, 0.9, 1.0]
k_a = 0.1
k_d = 0.6
k_s = 0.3
"""


def test_foleys_form_is_read_as_its_products_in_each_band(tmp_path):
    path = tmp_path / "ball.toml"
    path.write_text(SPECTRAL)
    scene = ds.read_scene(path)
    material = scene.objects[0].material
    np.testing.assert_allclose(material.k_d, 0.6 * np.array([0.1, 0.5, 0.9, 1.0]))
    np.testing.assert_allclose(material.k_s, [0.3] * 4)
    assert scene.bands == ("450nm", "550nm", "650nm", "850nm")
    ds.write_scene(tmp_path / "again.toml", scene)
    again = ds.read_scene(tmp_path / "again.toml")
    assert again.bands == scene.bands
    np.testing.assert_array_equal(again.objects[0].material.k_a, material.k_a)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("O_d = [0.1, 0.5, 0.9, 1.0]\n", "", ("foley", "O_d")),
        ("n_s = 40", "n_s = 40\nk_d = 0.5", ("material.k_d", "foley")),
        ("k_s = 0.3", "k_z = 0.3", ("foley", "k_z", "k_s")),
        ("k_s = 0.3", "k_s = -0.3", ("foley", "k_s", "at least 0")),
        ("k_s = 0.3", "k_s = [0.1, 0.2, 0.3]", ("foley", "k_s", "3 numbers", "4")),
        ("[450, 550, 650, 850]", "[450, 550, 650]", ("k_a", "4 numbers", "3 bands, 450nm to 650nm")),
    ],
)
def test_wrong_tables_of_foleys_form_are_refused(tmp_path, old, new, words):
    path = tmp_path / "ball.toml"
    path.write_text(SPECTRAL.replace(old, new))
    refuses(lambda: ds.read_scene(path), *words)
