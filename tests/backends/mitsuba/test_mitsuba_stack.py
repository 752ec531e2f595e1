"""A stack of layers is the definition in float64, and looks at each point once."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import surface_oracle as oracle
from numpy.typing import NDArray
from PIL import Image

from scenec.backends.mitsuba import Mitsuba
from scenec.backends.mitsuba.aligned import aligned, aligned_columns
from scenec.backends.stage.scene import Maps, Mesh, Reflectance, RenderScene, Surface
from scenec.backends.surface import maps, reflectance
from scenec.backends.surface.lobes import MIN_ALPHA
from scenec.backends.surface.merges import FLAT
from scenec.backends.surface.pictures import has_maps
from scenec.backends.surface.projections import GRAZING
from scenec.backends.testing import looks
from scenec.backends.testing import reference as definition
from scenec.backends.testing import scenes as ms

HAPKE = Reflectance("hapke", 0.25, 0.2, 1.5, 0.06, math.radians(20.0))
#: Directions that each point is asked about.
ASKED = 300


def gray_picture(folder: Path, name: str) -> Path:
    file = folder / f"{name}.png"
    rng = np.random.default_rng(len(name))
    Image.fromarray(rng.integers(40, 220, (4, 7)).astype(np.uint8)).save(file)
    return file


def board(folder: Path, boards: Callable[[Path], dict[str, Any]], name: str) -> RenderScene:
    """One of the boards of ``scenec.backends.testing.looks``."""
    looks.write_pictures(folder)
    return looks.boards({name: boards(folder)[name]})


def waves(height: float) -> tuple[Mesh, NDArray[np.float32]]:
    """Smooth low ground, and weights of two merges on it."""
    points, faces = ms.plane(8.0, cells=6)
    x, y = points[:, 0], points[:, 1]
    points[:, 2] = height * np.sin(0.5 * x) * np.cos(0.4 * y)
    slope_x = 0.5 * height * np.cos(0.5 * x) * np.cos(0.4 * y)
    slope_y = -0.4 * height * np.sin(0.5 * x) * np.sin(0.4 * y)
    normals = np.stack([-slope_x, -slope_y, np.ones_like(x)], axis=1)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    weights = np.stack([np.clip(0.5 + 0.12 * x, 0, 1), np.clip(0.3 - 0.1 * y, 0, 1)])
    return ms.mesh(points, faces, normals=normals), weights.astype(np.float32)


def differences(got: NDArray, made: RenderScene) -> tuple[float, float, int]:
    """Root mean square and mean of (got / expected - 1) over sound pixels, and their number."""
    expected = definition.picture(made)
    off = got[expected.sound] / expected.radiance[expected.sound] - 1.0
    return float(np.sqrt(np.mean(off**2))), float(np.mean(off)), int(expected.sound.sum())


def everything(folder: Path) -> RenderScene:
    """Four layers of all kinds, two of whose merges heed heights.

    No normals from three sides: ``test_projections`` of the conformance suite has them.
    """
    colors, normals = (looks.write_picture(folder, kind) for kind in ("base_color", "normal"))
    rough, metal = gray_picture(folder, "rough"), gray_picture(folder, "metallic")
    height = looks.write_picture(folder, "height")
    layers = [
        Surface("/A", looks.COLOR, 0.2, 0.5, 0.3, 0.0,
                Maps(looks.SIZE, colors, rough, None, normals, height=height, cells=looks.CELLS),
                roughness_variation=0.2),
        Surface("/B", (0.4, 0.3, 0.2), 0.0, 0.5, 0.5, 0.0,
                Maps(2.0, colors, height=height, far=looks.FAR), reflectance=HAPKE),
        Surface("/C", (0.8, 0.7, 0.6), 0.3, 0.5, 0.2, 0.0,
                Maps(1.7, colors, rough, metal, projection="triplanar")),
        Surface("/D", (0.5, 0.1, 0.1), 0.1, 0.4, 0.0, 0.5,
                Maps(1.0, None, None, None, normals, projection="uv")),
    ]  # fmt: skip
    mesh, weights = waves(0.4)
    third = np.clip(0.25 + 0.1 * mesh.points[:, :1].T, 0.0, 1.0)
    uv = (mesh.points[mesh.faces][..., :2] * 0.2).astype(np.float32)
    mesh = dataclasses.replace(
        mesh,
        layers=(0, 1, 2, 3),
        weights=np.concatenate([weights, third]).astype(np.float32),
        variation=np.sin(mesh.points[:, 0]).astype(np.float32),
        uv=uv,
        height_blends=(0.3, 0.5, 0.0),
    )
    placed = np.concatenate([np.eye(3), looks.ORIGIN[:, None]], axis=1)
    camera = ms.look_at(looks.ORIGIN + np.array([3.0, -4.0, 7.0]), looks.ORIGIN, 16, 12, 45.0)
    lights = [ms.sun(55.0, -20.0)]
    return ms.scene(
        [mesh], layers, rows=[(0, placed)], cameras=[camera], lights=lights, row_variation=[0.3]
    )


def hits(backend: Mitsuba, scene: RenderScene) -> Any:
    """Interactions where rays from above and below meet the scene, each ``ASKED`` times."""
    mi, rng = backend._mi, np.random.default_rng(3)
    backend.load(scene)
    xy = np.repeat(rng.uniform(-6.0, 6.0, (2, 60)), ASKED, axis=1)
    up = np.where(np.arange(xy.shape[1]) % (3 * ASKED) < ASKED, -1.0, 1.0)
    lean = np.repeat(rng.uniform(-0.9, 0.9, (2, 60)), ASKED, axis=1)
    direction = np.stack([*lean, -np.ones(xy.shape[1])]) * up
    direction /= np.linalg.norm(direction, axis=0)
    middle = looks.ORIGIN - backend._center
    origin = np.stack([xy[0], xy[1], np.zeros(xy.shape[1])]) + middle[:, None] - 9.0 * direction
    ray = mi.Ray3f(mi.Point3f(origin.astype(np.float32)), mi.Vector3f(direction.astype(np.float32)))
    return backend._scene.ray_intersect(ray)


def spread(mi: Any, size: int) -> Any:
    """Directions on the whole sphere."""
    w = np.random.default_rng(4).normal(size=(3, size))
    return mi.Vector3f((w / np.linalg.norm(w, axis=0)).astype(np.float32))


def local(frame: NDArray, vectors: NDArray) -> NDArray:
    """World vectors [n, 3] by the axes [n, 3 (axis), 3]."""
    return np.einsum("nij,nj->ni", frame, vectors)


def unit(vectors: NDArray) -> NDArray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def of_maps(surface: Surface, kind: str, p: NDArray, n: NDArray, uv: NDArray) -> NDArray | None:
    """Values of a map that is no map of normals, [n, 1 or 3]."""
    described = surface.maps
    if described is None or not has_maps(described, kind):
        return None
    if described.projection == "above":
        return oracle.value(described, kind, p[:, :2])
    picture = maps.map_values(described, kind)
    if described.projection == "triplanar":
        return oracle.triplanar(picture, described.size_m, p, n)
    return maps.sample(picture, uv[:, 0], uv[:, 1])


def leaned(surface: Surface, mesh: Mesh, face: NDArray, p: NDArray, uv: NDArray, n: NDArray,
           flat: NDArray) -> NDArray:  # fmt: skip
    """The normal that a layer's map leaves, in the world, [n, 3]."""
    described = surface.maps
    if described is None or described.normal is None:
        return n
    if described.projection == "uv":
        mapped = maps.sample(maps.map_values(described, "normal"), uv[:, 0], uv[:, 1])
        along_u, along_v = (a[face].astype(float) for a in maps.face_tangents(mesh))
        return oracle.uv_normal(mapped, n, along_u, along_v)
    mapped = oracle.normal(described, p[:, :2])
    # Along the face above the world's x, but across the shading normal.
    x = np.stack([np.abs(flat[:, 2]), 0.0 * p[:, 0], -np.sign(flat[:, 2]) * flat[:, 0]], axis=1)
    x = unit(x - n * (n * x).sum(axis=1, keepdims=True))
    return unit(mapped[:, :1] * x + mapped[:, 1:2] * np.cross(n, x) + mapped[:, 2:] * n)


