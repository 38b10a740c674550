"""Other programs that render what `write_material` writes: points with given normals, seen from +z, lit from a side."""

import functools
import http.server
import json
import os
import shutil
import subprocess
import threading
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

HERE = Path(__file__).parent
WIDTH = 24
THREE = Path(os.environ.get("DIFFSHADE_THREE", HERE.parent / "node_modules" / "three"))
VALIDATOR = Path(os.environ.get("DIFFSHADE_GLTF_VALIDATOR", HERE.parent / "node_modules" / "gltf-validator"))
BROWSER = [
    *("--headless", "--no-sandbox", "--no-first-run", "--no-proxy-server", "--remote-debugging-port=0"),
    *("--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"),
    *("--disable-background-networking", "--disable-component-update", "--disable-sync"),
]


class View:
    """Points under one light: normals, padded to whole rows of `WIDTH`, and the unit direction to the light."""

    def __init__(self, normals: np.ndarray, light: np.ndarray):
        self.count, self.light = len(normals), light
        self.height = -(-len(normals) // WIDTH)
        padding = np.tile([0.0, 0.0, 1.0], (self.height * WIDTH - len(normals), 1))
        self.normals = np.concatenate([normals, padding])

    @property
    def positions(self) -> np.ndarray:
        """The centre of each point's pixel, row 0 at the bottom, in -1 to 1."""
        row, column = np.divmod(np.arange(len(self.normals)), WIDTH)
        x, y = (2 * column + 1) / WIDTH - 1, (2 * row + 1) / self.height - 1
        return np.stack([x, y, 0 * x], -1)


def needs(program: str) -> str:
    found = shutil.which(program)
    if not found:
        pytest.skip(f"{program} is not installed; this format is proved by what it renders.")
    return found


def ran(command: Sequence[str], **options) -> subprocess.CompletedProcess:
    done = subprocess.run(command, capture_output=True, timeout=600, **options)
    assert done.returncode == 0, f"{command[0]} ended with {done.returncode}: {done.stderr[-400:]}"
    return done


def opengl_program(folder: Path, file: Path, name: str, *, own_lights: bool = False) -> Path:
    compiler = needs("gcc")
    macros = [f'-DMATERIAL_FILE="{file}"', f"-DMATERIAL_CALL={name}_material"]
    macros += [f"-DLIGHTS_CALL={name}_lights"] * own_lights
    source, program = folder / "gl.c", folder / "gl"
    source.write_text("#include <GL/osmesa.h>\nint main(void) { return 0; }\n")
    if subprocess.run([compiler, source, "-o", program, "-lOSMesa"], capture_output=True).returncode:
        pytest.skip("OSMesa is not installed; OpenGL's fixed function is proved by what Mesa renders.")
    ran([compiler, "-Wall", "-Werror", *macros, str(HERE / "exchange_gl.c"), "-o", str(program), "-lOSMesa", "-lm"])
    return program


def opengl_draw(program: Path, views: Sequence[View], positions: np.ndarray | None = None) -> list[np.ndarray]:
    """Render each view, or one of given positions with the program's own lights."""
    images = []
    for view in views:
        points = np.concatenate([view.positions if positions is None else positions, view.normals], 1)
        rows = [
            f"{int(positions is not None)} {WIDTH} {view.height} 1",
            *(" ".join(map(repr, p)) for p in points.tolist()),
        ]
        text = "\n".join([*rows, " ".join(map(repr, view.light.tolist()))])
        raw = ran([str(program)], input=text.encode()).stdout
        images.append(np.frombuffer(raw, np.float32).reshape(-1, 3)[: view.count].astype(float))
    return images


def opengl(folder: Path, file: Path, views: Sequence[View]) -> list[np.ndarray]:
    return opengl_draw(opengl_program(folder, file, "ball"), views)


DISC = "disc {{ <{x!r}, {y!r}, 0>, <{n[0]!r}, {n[1]!r}, {n[2]!r}>, {r!r} texture {{ ball }} no_shadow }}"
POVRAY = """#version 3.7;
global_settings {{ assumed_gamma 1 ambient_light rgb 1 }}
#include "{file}"
camera {{ orthographic location <0, 0, 4> direction <0, 0, -1> right <-2, 0, 0> up <0, 2, 0> }}
light_source {{ <{l[0]!r}, {l[1]!r}, {l[2]!r}> * 1000 color rgb 1 parallel point_at 0 }}
plane {{ z, 3 pigment {{ rgbf <{dim}, {dim}, {dim}, 1> }} finish {{ ambient 0 diffuse 0 }} no_shadow }}
"""


def povray(folder: Path, file: Path, views: Sequence[View]) -> list[np.ndarray]:
    """Discs that face along the normals, in 16 bits, seen through a dark glass so that none is above 1."""
    program, dim, images = needs("povray"), 0.25, []
    for i, view in enumerate(views):
        radius = 0.4 / max(WIDTH, view.height)
        places = zip(view.positions.tolist(), view.normals.tolist(), strict=True)
        discs = [DISC.format(x=-p[0], y=p[1], n=[-n[0], n[1], n[2]], r=radius) for p, n in places]  # left-handed
        light = (view.light * (-1, 1, 1)).tolist()
        scene, out = folder / f"view{i}.pov", folder / f"view{i}.ppm"
        scene.write_text(POVRAY.format(file=file, l=light, dim=dim) + "\n".join(discs))
        options = [f"+W{WIDTH}", f"+H{view.height}", "-A", "-D", "+FP16", "File_Gamma=1.0", "Work_Threads=1"]
        ran([program, f"+I{scene}", f"+O{out}", *options], cwd=folder)
        pixels = np.frombuffer(out.read_bytes()[-view.height * WIDTH * 6 :], ">u2").reshape(view.height, WIDTH, 3)
        images.append(pixels[::-1].reshape(-1, 3)[: view.count] / 65535 / dim)
    return images


# A float over 8 packed into three bytes, since VTK's frame buffer has no more.
PACKED = """//VTK::Light::Impl
  vec3 packed_ = fract(fragOutput0.{channel} / 8.0 * vec3(1.0, 255.0, 65025.0));
  fragOutput0 = vec4(packed_ - packed_.yzz * vec3(1.0 / 255.0, 1.0 / 255.0, 0.0), 1.0);
"""


def vtk(folder: Path, file: Path, views: Sequence[View]) -> list[np.ndarray]:
    vtk = pytest.importorskip("vtk", reason="vtk is not installed; its format is proved by what it renders.")
    from vtk.util.numpy_support import numpy_to_vtk, vtk_to_numpy  # pyright: ignore[reportMissingImports]

    code: dict = {}
    exec(compile(file.read_text(), str(file), "exec"), code)
    images = []
    for view in views:
        data, points, quads = vtk.vtkPolyData(), vtk.vtkPoints(), vtk.vtkCellArray()
        corners = np.array([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)]) / (WIDTH, view.height, 1)
        for k, corner in enumerate((view.positions[:, None] + corners).reshape(-1, 3)):
            points.InsertNextPoint(corner)
            if k % 4 == 3:
                quads.InsertNextCell(4, [k - 3, k - 2, k - 1, k])
        data.SetPoints(points)
        data.SetPolys(quads)
        normals = numpy_to_vtk(np.repeat(view.normals, 4, 0).astype(np.float32), deep=True)
        data.GetPointData().SetNormals(normals)
        mapper, light, renderer, window = (
            vtk.vtkPolyDataMapper(),
            vtk.vtkLight(),
            vtk.vtkRenderer(),
            vtk.vtkRenderWindow(),
        )
        mapper.SetInputData(data)
        light.SetLightTypeToSceneLight()
        light.SetPosition(*view.light)
        light.SetFocalPoint(0, 0, 0)
        renderer.AddLight(light)
        renderer.SetBackground(0, 0, 0)
        camera = renderer.GetActiveCamera()
        camera.SetPosition(0, 0, 1e6)  # VTK's viewer stands somewhere in parallel projection too
        camera.ParallelProjectionOn()
        camera.SetParallelScale(1)
        window.SetOffScreenRendering(1)
        window.SetMultiSamples(0)
        window.SetSize(WIDTH, view.height)
        window.AddRenderer(renderer)
        camera.SetUseExplicitAspectRatio(True)
        camera.SetExplicitAspectRatio(1.0)
        channels = []
        for channel in "rgb":
            actor = vtk.vtkActor()
            actor.SetMapper(mapper)
            code["set_ball"](actor.GetProperty())
            actor.GetShaderProperty().AddFragmentShaderReplacement(
                "//VTK::Light::Impl", False, PACKED.format(channel=channel), False
            )
            renderer.AddActor(actor)
            renderer.ResetCameraClippingRange()
            shot = vtk.vtkWindowToImageFilter()
            shot.SetInput(window)
            shot.Update()
            raw = shot.GetOutput().GetPointData().GetScalars()
            channels.append(vtk_to_numpy(raw).reshape(-1, 3)[: view.count] @ [1.0, 1 / 255, 1 / 65025] / 255 * 8)
            renderer.RemoveActor(actor)
        images.append(np.stack(channels, -1))
        window.Finalize()
    return images


