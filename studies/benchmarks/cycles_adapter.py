"""Cycles on a compiled cfg: seconds an annotated frame, and the adapter beside bare Blender.

    python studies/benchmarks/cycles_adapter.py [--cfg CFG | --stage STAGE] [--spp N] [--rounds N]

Two processes hold the same stage's arrays: one the adapter, one a bare script as Blender's
documentation would have one write (a Geometry Nodes instancer, mixed shaders, a sun, an
environment texture, ``bpy.ops.render.render``). Both draw what the bare script can: no maps, no
metals, no haze, no lamps, nothing that moves, the sky's picture as it is; where their mean radiance
differs by more than 2 %, the table compares different pictures, and the status is 1. They are asked
in turns (adapter, bare, adapter, bare ...), so that a busy machine is busy for both; the table has
medians and medians of the paired ratios.
"""

from __future__ import annotations

import argparse
import json
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from scenec.backends.contract import BOUNCES
from scenec.backends.stage.read import read_stage
from scenec.backends.stage.scene import Dome, Lighting, Mesh, RenderScene

ROOT = Path(__file__).resolve().parents[2]
PASSES = ("depth", "label", "instance")
#: Dome's frame (pole +Y) to world without a turn about the vertical: all that the script knows.
UPRIGHT = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])


def plain(scene: RenderScene) -> RenderScene:
    """What the bare script can draw of a scene, for both."""
    surfaces = tuple(
        replace(
            surface, maps=None, metallic=0.0, roughness_variation=0.0, reflectance=None,
            emission=(0.0, 0.0, 0.0),
        )
        for surface in scene.surfaces
    )  # fmt: skip
    lighting = tuple(
        Lighting(
            light.suns,
            tuple(Dome(d.texture, np.ones(3), UPRIGHT) for d in light.domes if d.texture)[:1],
        )
        for light in scene.lighting
    )
    meshes = tuple(replace(mesh, uv=None, height_blends=()) for mesh in scene.meshes)
    # What moves stays where it is at the first sample.
    rows = replace(scene.rows, motion=None)
    return replace(
        scene, surfaces=surfaces, lighting=lighting, meshes=meshes, rows=rows, haze=()
    )  # fmt: skip


class Adapter:
    """The backend."""

    def __init__(self, scene: RenderScene) -> None:
        from scenec.backends.cycles import Cycles

        self.scene, self.backend = scene, Cycles()

    def load(self) -> None:
        """Build the scene."""
        self.backend.load(self.scene)

    def visibility(self, sample: int) -> dict[str, float]:
        """Row and face of each pixel."""
        from scenec.backends.camera.rays import camera_rays

        camera = self.scene.cameras[sample][0]
        rays = camera_rays(camera)
        start = time.perf_counter()
        self.backend.witness(rays, sample, camera)
        return {"seconds": time.perf_counter() - start}

    def radiance(self, sample: int, spp: int, seed: int) -> dict[str, float]:
        """One picture, its light made anew."""
        camera = self.scene.cameras[sample][0]
        start = time.perf_counter()
        radiance = self.backend.radiance(camera, sample, spp, seed)
        return {
            "seconds": time.perf_counter() - start,
            "mean": float(radiance.halves.mean()),
        }


