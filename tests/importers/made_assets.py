"""Files that a cfg of OAISYS names, made small."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
from PIL import Image

from scenec.schemas.exr import write_rgb

#: Run apart: Blender, which makes a hill of 12 m by 12 m and a stone of two materials.
_BLENDER = """
import sys
from math import cos
import bpy

def save(name, build):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    build()
    bpy.ops.wm.save_as_mainfile(filepath=name)

def linked(name, points, faces):
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(points, [], faces)
    made = bpy.data.objects.new(name, mesh)
    bpy.context.scene.collection.objects.link(made)
    return mesh

def hill():
    n = 13
    ends = range(-6, 7)
    points = [(x, y, cos(x / 4) * cos(y / 4)) for y in ends for x in ends]
    corners = [y * n + x for y in range(n - 1) for x in range(n - 1)]
    faces = [(i, i + 1, i + n + 1, i + n) for i in corners]
    linked("hill", points, faces)

def stone():
    points = [(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0), (0, 0, 1)]
    mesh = linked("stone", points, [(0, 3, 2, 1), (0, 1, 4), (1, 2, 4), (2, 3, 4), (3, 0, 4)])
    for name in ("body", "moss"):
        mesh.materials.append(bpy.data.materials.new(name))
    mesh.polygons[1].material_index = 1

save(sys.argv[1], hill)
save(sys.argv[2], stone)
"""


def make_assets(folder: Path) -> None:
    """All files of ``data/oaisys_2021.json``."""
    for name in ("hdris", "templates", "textures/sand", "textures/pebbles", "stages", "meshes"):
        (folder / name).mkdir(parents=True)
    bright = np.full((8, 16, 3), 0.5, np.float32)
    for name in ("noon", "dusk"):
        write_rgb(folder / f"hdris/{name}.exr", bright)
    labels = np.zeros((8, 16, 3), np.uint8)
    labels[:4], labels[4:6] = (238, 236, 37), (224, 74, 0)
    Image.fromarray(labels).save(folder / "hdris/noon_labels.png")
    gray = Image.fromarray(np.arange(256, dtype=np.uint8).reshape(16, 16))
    for name in ("sand_COL.png", "sand_GLOSS.png"):
        gray.convert("RGB" if "COL" in name else "L").save(folder / "textures/sand" / name)
    for name in ("p_diff.png", "p_nor_dx.png", "p_rough.png", "p_disp.png"):
        mode = "L" if "rough" in name or "disp" in name else "RGB"
        gray.convert(mode).save(folder / "textures/pebbles" / name)
    (folder / "templates/pebbles.json").write_text(
        '{"path": "textures/pebbles", "diffuse": true, "normal": true, "displacement": true,\n'
        ' "normalStrength": 1.0, "size": 6.0, "dispStrength": 0.1,\n'
        ' "dispColorStopColor_0": [0, 0, 0, 1], "dispColorStopColor_1": [0.2, 0.2, 0.2, 1]}\n'
    )
    (folder / "poses.csv").write_text(
        "1,0,-4,1.5,0.7071068,-0.7071068,0,0\n2,1,-4,1.5,0.7071068,-0.7071068,0,0\n"
    )
    files = [str(folder / name) for name in ("stages/hill.blend", "meshes/stones.blend")]
    subprocess.run([sys.executable, "-c", _BLENDER, *files], check=True, capture_output=True)
