"""A scene and its camera as TOML: back exactly as they were, and one sentence for what is wrong."""

from re import escape

import jax
import numpy as np
import pytest

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


def test_what_people_write_of_the_new_things(tmp_path):
    path = tmp_path / "scene.toml"
    path.write_text("""
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
    """)
    chequer = ds.Chequer(0.1, (0.9, 0.8, 0.7), smooth=True)
    ice = ds.Material(k_t=0.9, eta=1.5, fresnel=ds.Schlick(), k_d=chequer)
    objects = [
        ds.Object(ds.Box(size=(1, 2, 3)), ice, name="ice"),
        ds.Object(ds.Plane(), ds.Material(eta=1.5, fresnel=ds.Dielectric())),
    ]
    light = ds.AreaLight((0, 0, 2), (1, 0, 0), (0, 1, 0), samples=(4, 4))
    assert_same(ds.read_scene(path), ds.Scene(objects, light, atmosphere=ds.Fog(0.2, I_dc=0.5)))


def test_without_a_camera(tmp_path):
    path = tmp_path / "scene.toml"
    ds.write_scene(path, SCENE)
    assert_same(ds.read_scene(path), SCENE)
    message = f"{path} has no table [camera]. Add one, for example with eye = [0, 0, 4] and fov = 35."
    with pytest.raises(ValueError, match=f"^{escape(message)}$"):
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


def refusal(message):
    """One line that is the message, or begins with it where it does not end in a stop."""
    end = "$" if message.endswith((".", "?")) else "[^\n]*$"
    return pytest.raises(ValueError, match=f"^{escape(message)}{end}")


