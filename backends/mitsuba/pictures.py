"""All maps of a surface, looked up at once: one place in a picture serves every kind.

Maps of one size lie in one texture of many channels, so that their texels share indices and cache
lines. Import it once Mitsuba's variant is set.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from scenec.backends.mitsuba.aligned import aligned
from scenec.backends.mitsuba.arrays import ARRAYS
from scenec.backends.stage.scene import Maps
from scenec.backends.surface import cells, pictures
from scenec.backends.surface.maps import map_values
from scenec.schemas.cells import SIDE


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

    def __init__(self, maps: Maps, kinds: Sequence[str], center: NDArray[np.float64]) -> None:
        """Load the maps.

        Args:
            maps: A surface's.
            kinds: What is wanted; what has no map is left out.
            center: Of the scene, meters.
        """
        self.kinds = tuple(k for k in kinds if getattr(maps, k) is not None)
        self._placement = pictures.place(ARRAYS, maps, self.kinds, center)
        # Colors of a second scale are looked up on their own.
        self._packed = _pack(maps, self.kinds, separate=self._placement.far is not None)
        self._table = None if maps.cells is None else _corner_table(maps.cells.seed)

    def look_up(self, si: Any, active: Any) -> dict[str, Any]:
        """Numbers and vectors of each kind at a point; "normal" in the local frame."""
        frame, vector = si.sh_frame, mi.Vector3f
        point = pictures.Point(
            vector(si.p), vector(frame.n), vector(si.n), si.uv, vector(si.dp_du), vector(si.dp_dv)
        )

        def texels(u: Any, v: Any, axis: int = 2, far: bool = False) -> dict[str, Any]:
            found = {}
            for packed in self._packed:
                if far and packed.kinds[0][0] != "base_color":
                    continue
                values = packed.texture.eval(mi.Point2f(u, v), active)
                first = 0
                for kind, channels in packed.kinds:
                    own = values[first : first + channels]
                    found[kind] = own[0] if channels == 1 else vector(*own)
                    first += channels
            return found

        def entry(corner: Any) -> Any:
            i, j = (mi.Int32(n) & (SIDE - 1) for n in corner[:2])
            found = dr.gather(mi.Vector4f, self._table, mi.UInt32(j * SIDE + i), active)
            return vector(found[0], found[1], 0.0), (found[2], found[3])

        found = pictures.look_up(ARRAYS, self._placement, point, texels, entry)
        if "normal" in found:
            found["normal"] = si.to_local(found["normal"])
        return found


def _pack(maps: Maps, kinds: Sequence[str], separate: bool) -> list[_Packed]:
    """Textures of all kinds, (u, v) as ``Maps`` has them; ``separate``: colors have their own."""
    by_size: dict[tuple[object, ...], dict[str, NDArray[np.float32]]] = {}
    for kind in kinds:
        values = map_values(maps, kind)
        own = separate and kind == "base_color"
        by_size.setdefault((*values.shape[:2], own), {})[kind] = values
    found = []
    for own_size in by_size.values():
        # Rows from v = 0 up.
        texels = np.concatenate(list(own_size.values()), axis=2)[::-1]
        tensor = mi.TensorXf(aligned(texels))
        texture = mi.Texture2f(tensor, wrap_mode=dr.WrapMode.Repeat)
        kinds_of = tuple((kind, values.shape[2]) for kind, values in own_size.items())
        found.append(_Packed(texture, kinds_of))
    return found


@lru_cache(maxsize=8)
def _corner_table(seed: int) -> Any:
    return mi.Float(aligned(cells.corner_table(seed)).ravel())
