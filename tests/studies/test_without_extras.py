"""The main job without any extra: render, fit, and write a report."""

import subprocess
import sys


def test_rendering_fitting_and_a_report_need_none(tmp_path):
    program = f"""
import sys
for package in ("cv2", "matplotlib", "OpenEXR", "pyamg", "rawpy", "tifffile", "trimesh", "zarr"):
    sys.modules[package] = None
import diffshade as ds
scene = ds.Scene(ds.Object(ds.Sphere(), ds.Material(k_d=0.5)), ds.DirectionalLight((0, 0, -1)))
camera = ds.Camera((0, 0, 4), shape=(16, 16))
ds.write_image(r"{tmp_path}/a.png", ds.render(scene, camera))
view = ds.View(ds.read_image(r"{tmp_path}/a.png"), camera)
ds.write_report(r"{tmp_path}/a.html", ds.fit(scene, [view], free=("k_d",)))
"""
    subprocess.run([sys.executable, "-c", program], check=True)
    assert "<svg" in (tmp_path / "a.html").read_text(encoding="utf-8")