BAD = {
    # misspelt, at every level
    "a key of the scene": ("ambient", "ambiant", " has no key 'ambiant'. Did you mean 'ambient'?"),
    "the camera": ("[camera]", "[camra]", " has no key 'camra'. Did you mean 'camera'?"),
    "a key of an object": (
        "surface =",
        "surfase =",
        ": objects[0] has no key 'surfase'. Did you mean 'surface'?",
    ),
    "a key of a material": (
        "k_d =",
        "kd =",
        ": objects[0].material has no key 'kd'. Did you mean 'k_d'?",
    ),
    "a key of a surface": (
        '"Sphere"',
        "{ radios = 2 }",
        ": objects[0].surface has no key 'radios'. Did you mean 'radius'?",
    ),
    "a key of a light": (
        "position",
        "positon",
        ": lights[0] has no key 'positon'. Did you mean 'position'?",
    ),
    "a key of an attenuation": (
        "quadratic",
        "quadratik",
        ": lights[0].attenuation has no key 'quadratik'. Did you mean 'quadratic'?",
    ),
    "a key of a lobe": (
        '"Blinn"',
        '{ type = "Blinn", n_s = 3 }',
        ": objects[0].material.lobe has no key 'n_s'",
    ),
    "a type of surface": (
        '"Sphere"',
        '"Sphera"',
        ": objects[0].surface has no type 'Sphera'. Did you mean 'Sphere'?",
    ),
    "a type of lobe": (
        '"Blinn"',
        '"Blin"',
        ": objects[0].material.lobe has no type 'Blin'. Did you mean 'Blinn'?",
    ),
    "a type of light": (
        '"DirectionalLight"',
        '"DirectLight"',
        ": lights[1] has no type 'DirectLight'. Did you mean 'DirectionalLight'?",
    ),
    "a type like none": (
        '"DirectionalLight"',
        '"xyzzy"',
        ": lights[1] has no type 'xyzzy'. Known names: AreaLight, DirectionalLight, MeasuredLight, PointLight, "
        "SpotLight.",
    ),
    "a type that is no name": ('"DirectionalLight"', "5", ": lights[1] has no type '5'. Known names: "),
    "a type that is a list": ('"DirectionalLight"', '["a"]', ": lights[1] has no type '['a']'. Known names: "),
    # missing
    "no position": (
        "position = [2, 3, 4]\n",
        "",
        ": lights[0] needs the key 'position' of a PointLight. Add it.",
    ),
    "no surface": ('surface = "Sphere"\n', "", ": objects[0] needs the key 'surface' of a"),
    "no objects": (
        WRITTEN[WRITTEN.index("[[objects]]") : WRITTEN.index("[[lights]]")],
        "",
        " needs the key 'objects' of a Scene. Add it.",
    ),
    # of the wrong type
    "a number for a table": (
        "{ quadratic = 1 }",
        "1",
        ": lights[0].attenuation must be a table of constant, linear, quadratic, clamp; got 1. Write it as [table].",
    ),
    "a list for a table": (
        "{ quadratic = 1 }",
        "[1, 0, 1]",
        ": lights[0].attenuation must be a table of constant, linear, quadratic, clamp; got [1, 0, 1]. Write it as "
        "[table].",
    ),
    "an empty list for a table": (
        "{ quadratic = 1 }",
        "[]",
        ": lights[0].attenuation must be a table of constant, linear, quadratic, clamp; got []. Write it as [table].",
    ),
    "a list of tables for a table": (
        '"Sphere"',
        "[{ radius = 2 }]",
        ": objects[0].surface must be a table of center, radius; got [{'radius': 2}]. Write it as [table].",
    ),
    "no number": (
        "ambient = 0.3\n",
        "ambient = 0.3\nbackground = []\n",
        ": Scene.background must be a colour of 1 or 3 numbers; got shape (0,). Give one number (grey) or three (R, G, "
        "B).",
    ),
    "a string for a boolean": (
        "quadratic = 1",
        'quadratic = 1, clamp = "true"',
        ": lights[0].attenuation.clamp must be true or false; got 'true'. Write one of the two.",
    ),
    "a number for a boolean": (
        "quadratic = 1",
        "quadratic = 1, clamp = 1",
        ": lights[0].attenuation.clamp must be true or false; got 1. Write one of the two.",
    ),
    "a string for a number": (
        "k_d = 0.7",
        'k_d = "red"',
        ": objects[0].material: Material.k_d must be a colour of 1 or 3 numbers; got 'red'. Give one number (grey) or "
        "three (R, G, B).",
    ),
    # out of range
    "a negative number": (
        "k_d = 0.7",
        "n_s = -1",
        ": objects[0].material: Material.n_s must be at least 0; got -1. Give a value in that range.",
    ),
    "two numbers": (
        "[0.1, 0.2, 0.3]",
        "[0.1, 0.2]",
        ": objects[0].material: Material.k_s must be a colour of 1 or 3 numbers; got shape (2,). Give one number "
        "(grey) or three (R, G, B).",
    ),
    "not finite": (
        "[2, 3, 4]",
        "[2, nan, 4]",
        ": lights[0]: PointLight.position must be finite; got (2, nan, 4). Give three numbers (x, y, z).",
    ),
    "no direction": (
        "[0, 0, -1]",
        "[0, 0, 0]",
        ": lights[1]: DirectionalLight.direction must not be the zero vector; got [0, 0, 0]. Give the way the light "
        "travels.",
    ),
    "no attenuation": (
        "{ quadratic = 1 }",
        "{ constant = 0 }",
        ": lights[0].attenuation: RadialAttenuation needs one of constant, linear and quadratic above 0; got 0, 0 and "
        "0. Give constant=1 for no attenuation.",
    ),
    # patterns, air, transparency
    "a key of a pattern": (
        "k_d = 0.7",
        "k_d = { a = 1, b = 0, perod = 2 }",
        ": objects[0].material.k_d has no key 'perod'. Did you mean 'period'?",
    ),
    "half a pattern": (
        "k_d = 0.7",
        "k_d = { a = 1 }",
        ": objects[0].material.k_d needs the key 'b' of a Chequer. Add it.",
    ),
    "no period": (
        "k_d = 0.7",
        "k_d = { a = 1, b = 0, period = 0 }",
        ": objects[0].material.k_d: Chequer.period must be above 0; got 0.0. Give the length of two squares.",
    ),
    "a string for a pattern's boolean": (
        "k_d = 0.7",
        'k_d = { a = 1, b = 0, smooth = "yes" }',
        ": objects[0].material.k_d.smooth must be true or false; got 'yes'. Write one of the two.",
    ),
    "a type of air": (
        "ambient = 0.3",
        'atmosphere = "Fogg"',
        ": atmosphere has no type 'Fogg'. Did you mean 'Fog'?",
    ),
    "air that begins where it ends": (
        "ambient = 0.3",
        "atmosphere = { z_f = 3, z_b = 2 }",
        ": atmosphere: DepthCueing.z_f must be less than z_b; got 3.0 and 2.0. Give the nearer one as z_f.",
    ),
    "a type of Fresnel": (
        "k_d = 0.7",
        'fresnel = "Schlik"',
        ": objects[0].material.fresnel has no type 'Schlik'. Did you mean 'Schlick'?",
    ),
    "more than all is let through": (
        "k_d = 0.7",
        "k_t = 1.5",
        ": objects[0].material: Material.k_t must be between 0 and 1; got (1.5, 1.5, 1.5). Give a value in that range.",
    ),
    "a name of two words": (
        'surface = "Sphere"',
        'surface = "Sphere"\nname = "my ball"',
        ": objects[0]: Object.name must be one word, of letters, digits and _; got 'my ball'. Rename it.",
    ),
    "a name that is a number": (
        'surface = "Sphere"',
        'surface = "Sphere"\nname = 5',
        ": objects[0].name must be a word; got 5. Write it in quotes.",
    ),
    "a box without a size": (
        '"Sphere"',
        '{ type = "Box", size = [1, 0, 1] }',
        ": objects[0].surface: Box.size must be above 0; got [1. 0. 1.]. Give width, height and depth in scene units.",
    ),
    # not TOML
    "not TOML": ("ambient = 0.3", "ambient 0.3", " is no TOML: "),
}