def threejs(folder: Path, files: dict[str, str], views: dict[str, list[View]]) -> dict[str, list[np.ndarray]]:
    """Render several files of a folder, each with the views of its name, in one run of a browser."""
    height = max(view.height for of in views.values() for view in of)
    lists = {
        name: [{"normals": view.normals[: view.count].tolist(), "light": view.light.tolist()} for view in of]
        for name, of in views.items()
    }
    (folder / "cases.json").write_text(json.dumps({"files": files, "views": lists, "width": WIDTH, "height": height}))
    answer = in_browser(folder, HERE / "exchange_three.js")
    return {file: [np.array(image) for image in images] for file, images in json.loads(answer).items()}


def in_browser(folder: Path, script: Path) -> str:
    """Serve a folder with three.js in it, and return what a script posts, in a browser."""
    browser = needs("chromium")
    if not (THREE / "build" / "three.module.js").is_file():
        pytest.skip(f"three.js is not at {THREE}; run npm install three, or set DIFFSHADE_THREE to its folder.")
    shutil.copy(script, folder / "main.js")
    shutil.copy(HERE / "three_renderer.js", folder)
    imports = {"three": "/three/build/three.module.js", "three/addons/": "/three/examples/jsm/"}
    page = f'<!DOCTYPE html><script type="importmap">{json.dumps({"imports": imports})}</script>'
    (folder / "index.html").write_text(f'{page}<script type="module" src="main.js"></script>')
    if not (folder / "three").exists():
        (folder / "three").symlink_to(THREE.resolve(), target_is_directory=True)
    answers: list[str] = []
    came = threading.Event()

    class Handler(http.server.SimpleHTTPRequestHandler):
        def do_POST(self):
            answers.append(self.rfile.read(int(self.headers["Content-Length"])).decode())
            self.send_response(200)
            self.end_headers()
            came.set()

    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), functools.partial(Handler, directory=str(folder))) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        address = f"http://127.0.0.1:{server.server_port}/index.html"
        profile = folder / "profile"
        with open(folder / "browser.log", "wb") as log:
            process = subprocess.Popen(
                [browser, *BROWSER, f"--user-data-dir={profile}", address],
                stdout=log,
                stderr=log,
            )
            try:
                assert came.wait(300), f"the browser gave no answer: {(folder / 'browser.log').read_text()[-2000:]}"
            finally:
                process.terminate()
                process.wait(30)
                server.shutdown()
    assert not answers[0].startswith("failed"), answers[0]
    return answers[0]


def validated(path: Path) -> dict:
    """What Khronos's validator says of a glTF file."""
    if shutil.which("node") is None or not VALIDATOR.is_dir():
        pytest.skip(f"gltf-validator is not at {VALIDATOR}; run npm install gltf-validator.")
    script = (
        "const v = require(process.argv[1]), fs = require('fs'), path = require('path'), f = process.argv[2];"
        "const read = (name) => new Uint8Array(fs.readFileSync(name));"
        "const beside = (uri) => Promise.resolve(read(path.join(path.dirname(f), decodeURIComponent(uri))));"
        "v.validateBytes(read(f), { externalResourceFunction: beside })"
        ".then((r) => console.log(JSON.stringify(r.issues)));"
    )
    done = subprocess.run(["node", "-e", script, VALIDATOR, path], capture_output=True, text=True, check=True)
    return json.loads(done.stdout)


def assert_valid(path):
    found = validated(path)
    assert found["numErrors"] == found["numWarnings"] == 0, found["messages"]