def ggx(alpha: NDArray, cos_i: NDArray, cos_o: NDArray, cos_h: NDArray) -> NDArray:
    """BRDF of a white lobe (Walter et al. 2007; masking after Heitz 2014)."""
    square = alpha * alpha
    density = square / (np.pi * ((square - 1.0) * cos_h**2 + 1.0) ** 2)
    hidden = [0.5 * (np.sqrt(1.0 + square * (1.0 / c**2 - 1.0)) - 1.0) for c in (cos_i, cos_o)]
    return density / (1.0 + hidden[0] + hidden[1]) / (4.0 * cos_i * cos_o)


def defined(scene: RenderScene, si: Any, center: NDArray, wi: NDArray, wo: NDArray) -> NDArray:
    """BRDF times cosine of ``everything``'s layers where rays met it, float64 [n, 3].

    Args:
        scene: Of one mesh in one row.
        si: Mitsuba's interactions: where, on which face, and the shading frame.
        center: Of Mitsuba's coordinates.
        wi, wo: World, towards the viewer and the light, [n, 3].
    """
    mesh, row = scene.meshes[0], scene.rows
    frame = np.stack([np.array(axis).T for axis in (si.sh_frame.s, si.sh_frame.t, si.sh_frame.n)])
    frame = np.moveaxis(frame, 0, 1).astype(float)
    n, flat = frame[:, 2], np.array(si.n).T.astype(float)
    p, face = np.array(si.p).T.astype(float) + center, np.array(si.prim_index)
    corners = mesh.points[mesh.faces[face]].astype(float) + looks.ORIGIN
    edges = corners[:, 1:] - corners[:, :1]
    bary = np.array([np.linalg.lstsq(e.T, at, rcond=None)[0]
                     for e, at in zip(edges, p - corners[:, 0], strict=True)])  # fmt: skip
    bary = np.concatenate([1.0 - bary.sum(axis=1, keepdims=True), bary], axis=1)
    uv = np.einsum("nk,nkc->nc", bary, mesh.uv[face].astype(float))
    weights = [(bary * w[mesh.faces[face]]).sum(axis=1) for w in mesh.weights]
    own = (bary * mesh.variation[mesh.faces[face]]).sum(axis=1)
    levels = []
    for surface in scene.surfaces:
        height = of_maps(surface, "height", p, n, uv)
        levels.append(np.full(len(p), FLAT) if height is None else height[:, 0])
    weights = oracle.heeded_weights(weights, mesh.height_blends, levels)
    # From the side of the face that is seen; what the shading normal leans from is at the horizon.
    behind = (wi * flat).sum(axis=1) * (n * flat).sum(axis=1) < 0.0
    mirror = np.stack([np.ones(len(p)), np.ones(len(p)), np.where(behind, -1.0, 1.0)], axis=1)
    seen, lit = local(frame, wi) * mirror, local(frame, wo) * mirror
    seen = unit(np.concatenate([seen[:, :2], np.maximum(seen[:, 2:], GRAZING)], axis=1))
    half = unit(seen + lit)
    total, rest = np.zeros((len(p), 3)), np.ones(len(p))
    for index in reversed(range(len(scene.surfaces))):
        surface = scene.surfaces[index]
        share = rest if index == 0 else weights[index - 1] * rest
        rest = rest - share

        def varied(amount: float) -> NDArray:
            return (1.0 + amount * own) * (1.0 + amount * float(row.variation[0]))

        color = np.array(surface.base_color) * varied(surface.variation)[:, None]
        picture = of_maps(surface, "base_color", p, n, uv)
        color = np.clip(color if picture is None else np.maximum(color, 0.0) * picture, 0.0, 1.0)
        rough = of_maps(surface, "roughness", p, n, uv)
        rough = surface.roughness if rough is None else rough[:, 0]
        alpha = np.clip(rough * varied(surface.roughness_variation), 0.0, 1.0) ** 2
        metal = of_maps(surface, "metallic", p, n, uv)
        metal = np.full(len(p), surface.metallic) if metal is None else metal[:, 0]
        white = (1.0 - metal) * surface.specular
        normal = local(frame, leaned(surface, mesh, face, p, uv, n, flat))
        away = (normal * seen).sum(axis=1) <= 0.0
        normal[away, :2] *= -1.0
        cos_i, cos_o, cos_h = ((normal * w).sum(axis=1) for w in (seen, lit, half))
        sound = (cos_i > 0.0) & (cos_o > 0.0)
        cos_i, cos_o = np.where(sound, cos_i, 1.0), np.where(sound, cos_o, 1.0)
        dull = color / np.pi
        if surface.reflectance is not None:
            phase = (seen * lit).sum(axis=1)[:, None]
            dull = reflectance.brdf(
                surface.reflectance, color, cos_o[:, None], cos_i[:, None], phase
            )
        gloss = ggx(np.maximum(alpha, MIN_ALPHA), cos_i, cos_o, cos_h)[:, None]
        rough = np.sqrt(alpha)[:, None]
        tint = white[:, None] * oracle.brighter(1.0, rough, cos_i[:, None])
        tint = tint + metal[:, None] * color * oracle.brighter(color, rough, cos_i[:, None])
        found = (1.0 - white - metal)[:, None] * dull + gloss * tint
        total += np.where(sound[:, None], (share * cos_o)[:, None] * found, 0.0)
    same_side = (wi * flat).sum(axis=1) * (wo * flat).sum(axis=1) > 0.0
    return np.where((same_side & (lit[:, 2] > 0.0))[:, None], total, 0.0)