class Bare:
    """Blender by hand on the same arrays."""

    def __init__(self, scene: RenderScene) -> None:
        import bpy

        bpy.ops.wm.read_factory_settings(use_empty=True)
        self.bpy, self.scene, self.target = bpy, scene, bpy.context.scene
        self.center = 0.5 * (scene.bounds[0] + scene.bounds[1])

    def load(self) -> None:
        """Build the scene."""
        bpy, target = self.bpy, self.target
        collection = bpy.data.collections.new("prototypes")
        materials: dict[tuple[int, ...], Any] = {}
        for index, mesh in enumerate(self.scene.meshes):
            made = self._mesh(f"{index:06d}", mesh)
            if mesh.layers not in materials:
                materials[mesh.layers] = self._material(mesh.layers)
            made.materials.append(materials[mesh.layers])
            collection.objects.link(bpy.data.objects.new(f"{index:06d}", made))
        target.collection.objects.link(self._instancer(collection))
        camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
        target.collection.objects.link(camera)
        target.camera = camera
        render, cycles = target.render, target.cycles
        render.engine, render.use_persistent_data, render.film_transparent = "CYCLES", True, True
        for name in ("row", "face"):
            made = target.view_layers[0].aovs.add()
            made.name, made.type = name, "COLOR"
        render.image_settings.media_type = "MULTI_LAYER_IMAGE"
        render.image_settings.file_format = "OPEN_EXR_MULTILAYER"
        render.image_settings.color_depth, render.image_settings.exr_codec = "32", "NONE"
        cycles.use_adaptive_sampling = cycles.use_denoising = cycles.use_auto_tile = False
        cycles.pixel_filter_type = "BOX"
        cycles.diffuse_bounces = cycles.glossy_bounces = cycles.min_light_bounces = BOUNCES
        cycles.sample_clamp_indirect = cycles.blur_glossy = cycles.light_sampling_threshold = 0.0

    def _mesh(self, name: str, mesh: Mesh) -> Any:
        made = self.bpy.data.meshes.new(name)
        count = len(mesh.faces)
        made.vertices.add(len(mesh.points))
        made.loops.add(3 * count)
        made.polygons.add(count)
        made.vertices.foreach_set("co", mesh.points.ravel())
        made.loops.foreach_set("vertex_index", mesh.faces.ravel())
        made.polygons.foreach_set("loop_start", np.arange(0, 3 * count, 3, dtype=np.int32))
        columns = {"weight_" + str(i): w for i, w in enumerate(mesh.weights)}
        if mesh.variation is not None:
            columns["variation"] = mesh.variation
        for key, values in columns.items():
            made.attributes.new(key, "FLOAT", "POINT").data.foreach_set(
                "value", np.ascontiguousarray(values)
            )
        faces = made.attributes.new("face", "FLOAT", "FACE")
        faces.data.foreach_set("value", np.arange(count, dtype=np.float32))
        if mesh.normals is not None:
            normals = made.attributes.new("custom_normal", "FLOAT_VECTOR", "POINT")
            normals.data.foreach_set("vector", mesh.normals.ravel())
        made.update(calc_edges=True)
        return made

    def _instancer(self, collection: Any) -> Any:
        bpy, rows = self.bpy, self.scene.rows
        matrices = np.zeros((len(rows.mesh), 4, 4), np.float32)
        matrices[:, :3, :3] = rows.to_world[:, :, :3].transpose(0, 2, 1)
        matrices[:, 3, :3] = rows.to_world[:, :, 3] - self.center
        matrices[:, 3, 3] = 1.0
        points = bpy.data.meshes.new("rows")
        points.vertices.add(len(rows.mesh))
        for name, kind, field, values in (
            ("matrix", "FLOAT4X4", "value", matrices),
            ("mesh", "INT", "value", rows.mesh),
            ("row", "FLOAT", "value", np.arange(1, len(rows.mesh) + 1, dtype=np.float32)),
            ("row_variation", "FLOAT", "value", rows.variation),
        ):
            points.attributes.new(name, kind, "POINT").data.foreach_set(field, values.ravel())
        group = bpy.data.node_groups.new("rows", "GeometryNodeTree")
        for way in ("INPUT", "OUTPUT"):
            group.interface.new_socket("Geometry", in_out=way, socket_type="NodeSocketGeometry")
        new, link = group.nodes.new, group.links.new
        given, out = new("NodeGroupInput"), new("NodeGroupOutput")
        children, instances = new("GeometryNodeCollectionInfo"), new("GeometryNodeInstanceOnPoints")
        placed = new("GeometryNodeSetInstanceTransform")
        children.inputs[0].default_value = collection
        children.inputs[1].default_value = children.inputs[2].default_value = True
        instances.inputs["Pick Instance"].default_value = True
        which, matrix = (new("GeometryNodeInputNamedAttribute") for _ in range(2))
        which.data_type, which.inputs[0].default_value = "INT", "mesh"
        matrix.data_type, matrix.inputs[0].default_value = "FLOAT4X4", "matrix"
        link(given.outputs[0], instances.inputs["Points"])
        link(children.outputs[0], instances.inputs["Instance"])
        link(which.outputs[0], instances.inputs["Instance Index"])
        link(instances.outputs[0], placed.inputs["Instances"])
        link(matrix.outputs[0], placed.inputs["Transform"])
        link(placed.outputs[0], out.inputs[0])
        made = bpy.data.objects.new("rows", points)
        made.modifiers.new("rows", "NODES").node_group = group
        return made

    def _material(self, layers: tuple[int, ...]) -> Any:
        tree_of = self.bpy.data.materials.new("look")
        tree_of.cycles.use_bump_map_correction = False
        tree = tree_of.node_tree
        tree.nodes.clear()
        new, link = tree.nodes.new, tree.links.new

        def attribute(name: str, kind: str = "GEOMETRY") -> Any:
            node = new("ShaderNodeAttribute")
            node.attribute_name, node.attribute_type = name, kind
            return node.outputs["Fac"]

        def times_variation(name: str, kind: str, amount: float) -> Any:
            node = new("ShaderNodeMath")
            node.operation = "MULTIPLY_ADD"
            link(attribute(name, kind), node.inputs[0])
            node.inputs[1].default_value, node.inputs[2].default_value = amount, 1.0
            return node.outputs[0]

        below: Any = None
        for number, index in enumerate(layers):
            surface = self.scene.surfaces[index]
            factor, scale = new("ShaderNodeMath"), new("ShaderNodeVectorMath")
            factor.operation, scale.operation = "MULTIPLY", "SCALE"
            link(times_variation("variation", "GEOMETRY", surface.variation), factor.inputs[0])
            link(times_variation("row_variation", "INSTANCER", surface.variation), factor.inputs[1])
            scale.inputs[0].default_value = surface.base_color
            link(factor.outputs[0], scale.inputs["Scale"])
            diffuse, glossy, both = (
                new(f"ShaderNode{kind}") for kind in ("BsdfDiffuse", "BsdfGlossy", "MixShader")
            )
            glossy.distribution = "GGX"
            glossy.inputs["Color"].default_value = (1.0, 1.0, 1.0, 1.0)
            glossy.inputs["Roughness"].default_value = surface.roughness
            link(scale.outputs[0], diffuse.inputs["Color"])
            both.inputs[0].default_value = surface.specular
            link(diffuse.outputs[0], both.inputs[1])
            link(glossy.outputs[0], both.inputs[2])
            if below is None:
                below = both.outputs[0]
            else:
                merged = new("ShaderNodeMixShader")
                link(attribute(f"weight_{number - 1}"), merged.inputs[0])
                link(below, merged.inputs[1])
                link(both.outputs[0], merged.inputs[2])
                below = merged.outputs[0]
        link(below, new("ShaderNodeOutputMaterial").inputs[0])
        for name, kind in (("row", "INSTANCER"), ("face", "GEOMETRY")):
            out = new("ShaderNodeOutputAOV")
            out.aov_name = name
            link(attribute(name, kind), out.inputs["Color"])
        return tree_of

    def _light(self, sample: int) -> None:
        bpy, lighting = self.bpy, self.scene.lighting[sample]
        for old in [o for o in self.target.collection.objects if o.type == "LIGHT"]:
            bpy.data.objects.remove(old)
        for sun in lighting.suns:
            light = bpy.data.lights.new("sun", "SUN")
            light.energy = float(sun.irradiance.max())
            light.color = (sun.irradiance / sun.irradiance.max()).tolist()
            light.angle = sun.diameter_rad
            made = bpy.data.objects.new("sun", light)
            x, y, z = sun.to_light
            made.rotation_euler = (np.arccos(z), 0.0, np.arctan2(y, x) + np.pi / 2)
            self.target.collection.objects.link(made)
        world = bpy.data.worlds.new("sky")
        nodes, link = world.node_tree.nodes, world.node_tree.links.new
        background = next(n for n in nodes if n.type == "BACKGROUND")
        for dome in lighting.domes:
            if dome.texture is not None:
                node = nodes.new("ShaderNodeTexEnvironment")
                node.image = bpy.data.images.load(str(dome.texture))
                node.texture_mapping.rotation[2] = np.pi / 2
                link(node.outputs[0], background.inputs[0])
        self.target.world = world

    def _render(self, sample: int) -> dict[str, Any]:
        import mathutils
        import OpenEXR

        camera, render = self.scene.cameras[sample][0], self.target.render
        data = self.target.camera.data
        render.resolution_x, render.resolution_y = camera.width, camera.height
        k = camera.intrinsics
        data.lens, data.sensor_width = k[0, 0], camera.width
        data.shift_x = 0.5 - k[0, 2] / camera.width
        data.shift_y = (k[1, 2] - 0.5 * camera.height) / camera.width
        data.clip_start, data.clip_end = 1e-3, 1e5
        pose = camera.camera_to_world.copy()
        pose[:3, 3] -= self.center
        pose[:3, 1:3] *= -1.0
        self.target.camera.matrix_world = mathutils.Matrix(pose.tolist())
        with tempfile.TemporaryDirectory(
            dir="/dev/shm" if Path("/dev/shm").is_dir() else None
        ) as t:
            render.filepath = f"{t}/picture.exr"
            self.bpy.ops.render.render(write_still=True)
            with OpenEXR.File(render.filepath) as source:
                return {
                    part.name(): np.array(part.channels[part.name()].pixels)
                    for part in source.parts
                }

    def visibility(self, sample: int) -> dict[str, float]:
        """Row and face of each pixel."""
        start = time.perf_counter()
        self.target.cycles.samples, self.target.cycles.max_bounces = 1, 0
        self._render(sample)
        return {"seconds": time.perf_counter() - start}

    def radiance(self, sample: int, spp: int, seed: int) -> dict[str, float]:
        """One picture, its light made anew."""
        start = time.perf_counter()
        self._light(sample)
        self.target.cycles.samples, self.target.cycles.max_bounces = spp, BOUNCES
        self.target.cycles.seed = seed
        picture = next(p for n, p in self._render(sample).items() if n.endswith("Combined"))
        seconds = time.perf_counter() - start
        return {"seconds": seconds, "mean": float(picture[..., :3].mean())}


