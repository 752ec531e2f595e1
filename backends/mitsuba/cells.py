"""Pictures in cells and of two scales as Mitsuba textures; ``backends.cells`` defines them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenec.backends.stage.scene import Maps
from scenec.backends.surface import cells

PLUGIN, FAR_PLUGIN = "scenec_cells", "scenec_far"


def cell_texture(
    mi: Any, maps: Maps, kind: str, picture: Any, center: NDArray[np.float64], factor: float = 1.0
) -> dict[str, Any]:
    """Dictionary of a map in cells; of a map of normals, as ``normalmap`` takes it.

    Args:
        mi: Mitsuba.
        maps: With cells.
        kind: Of map.
        picture: Texture of the picture over (u, v), repeating; normals as 0.5 n + 0.5.
        center: Of the scene, meters.
        factor: How much larger picture and cells are.
    """
    assert maps.cells is not None
    register(mi)
    size = maps.cells.size_m * factor
    start = np.mod(np.array(cells.TO_LATTICE) @ center[:2] / size, cells.SIDE)
    mean = np.zeros(3) if kind == "normal" else cells.map_mean(maps, kind)
    most = cells.most(kind)
    return {
        "type": PLUGIN,
        "picture": picture,
        "normal": kind == "normal",
        "step": 1.0 / size,
        "repeats": size / (maps.size_m * factor),
        "start": mi.ScalarPoint3f([*start.tolist(), 0.0]),
        "seed": maps.cells.seed,
        "mean": mi.ScalarPoint3f(np.broadcast_to(mean, 3).tolist()),
        "upper": 1e30 if most is None else most,
    }


def far_texture(mi: Any, maps: Maps, kind: str, near: Any, far: Any) -> dict[str, Any]:
    """Dictionary of near * (1 + share * (far / mean - 1)), of textures of a map's two scales."""
    assert maps.far is not None
    register(mi)
    mean, share = cells.map_mean(maps, kind), maps.far[1]
    return {
        "type": FAR_PLUGIN,
        "near": near,
        "far": far,
        "gain": mi.ScalarPoint3f(
            np.divide(share, mean, out=np.zeros(3), where=mean > 0.0).tolist()
        ),
        # Where a channel is black everywhere it is so at any scale.
        "rest": mi.ScalarPoint3f(np.where(mean > 0.0, 1.0 - share, 1.0).tolist()),
    }


class Corner(NamedTuple):
    """One of the three cells at a point.

    Attributes:
        u, v: Where the picture is looked up.
        share, gain: Of what is mixed by the shares alone, and so that variance stays.
        cosine, sine: Of its turn.
    """

    u: Any
    v: Any
    share: Any
    gain: Any
    cosine: Any
    sine: Any


class Lattice:
    """Where the cells are that a picture lies in."""

    def __init__(self, mi: Any, step: float, repeats: float, start: Any, seed: int) -> None:
        """Args as ``cell_texture`` gives them: ``start`` is a vector."""
        import drjit as dr

        self._mi, self._dr = mi, dr
        self._scalar = mi.variant().startswith("scalar")
        numbers = [float(step), float(repeats), float(start.x), float(start.y)]
        if not self._scalar:
            # Opaque: another scene's numbers are no other kernel to compile.
            numbers = [dr.opaque(mi.Float, value) for value in numbers]
        self._step, self._repeats, self._start_s, self._start_t = numbers
        self._table = _table(mi, seed)

    def corners(self, p: Any, active: Any) -> list[Corner]:
        """The three cells at a point."""
        dr = self._dr
        (_, skew), (_, rise) = cells.TO_LATTICE
        (_, lean), (_, high) = cells.TO_WORLD
        s = (p.x + skew * p.y) * self._step + self._start_s
        t = rise * p.y * self._step + self._start_t
        column, row = dr.floor(s), dr.floor(t)
        x, y = s - column, t - row
        rest = 1.0 - x - y
        upper = dr.select(rest <= 0.0, 1.0, 0.0)
        both = upper * rest
        fourth = [dr.square(dr.square(n)) for n in (rest, x + both, y + both)]
        total = fourth[0] + fourth[1] + fourth[2]
        spread = dr.rsqrt(dr.square(fourth[0]) + dr.square(fourth[1]) + dr.square(fourth[2]))
        found = []
        for power, i, j in zip(fourth, (upper, 1.0, 0.0), (upper, 0.0, 1.0), strict=True):
            dx, dy = (x - i), (y - j)
            dx, dy = (dx + lean * dy) * self._repeats, high * dy * self._repeats
            shift_u, shift_v, cosine, sine = self._entry(column + i, row + j, active)
            u = cosine * dx - sine * dy + shift_u
            v = sine * dx + cosine * dy + shift_v
            found.append(Corner(u, v, power / total, power * spread, cosine, sine))
        return found

    def _entry(self, i: Any, j: Any, active: Any) -> Any:
        """Shifts, cosine and sine of the turn, of a corner."""
        mi = self._mi
        if self._scalar:
            return self._table[int(j) % cells.SIDE * cells.SIDE + int(i) % cells.SIDE]
        last = cells.SIDE - 1
        index = (mi.Int32(j) & last) * cells.SIDE + (mi.Int32(i) & last)
        return self._dr.gather(mi.Vector4f, self._table, mi.UInt32(index), active)