def test_four_layers_of_all_kinds_are_the_definition(tmp_path):
    backend = Mitsuba(device="cpu")
    mi, scene = backend._mi, everything(tmp_path)
    si = hits(backend, scene)
    world = spread(mi, len(si.t))
    value, _ = si.bsdf().eval_pdf(mi.BSDFContext(), si, si.to_local(world))
    got = np.array(value).T.astype(float)
    wi = np.array(si.to_world(si.wi)).T.astype(float)
    expected = defined(scene, si, backend._center, wi, np.array(world).T.astype(float))
    assert (expected[:, 0] > 0.0).mean() > 0.2
    assert np.abs(got - expected).mean() / expected.mean() < 1e-4


@pytest.mark.slow
def test_what_is_drawn_is_weighed_by_what_is_seen(tmp_path):
    """Means of sampled weights, and of f / p of even directions, are the same albedo."""
    backend = Mitsuba(device="cpu")
    mi = backend._mi
    si = hits(backend, everything(tmp_path))
    size = len(si.t)
    rng = np.random.default_rng(5)
    context = mi.BSDFContext()
    drawn, even, total = np.zeros(3), np.zeros(3), 0.0
    rounds = 4
    for _ in range(rounds):
        numbers = rng.random((3, size)).astype(np.float32)
        bs, weight = si.bsdf().sample(
            context, si, mi.Float(numbers[0]), mi.Point2f(numbers[1], numbers[2])
        )
        again, density = si.bsdf().eval_pdf(context, si, bs.wo)
        lit = np.array(weight).sum(axis=0) > 0.0
        product = np.array(weight) * np.array(bs.pdf)
        np.testing.assert_allclose(np.array(density)[lit], np.array(bs.pdf)[lit], rtol=2e-3)
        np.testing.assert_allclose(
            np.array(again)[:, lit], product[:, lit], rtol=5e-3, atol=1e-4 * product.max()
        )
        drawn += np.array(weight).mean(axis=1) / rounds
        w = rng.normal(size=(3, size))
        wo = mi.Vector3f((w / np.linalg.norm(w, axis=0)).astype(np.float32))
        value, density = si.bsdf().eval_pdf(context, si, wo)
        even += 4.0 * math.pi * np.array(value).mean(axis=1) / rounds
        total += 4.0 * math.pi * float(np.array(density).mean()) / rounds
    np.testing.assert_allclose(drawn, even, rtol=0.04)
    # Some of what is drawn lies below the leaned normals' horizon.
    assert 0.8 < total < 1.02