def serve(role: str, stage: Path) -> NoReturn:
    """Answer requests, one a line; what Blender prints goes elsewhere."""
    import os

    replies = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    start = time.perf_counter()
    scene = plain(read_stage(stage))
    read = time.perf_counter() - start
    made: Any = (Adapter if role == "adapter" else Bare)(scene)
    for line in sys.stdin:
        request = json.loads(line)
        start, cpu = time.perf_counter(), time.process_time()
        answer = getattr(made, request["op"])(*request["args"]) or {
            "seconds": time.perf_counter() - start,
            "read": read,
            "samples": len(scene.cameras),
        }
        answer["cpu"] = time.process_time() - cpu
        answer["peak_gib"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
        replies.write(json.dumps(answer) + "\n")
        replies.flush()
    os._exit(0)


class Process:
    """One of the two, in its process."""

    def __init__(self, role: str, stage: Path) -> None:
        command = [sys.executable, __file__, "--serve", role, "--stage", str(stage)]
        self._process = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
        )

    def ask(self, op: str, *args: int) -> dict[str, float]:
        """Have something done; what it took."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(json.dumps({"op": op, "args": args}) + "\n")
        self._process.stdin.flush()
        answer: dict[str, float] = json.loads(self._process.stdout.readline())
        return answer

    def close(self) -> None:
        """End it."""
        assert self._process.stdin is not None
        self._process.stdin.close()
        self._process.wait()


def measure(stage: Path, spp: int, rounds: int) -> int:
    """Ask both in turns and print the table; 1 where the pictures differ."""
    adapter, bare = Process("adapter", stage), Process("bare", stage)
    both = (adapter, bare)
    loads = [process.ask("load") for process in both]
    samples = int(loads[0]["samples"])
    first = [process.ask("visibility", 0) for process in both]
    # Without light, as a run that asks for annotation alone has it.
    seen = [[p.ask("visibility", turn % samples) for p in both] for turn in range(2 * rounds)]
    light = [
        [p.ask("radiance", turn % samples, spp, turn) for p in both] for turn in range(rounds + 1)
    ]
    lit = [[p.ask("visibility", turn % samples) for p in both] for turn in range(rounds)]
    # The first one builds what light needs, in both.
    light = light[1:]

    def median(table: list[list[dict[str, float]]], who: int, key: str = "seconds") -> float:
        return statistics.median(row[who][key] for row in table)

    def ratio(table: list[list[dict[str, float]]], key: str) -> float:
        return statistics.median(row[0][key] / row[1][key] for row in table)

    print(f"{spp} spp, {rounds} rounds                adapter       bare   adapter / bare")
    print(
        f"load (Blender's scene)       {loads[0]['seconds']:10.2f} s {loads[1]['seconds']:8.2f} s"
    )
    print(
        f"first visibility             {first[0]['seconds']:10.2f} s {first[1]['seconds']:8.2f} s"
    )
    for name, table in (
        ("visibility", seen),
        ("visibility, lights there", lit),
        ("radiance, new light each", light),
    ):
        ours, theirs = median(table, 0), median(table, 1)
        cpu = "" if table is not light else f"({ratio(table, 'cpu'):.3f} of processor time)"
        print(f"{name:28} {ours:10.2f} s {theirs:8.2f} s {ratio(table, 'seconds'):14.3f} {cpu}")
    means = [statistics.mean(row[who]["mean"] for row in light) for who in range(2)]
    print(f"mean radiance                {means[0]:10.3f}   {means[1]:8.3f}")
    peaks = [process.ask("visibility", 0)["peak_gib"] for process in both]
    print(f"peak memory                  {peaks[0]:10.2f} GiB {peaks[1]:6.2f} GiB")
    for process in both:
        process.close()
    apart = abs(means[0] / means[1] - 1.0)
    if not apart < 0.02:
        print(f"the pictures differ: their means are {100.0 * apart:.1f} % apart", file=sys.stderr)
        return 1
    return 0


def main() -> int:
    """Compile if need be, measure, print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--cfg", type=Path, default=ROOT / "configs" / "jacksboro.json")
    parser.add_argument("--stage", type=Path, help="a stage that is there already")
    parser.add_argument("--spp", type=int, default=32)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--serve", choices=["adapter", "bare"], help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.serve:
        serve(args.serve, args.stage)
    if args.stage:
        return measure(args.stage, args.spp, args.rounds)
    from scenec.compiler.compile import compile_cfg

    with tempfile.TemporaryDirectory() as folder:
        out = compile_cfg(args.cfg, seed=1, out=Path(folder) / "out").out
        return measure(out / "batch_0000" / "stage.usda", args.spp, args.rounds)


if __name__ == "__main__":
    sys.exit(main())
