"""Pictures in cells and of two scales as Mitsuba textures; ``backends.cells`` defines them."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.backends import cells
from scenec.backends.render_scene import Maps

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


@lru_cache(maxsize=1)
def register(mi: Any) -> None:
    """Define the textures for the variant that is set, and register them."""
    import drjit as dr

    scalar = mi.variant().startswith("scalar")
    (_, skew), (_, rise) = cells.TO_LATTICE
    (_, lean), (_, high) = cells.TO_WORLD

    def number(value: float) -> Any:
        # Opaque: another scene's numbers are no other kernel to compile.
        return float(value) if scalar else dr.opaque(mi.Float, float(value))

    def point(vector: Any) -> list[Any]:
        return [number(vector.x), number(vector.y), number(vector.z)]

    @lru_cache(maxsize=4)
    def table(seed: int) -> list[Any]:
        """Shifts, cosine and sine of the turn, of each corner."""
        entry = cells.table(seed).reshape(-1, 3)
        turn = 2.0 * np.pi * entry[:, 2]
        columns = (entry[:, 0], entry[:, 1], np.cos(turn), np.sin(turn))
        if scalar:
            return [column.tolist() for column in columns]
        return [mi.Float(column.astype(np.float32)) for column in columns]

    class Cells(mi.Texture):
        """See the module."""

        def __init__(self, props: Any) -> None:
            super().__init__(props)
            self.picture = props["picture"]
            self.normal = bool(props["normal"])
            self.step, self.repeats = number(props["step"]), number(props["repeats"])
            self.start = point(props["start"])
            self.mean_value = point(props["mean"])
            self.upper = float(props["upper"])
            self.table = table(int(props["seed"]))

        def _corners(self, si: Any, active: Any) -> list[tuple[Any, Any, Any, Any, Any]]:
            """Of each cell: the interaction there, share, gain, cosine and sine of its turn."""
            s = (si.p.x + skew * si.p.y) * self.step + self.start[0]
            t = rise * si.p.y * self.step + self.start[1]
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
                dx, dy = (dx + lean * dy) * self.repeats, high * dy * self.repeats
                shift_u, shift_v, cosine, sine = self._entry(column + i, row + j, active)
                moved = mi.SurfaceInteraction3f(si)
                moved.uv = mi.Point2f(
                    cosine * dx - sine * dy + shift_u, sine * dx + cosine * dy + shift_v
                )
                found.append((moved, power / total, power * spread, cosine, sine))
            return found

        def _entry(self, i: Any, j: Any, active: Any) -> list[Any]:
            if scalar:
                at = int(j) % cells.SIDE * cells.SIDE + int(i) % cells.SIDE
                return [column[at] for column in self.table]
            last = cells.SIDE - 1
            index = (mi.Int32(j) & last) * cells.SIDE + (mi.Int32(i) & last)
            return [dr.gather(mi.Float, column, mi.UInt32(index), active) for column in self.table]

        def _mixed(self, si: Any, active: Any, evaluate: Any, mean: Any) -> Any:
            total, rest = mean * 0.0, mi.Float(1.0)
            for moved, _, gain, _, _ in self._corners(si, active):
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
            x, y, z = mi.Float(0.0), mi.Float(0.0), mi.Float(0.0)
            for moved, share, gain, cosine, sine in self._corners(si, active):
                pixel = self.picture.eval_3(moved, active)
                u, v, w = (2.0 * pixel[axis] - 1.0 for axis in range(3))
                x += gain * (cosine * u + sine * v)
                y += gain * (cosine * v - sine * u)
                z += share * w
            leaned = dr.normalize(mi.Vector3f(x, y, z))
            n = si.sh_frame.n
            # As ``projection`` has it for maps from above.
            along = mi.Vector3f(dr.abs(si.n.z), 0.0, -dr.sign(si.n.z) * si.n.x)
            u = dr.normalize(along - n * dr.dot(n, along))
            world = u * leaned.x + dr.cross(n, u) * leaned.y + n * leaned.z
            local = si.to_local(mi.Vector3f(world))
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