def test_colors_from_three_sides_are_mixed_by_the_normal_that_no_map_leans(tmp_path):
    backend = Mitsuba(device="cpu")
    scene = board(tmp_path, looks.projected, "triplanar color, plain")
    (own,) = scene.surfaces
    assert own.maps is not None
    both = dataclasses.replace(own.maps, normal=looks.write_picture(tmp_path, "normal"))
    scene = dataclasses.replace(scene, surfaces=(dataclasses.replace(own, maps=both),))
    backend.load(scene)
    light = backend.radiance(scene.cameras[0][0], 0, 256, 2).halves.astype(float)
    spread, offset, pixels = differences(light.mean(axis=0), scene)
    assert pixels > 80
    assert spread < 0.01
    assert abs(offset) < 1.5e-3


def test_each_layer_is_looked_up_once_a_bounce(tmp_path, monkeypatch):
    Mitsuba(device="cpu")
    from scenec.backends.mitsuba.pictures import Pictures

    asked: list[Pictures] = []
    look_up = Pictures.look_up

    def counted(self: Pictures, si: Any, active: Any) -> dict[str, Any]:
        asked.append(self)
        return look_up(self, si, active)

    monkeypatch.setattr(Pictures, "look_up", counted)
    backend = Mitsuba(device="cpu", bounces=3)
    scene = board(tmp_path, looks.mapped, "heights")
    backend.load(scene)
    stack = type(backend._meshes[0].bsdf())
    drawn: list[Any] = []
    sample = stack.sample

    def also_counted(self: Any, *args: Any) -> Any:
        drawn.append(self)
        return sample(self, *args)

    monkeypatch.setattr(stack, "sample", also_counted)
    backend.radiance(scene.cameras[0][0], 0, 4, 1)
    # Two of the three layers have maps; Dr.Jit traces the loop of bounces twice for each half.
    assert len(set(map(id, asked))) == 2
    assert len(asked) == 2 * len(drawn)
    assert len(drawn) <= 4


