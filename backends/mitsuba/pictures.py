"""All maps of a surface looked up at once: one place in the picture serves every kind.

The arithmetic is that of ``surface.maps`` and ``surface.cells``. Maps of one size lie in one
texture of many channels, so that their texels share indices and cache lines.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenec.backends.mitsuba.cells import Corner, Lattice, turned_back
from scenec.backends.stage.scene import Maps
from scenec.backends.surface import cells
from scenec.backends.surface.maps import PLANES, map_values


class _Packed(NamedTuple):
    """Maps of one size.

    Attributes:
        texture: Of all their channels.
        kinds: Whose they are, with the number of each one's channels.
    """

    texture: Any
    kinds: tuple[tuple[str, int], ...]


class Pictures:
    """The maps of one surface."""

    def __init__(
        self, mi: Any, maps: Maps, kinds: Sequence[str], center: NDArray[np.float64]
    ) -> None:
        """Load the maps.

        Args:
            mi: Mitsuba.
            maps: A surface's.
            kinds: What is wanted; what has no map is left out.
            center: Of the scene, meters.
        """
        self._mi, self._maps = mi, maps
        self.kinds = tuple(k for k in kinds if getattr(maps, k) is not None)
        # Colors of a second scale are looked up on their own.
        two_scales = maps.far is not None and "base_color" in self.kinds
        self._near = _Scale(mi, maps, self.kinds, center, 1.0, apart=two_scales)
        self._far = None
        if two_scales and maps.far is not None:
            factor, share = maps.far
            self._far = _Scale(mi, maps, ("base_color",), center, factor, self._near)
            mean = cells.map_mean(maps, "base_color")
            gain = np.divide(share, mean, out=np.zeros(3), where=mean > 0.0)
            # Where a channel is black everywhere it is so at any scale.
            rest = np.where(mean > 0.0, 1.0 - share, 1.0)
            self._gain, self._rest = (_numbers(mi, values) for values in (gain, rest))

    def look_up(self, si: Any, active: Any) -> dict[str, list[Any]]:
        """Channels of each kind at a point; "normal" in the local frame."""
        found = self._near.look_up(si, active)
        if self._far is not None:
            far = self._far.look_up(si, active)["base_color"]
            found["base_color"] = [
                near * (rest + gain * other)
                for near, other, gain, rest in zip(
                    found["base_color"], far, self._gain, self._rest, strict=True
                )
            ]
        return found


class _Scale:
    """Maps at one size of their pictures."""

    def __init__(
        self,
        mi: Any,
        maps: Maps,
        kinds: Sequence[str],
        center: NDArray[np.float64],
        factor: float,
        other: _Scale | None = None,
        apart: bool = False,
    ) -> None:
        """Args: as of ``Pictures``.

        factor: How much larger pictures and cells are.
        other: Whose textures serve here, too.
        apart: Whether colors are to have a texture of their own.
        """
        self._mi, self._maps = mi, maps
        if other is None:
            self._packed = _pack(mi, maps, kinds, apart)
        else:
            self._packed = [p for p in other._packed if p.kinds[0][0] in kinds]
        self._lattice: Lattice | None = None
        size = maps.size_m * factor
        if maps.cells is not None:
            self._lattice = Lattice(mi, maps, center, factor)
            plain = [kind for kind in kinds if kind != "normal"]
            self._mean = {kind: _numbers(mi, cells.map_mean(maps, kind)) for kind in plain}
        elif maps.projection != "uv":
            (self._step,) = _numbers(mi, np.array([1.0 / size]))
            # The whole repeats between the stage's origin and the scene's center leave no trace.
            self._start = _numbers(mi, np.mod(center / size, 1.0))

    def look_up(self, si: Any, active: Any) -> dict[str, list[Any]]:
        """As of ``Pictures``."""
        if self._lattice is not None:
            return self._in_cells(si, self._lattice.corners(si.p, active), active)
        mi = self._mi
        if self._maps.projection == "uv":
            found = self._texels(si.uv, active)
            if "normal" in found:
                found["normal"][1] = found["normal"][1] * handedness(si)
            return found
        at = [
            p * self._step + start
            for p, start in zip((si.p.x, si.p.y, si.p.z), self._start, strict=True)
        ]
        if self._maps.projection == "above":
            found = self._texels(mi.Point2f(at[0], at[1]), active)
            if "normal" in found:
                found["normal"] = list(seen_from_above(mi, si, *found["normal"]))
            return found
        shares = plane_shares(si)
        planes = [self._texels(mi.Point2f(at[u], at[v]), active) for u, v in PLANES]
        found = {}
        for kind in planes[0]:
            of_planes = [plane[kind] for plane in planes]
            if kind == "normal":
                found[kind] = list(seen_from_sides(mi, si, shares, of_planes))
            else:
                found[kind] = [
                    sum((s * c for s, c in zip(shares, channel, strict=True)), mi.Float(0.0))
                    for channel in zip(*of_planes, strict=True)
                ]
        return found

    def _in_cells(self, si: Any, corners: list[Corner], active: Any) -> dict[str, list[Any]]:
        import drjit as dr

        mi = self._mi
        values = [self._texels(mi.Point2f(c.u, c.v), active) for c in corners]
        rest = 1.0 - (corners[0].gain + corners[1].gain + corners[2].gain)
        found: dict[str, list[Any]] = {}
        for kind in values[0]:
            of_cells = [value[kind] for value in values]
            if kind == "normal":
                leaned = turned_back(zip(corners, of_cells, strict=True))
                leaned = dr.normalize(mi.Vector3f(*leaned))
                found[kind] = list(seen_from_above(mi, si, *leaned))
                continue
            found[kind] = []
            for channel, mean in zip(zip(*of_cells, strict=True), self._mean[kind], strict=True):
                total = mean * rest
                for corner, value in zip(corners, channel, strict=True):
                    total = total + corner.gain * value
                most = cells.most(kind)
                total = dr.maximum(total, 0.0)
                found[kind].append(total if most is None else dr.minimum(total, most))
        return found

    def _texels(self, uv: Any, active: Any) -> dict[str, list[Any]]:
        found: dict[str, list[Any]] = {}
        for packed in self._packed:
            values = packed.texture.eval(uv, active)
            first = 0
            for kind, channels in packed.kinds:
                found[kind] = list(values[first : first + channels])
                first += channels
        return found


def _pack(mi: Any, maps: Maps, kinds: Sequence[str], apart: bool) -> list[_Packed]:
    """Textures of all kinds; (u, v) as ``render_scene.Maps`` has them."""
    import drjit as dr

    by_size: dict[tuple[object, ...], dict[str, NDArray[np.float32]]] = {}
    for kind in kinds:
        values = map_values(maps, kind)
        own = apart and kind == "base_color"
        by_size.setdefault((*values.shape[:2], own), {})[kind] = values
    found = []
    for pictures in by_size.values():
        # Rows from v = 0 up.
        texels = np.concatenate(list(pictures.values()), axis=2)[::-1]
        tensor = mi.TensorXf(np.ascontiguousarray(texels, np.float32))
        texture = mi.Texture2f(tensor, wrap_mode=dr.WrapMode.Repeat)
        kinds_of = tuple((kind, values.shape[2]) for kind, values in pictures.items())
        found.append(_Packed(texture, kinds_of))
    return found


def _numbers(mi: Any, values: NDArray[np.float64]) -> list[Any]:
    """Opaque: another scene's numbers are no other kernel to compile."""
    import drjit as dr

    return [dr.opaque(mi.Float, float(value)) for value in values]


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


def seen_from_above(mi: Any, si: Any, x: Any, y: Any, z: Any) -> Any:
    """A normal of a map projected from above, in the local frame.

    Its frame is that of the face's dP/du, where u is the world's x, about the shading normal.
    """
    import drjit as dr

    n = si.sh_frame.n
    along = mi.Vector3f(dr.abs(si.n.z), 0.0, -dr.sign(si.n.z) * si.n.x)
    u = dr.normalize(along - n * dr.dot(n, along))
    return si.to_local(mi.Vector3f(u * x + dr.cross(n, u) * y + n * z))


def handedness(si: Any) -> Any:
    """On which side of dP/du the texture coordinates' dP/dv lies."""
    import drjit as dr

    return dr.sign(dr.dot(dr.cross(si.dp_du, si.dp_dv), si.sh_frame.n))