@pytest.mark.parametrize(("old", "new", "message"), BAD.values(), ids=BAD)
def test_a_bad_scene_is_one_sentence_that_says_where(write, old, new, message):
    path = write(old, new)
    with refusal(f"{path}{message}"):
        ds.read_scene(path)


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ("direction = [0, -1, 0]", "has no key 'direction'. Write type = \"DirectionalLight\"."),
        ("position = [0, 3, 0]\ndirection = [0, -1, 0]", "has no key 'direction'. Write type = \"SpotLight\"."),
        ("corner = [0, 3, 0]\nedge_u = [1, 0, 0]", "has no key 'corner'. Write type = \"AreaLight\"."),
    ],
)
def test_a_light_without_a_type_that_is_no_point_light_says_which_it_may_be(tmp_path, keys, message):
    path = tmp_path / "scene.toml"
    path.write_text(f'[[objects]]\nsurface = "Sphere"\n[[lights]]\n{keys}\n', encoding="utf-8")
    with refusal(f"{path}: lights[0] without a type is a PointLight, which {message}"):
        ds.read_scene(path)


BAD_CAMERAS = {
    "a misspelt key": ("fov", "fow", ": camera has no key 'fow'. Did you mean 'fov'?"),
    "a misspelt type": (
        "[camera]",
        '[camera]\ntype = "Ortographic"',
        ": camera has no type 'Ortographic'. Did you mean 'OrthographicCamera'?",
    ),
    "a key of the other type": (
        "[camera]",
        '[camera]\ntype = "OrthographicCamera"',
        ": camera has no key 'fov'. Known names: eye, height, local_viewer, shape, target, up.",
    ),
    "no eye": ("eye = [0, 0, 4]\n", "", ": camera needs the key 'eye' of a Camera. Add it."),
    "a string for a boolean": (
        "fov = 35",
        'local_viewer = "false"',
        ": camera.local_viewer must be true or false; got 'false'. Write one of the two.",
    ),
    "out of range": (
        "fov = 35",
        "fov = 180",
        ": camera: Camera.fov must be above 0 and below 180 degrees; got 180.0. Give the full angle.",
    ),
    "a shape of three": (
        "[12, 16]",
        "[12, 16, 3]",
        ": camera: Camera.shape must be (height, width) in pixels, two whole numbers above 0; got [12, 16, 3]. "
        "Give the image's shape[:2].",
    ),
    "a list of cameras": ("[camera]", "[[camera]]", ": camera must be a table of eye, target, up, fov, shape, local_"),
}


@pytest.mark.parametrize(("old", "new", "message"), BAD_CAMERAS.values(), ids=BAD_CAMERAS)
def test_a_bad_camera_is_one_sentence_that_says_where(write, old, new, message):
    path = write(old, new)
    with refusal(f"{path}{message}"):
        ds.read_camera(path)


def test_a_wrong_boolean_of_the_camera_does_not_keep_the_scene_from_being_read(write):
    assert len(ds.read_scene(write("fov = 35", 'local_viewer = "false"')).lights) == 2


@pytest.mark.parametrize("read", [ds.read_scene, ds.read_camera])
def test_no_file(tmp_path, read):
    for path in (tmp_path / "nowhere.toml", tmp_path):
        message = f"there is no scene file {path}. Give the path of a TOML file."
        with pytest.raises(FileNotFoundError, match=f"^{escape(message)}$"):
            read(path)


@pytest.mark.parametrize("content", [b"\xff\xfe", b"[[objects]", b"a = 1\na = 2"])
@pytest.mark.parametrize("read", [ds.read_scene, ds.read_camera])
def test_no_toml(tmp_path, read, content):
    path = tmp_path / "scene.toml"
    path.write_bytes(content)
    with pytest.raises(ValueError, match=r"scene\.toml is no TOML: .*\. Mend that line\.$"):
        read(path)


def test_a_gbuffer_has_no_form_in_toml(tmp_path):
    path = tmp_path / "scene.toml"
    path.write_text("old")
    scene = ds.Scene(ds.Object(ds.GBuffer(np.full((2, 2, 3), (0, 0, 1)))))
    message = "a GBuffer has no form in TOML. Write its arrays with numpy.save, and the rest as a scene."
    with pytest.raises(ValueError, match=f"^{escape(message)}$"):
        ds.write_scene(path, scene)
    assert path.read_text() == "old"


def test_a_named_material_is_to_be_written_out(tmp_path):
    path = tmp_path / "scene.toml"
    path.write_text('[[objects]]\nsurface = "Sphere"\nmaterial = "jade"\n')
    message = (
        f"{path}: objects[0].material must be a table of coefficients; got 'jade'. Write them out, as write_scene does "
        "those of material('jade')."
    )
    with pytest.raises(ValueError, match=f"^{escape(message)}$"):
        ds.read_scene(path)