def test_one_kernel_serves_pictures_of_any_size_and_number_of_samples(tmp_path):
    backend = Mitsuba(device="cpu")
    import drjit as dr

    scene = board(tmp_path, looks.projected, "triplanar color, plain")
    backend.load(scene)
    camera = scene.cameras[0][0]
    kernels = set()
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        for width, height, spp in ((16, 12, 2), (21, 11, 6), (40, 30, 8)):
            seen = dataclasses.replace(camera, width=width, height=height)
            backend.radiance(seen, 0, spp, 1)
            history = [k for k in dr.kernel_history() if "hash" in k]
            kernels.add(max(history, key=lambda k: k["operation_count"])["hash"])
    assert len(kernels) == 1


def test_one_kernel_serves_a_scene_wherever_memory_is_free(tmp_path):
    scene = everything(tmp_path)
    import drjit as dr

    kernels, held = set(), []
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        for turn in range(5):
            backend = Mitsuba(device="cpu")
            from scenec.backends.mitsuba.pictures import _corner_table

            _corner_table.cache_clear()
            # Moves what comes after by 16 bytes or more.
            held += [np.empty(2 * (100 + 7 * turn + n)) for n in range(40)]
            backend.load(scene)
            dr.kernel_history_clear()
            backend.radiance(scene.cameras[0][0], 0, 2, 1)
            history = [k for k in dr.kernel_history() if "hash" in k]
            kernels.add(max(history, key=lambda k: k["operation_count"])["hash"])
    assert len(kernels) == 1


@pytest.mark.parametrize("kind", [np.float32, np.uint32, np.float64])
def test_memory_for_dr_jit_begins_at_64_bytes(kind):
    for count in range(1, 40):
        values = np.arange(3 * count).reshape(count, 3)
        columns = aligned_columns(values.T, kind)
        for found in (aligned(values, kind), *columns):
            assert found.ctypes.data % 64 == 0
        np.testing.assert_array_equal(aligned(values, kind), values)
        np.testing.assert_array_equal(columns, values.T)
        assert columns.dtype == kind
