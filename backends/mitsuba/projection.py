"""Textures that Mitsuba lacks: pictures along the axes of the world, and normals of maps.

The arithmetic is that of ``scenec.backends.surface.maps``. What only multiplies texture coordinates
is left to Mitsuba's own bitmap.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.backends.mitsuba.cells import cell_texture, far_texture, seen_from_above
from scenec.backends.stage.scene import Maps
from scenec.backends.surface.maps import PLANES, map_values

PLUGIN = "scenec_projected"


def texture(
    mi: Any, maps: Maps, kind: str, center: NDArray[np.float64], by_uv: bool
) -> dict[str, Any]:
    """Dictionary of a map's texture; of a map of normals, as ``normalmap`` takes it.

    Args:
        mi: Mitsuba.
        maps: A surface's.
        kind: Of map.
        center: Of the scene, meters.
        by_uv: Whether the mesh's texture coordinates are the scene's, not x and y.
    """
    if maps.far is not None and kind == "base_color":
        near, far = (
            _scaled(mi, replace(maps, far=None), kind, center, by_uv, factor)
            for factor in (1.0, maps.far[0])
        )
        return far_texture(mi, maps, kind, near, far)
    return _scaled(mi, maps, kind, center, by_uv, 1.0)


def _scaled(
    mi: Any, maps: Maps, kind: str, center: NDArray[np.float64], by_uv: bool, factor: float
) -> dict[str, Any]:
    """The picture, and its cells, ``factor`` times as large."""
    values = map_values(maps, kind)
    normal = kind == "normal"
    if maps.cells is not None:
        if normal:
            values = 0.5 * (values + np.float32(1.0))
        return cell_texture(mi, maps, kind, _bitmap(mi, values, np.eye(3)), center, factor)
    maps = replace(maps, size_m=maps.size_m * factor)
    bare = maps.projection == "uv" or (maps.projection == "above" and not by_uv)
    if normal:
        # As the plugin decodes it.
        values = 0.5 * (values + np.float32(1.0))
    to_uv = np.eye(3)
    # The whole repeats between the stage's origin and the scene's center leave no trace.
    start = np.mod(center / maps.size_m, 1.0)
    if maps.projection == "above" and bare:
        to_uv[0, 0] = to_uv[1, 1] = 1.0 / maps.size_m
        to_uv[:2, 2] = start[:2]
    picture = _bitmap(mi, values, to_uv)
    if bare and not (normal and maps.projection == "uv"):
        return picture
    register(mi)
    return {
        "type": PLUGIN,
        "picture": picture,
        "projection": maps.projection,
        "normal": normal,
        "step": 1.0 / maps.size_m,
        "start": mi.ScalarPoint3f(start.tolist()),
    }


def _bitmap(mi: Any, values: NDArray[np.float32], to_uv: NDArray[np.float64]) -> dict[str, Any]:
    return {
        "type": "bitmap",
        # Mitsuba's v runs down the picture. A copy: it takes no read-only arrays.
        "bitmap": mi.Bitmap(np.array(values[::-1], np.float32)),
        "raw": True,
        "to_uv": mi.ScalarTransform3f(to_uv),
    }


def plane_shares(si: Any) -> list[Any]:
    """Of the planes across x, y and z."""
    import drjit as dr

    n = si.sh_frame.n
    fourth = [dr.square(dr.square(part)) for part in (n.x, n.y, n.z)]
    total = fourth[0] + fourth[1] + fourth[2]
    return [f / total for f in fourth]


def seen_from_sides(mi: Any, si: Any, shares: list[Any], mapped: list[list[Any]]) -> Any:
    """A normal of a triplanar map, in the local frame; ``mapped`` is what each plane's holds."""
    import drjit as dr

    n = si.sh_frame.n
    total: list[Any] = [0.0, 0.0, 0.0]
    for axis, ((x, y, z), (u, v)) in enumerate(zip(mapped, PLANES, strict=True)):
        part = [n.x, n.y, n.z]
        part[u] = part[u] + x
        part[v] = part[v] + y
        part[axis] = part[axis] * z
        total = [t + shares[axis] * p for t, p in zip(total, part, strict=True)]
    return si.to_local(dr.normalize(mi.Vector3f(*total)))