@lru_cache(maxsize=8)
def _table(mi: Any, seed: int) -> Any:
    """Shifts, cosine and sine of the turn, of each corner."""
    entry = cells.table(seed).reshape(-1, 3)
    turn = 2.0 * np.pi * entry[:, 2]
    rows = np.stack([entry[:, 0], entry[:, 1], np.cos(turn), np.sin(turn)], axis=1)
    if mi.variant().startswith("scalar"):
        return rows.tolist()
    return mi.Float(rows.astype(np.float32).ravel())


def turned_back(mapped: Iterable[tuple[Corner, Sequence[Any]]]) -> list[Any]:
    """x, y and z of the mixture of normals of the three cells, before it is made a unit vector."""
    x = y = z = 0.0
    for corner, (u, v, w) in mapped:
        x = x + corner.gain * (corner.cosine * u + corner.sine * v)
        y = y + corner.gain * (corner.cosine * v - corner.sine * u)
        z = z + corner.share * w
    return [x, y, z]


def seen_from_above(mi: Any, si: Any, x: Any, y: Any, z: Any) -> Any:
    """A normal of a map projected from above, in the local frame.

    Its frame is that of the face's dP/du, where u is the world's x, about the shading normal.
    """
    import drjit as dr

    n = si.sh_frame.n
    along = mi.Vector3f(dr.abs(si.n.z), 0.0, -dr.sign(si.n.z) * si.n.x)
    u = dr.normalize(along - n * dr.dot(n, along))
    return si.to_local(mi.Vector3f(u * x + dr.cross(n, u) * y + n * z))


@lru_cache(maxsize=1)
def register(mi: Any) -> None:
    """Define the textures for the variant that is set, and register them."""
    import drjit as dr

    scalar = mi.variant().startswith("scalar")

    def number(value: float) -> Any:
        # Opaque: another scene's numbers are no other kernel to compile.
        return float(value) if scalar else dr.opaque(mi.Float, float(value))

    def point(vector: Any) -> list[Any]:
        return [number(vector.x), number(vector.y), number(vector.z)]

    class Cells(mi.Texture):
        """See the module."""

        def __init__(self, props: Any) -> None:
            super().__init__(props)
            self.picture = props["picture"]
            self.normal = bool(props["normal"])
            self.lattice = Lattice(
                mi, props["step"], props["repeats"], props["start"], int(props["seed"])
            )
            self.mean_value = point(props["mean"])
            self.upper = float(props["upper"])

        def _corners(self, si: Any, active: Any) -> list[tuple[Any, Corner]]:
            """The interaction at each cell, and the cell."""
            found = []
            for corner in self.lattice.corners(si.p, active):
                moved = mi.SurfaceInteraction3f(si)
                moved.uv = mi.Point2f(corner.u, corner.v)
                found.append((moved, corner))
            return found

        def _mixed(self, si: Any, active: Any, evaluate: Any, mean: Any) -> Any:
            total, rest = mean * 0.0, mi.Float(1.0)
            for moved, corner in self._corners(si, active):
                gain = corner.gain
                total = total + evaluate(moved) * gain
                rest = rest - gain
            return dr.clip(total + mean * rest, 0.0, self.upper)

        def eval(self, si: Any, active: Any = True) -> Any:
            mean = mi.Color3f(*self.mean_value)
            return self._mixed(si, active, lambda at: self.picture.eval(at, active), mean)

        def eval_1(self, si: Any, active: Any = True) -> Any:
            return self._mixed(
                si, active, lambda at: self.picture.eval_1(at, active), self.mean_value[0]
            )

        def eval_3(self, si: Any, active: Any = True) -> Any:
            if self.normal:
                return self._normal(si, active)
            mean = mi.Color3f(*self.mean_value)
            return self._mixed(si, active, lambda at: self.picture.eval_3(at, active), mean)

        def _normal(self, si: Any, active: Any) -> Any:
            mapped = []
            for moved, corner in self._corners(si, active):
                pixel = self.picture.eval_3(moved, active)
                mapped.append((corner, [2.0 * pixel[axis] - 1.0 for axis in range(3)]))
            leaned = dr.normalize(mi.Vector3f(*turned_back(mapped)))
            local = seen_from_above(mi, si, *leaned)
            return mi.Color3f(0.5 * local.x + 0.5, 0.5 * local.y + 0.5, 0.5 * local.z + 0.5)

        def mean(self) -> Any:
            return self.picture.mean()

        def is_spatially_varying(self) -> bool:
            return True

        def to_string(self) -> str:
            return "Cells[]"

    class Far(mi.Texture):
        """See ``far_texture``."""

        def __init__(self, props: Any) -> None:
            super().__init__(props)
            self.near, self.far = props["near"], props["far"]
            self.gain, self.rest = point(props["gain"]), point(props["rest"])

        def eval(self, si: Any, active: Any = True) -> Any:
            relative = mi.Color3f(*self.rest) + mi.Color3f(*self.gain) * self.far.eval(si, active)
            return self.near.eval(si, active) * relative

        def eval_1(self, si: Any, active: Any = True) -> Any:
            relative = self.rest[0] + self.gain[0] * self.far.eval_1(si, active)
            return self.near.eval_1(si, active) * relative

        def eval_3(self, si: Any, active: Any = True) -> Any:
            return self.eval(si, active)

        def mean(self) -> Any:
            return self.near.mean()

        def is_spatially_varying(self) -> bool:
            return True

        def to_string(self) -> str:
            return "Far[]"

    mi.register_texture(PLUGIN, Cells)
    mi.register_texture(FAR_PLUGIN, Far)