def handedness(si: Any) -> Any:
    """On which side of dP/du the texture coordinates' dP/dv lies."""
    import drjit as dr

    return dr.sign(dr.dot(dr.cross(si.dp_du, si.dp_dv), si.sh_frame.n))


@lru_cache(maxsize=1)
def register(mi: Any) -> None:
    """Define the texture for the variant that is set, and register it."""
    import drjit as dr

    scalar = mi.variant().startswith("scalar")

    def parts(vector: Any) -> list[Any]:
        return [vector.x, vector.y, vector.z]

    class Projected(mi.Texture):
        """See the module."""

        def __init__(self, props: Any) -> None:
            super().__init__(props)
            self.picture = props["picture"]
            self.projection = str(props["projection"])
            self.normal = bool(props["normal"])

            def number(value: float) -> Any:
                # Opaque: another scene's numbers are no other kernel to compile.
                return float(value) if scalar else dr.opaque(mi.Float, float(value))

            self.step = number(props["step"])
            self.start = [number(value) for value in parts(props["start"])]

        def _planes(self, si: Any) -> list[Any]:
            """The interaction with the coordinates of each plane."""
            at = [p * self.step + s for p, s in zip(parts(si.p), self.start, strict=True)]
            found = []
            for u, v in PLANES:
                moved = mi.SurfaceInteraction3f(si)
                moved.uv = mi.Point2f(at[u], at[v])
                found.append(moved)
            return found

        def _value(self, si: Any, evaluate: Any) -> Any:
            if self.projection == "uv":
                return evaluate(si)
            planes = self._planes(si)
            if self.projection == "above":
                return evaluate(planes[2])
            shares = plane_shares(si)
            total = evaluate(planes[0]) * shares[0]
            for axis in (1, 2):
                total = total + evaluate(planes[axis]) * shares[axis]
            return total

        def eval(self, si: Any, active: Any = True) -> Any:
            return self._value(si, lambda at: self.picture.eval(at, active))

        def eval_1(self, si: Any, active: Any = True) -> Any:
            return self._value(si, lambda at: self.picture.eval_1(at, active))

        def eval_3(self, si: Any, active: Any = True) -> Any:
            if not self.normal:
                return self._value(si, lambda at: self.picture.eval_3(at, active))
            if self.projection == "triplanar":
                local = self._triplanar(si, active)
            else:
                local = self._framed(si, active)
            return mi.Color3f(*(0.5 * component + 0.5 for component in local))

        def _mapped(self, si: Any, active: Any) -> list[Any]:
            return [2.0 * value - 1.0 for value in parts_of(self.picture.eval_3(si, active))]

        def _triplanar(self, si: Any, active: Any) -> list[Any]:
            mapped = [self._mapped(plane, active) for plane in self._planes(si)]
            return parts(seen_from_sides(mi, si, plane_shares(si), mapped))

        def _framed(self, si: Any, active: Any) -> list[Any]:
            """In the frame of the coordinates' dP/du, and on dP/dv's side of it."""
            if self.projection == "uv":
                x, y, z = self._mapped(si, active)
                return [x, y * handedness(si), z]
            return parts(seen_from_above(mi, si, *self._mapped(self._planes(si)[2], active)))

        def mean(self) -> Any:
            return self.picture.mean()

        def is_spatially_varying(self) -> bool:
            return True

        def to_string(self) -> str:
            return f"Projected[{self.projection}]"

    def parts_of(color: Any) -> list[Any]:
        return [color[0], color[1], color[2]]

    mi.register_texture(PLUGIN, Projected)
