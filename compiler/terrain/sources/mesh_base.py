"""Begins with a mesh from a file: as it is from above, or itself with its overhangs."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.assets.model import Model, read_model
from scenec.compiler.geometry import affine
from scenec.compiler.terrain.grid import Applied, Grid, HeightField
from scenec.compiler.terrain.operators.multifractal import octaves_shown
from scenec.compiler.terrain.sources.fill_holes import fill_holes
from scenec.compiler.terrain.sources.mesh_plan import SAME, Above, see
from scenec.compiler.terrain.sources.mesh_surface import MeshSurface, roughened, subdivided
from scenec.schemas.errors import SceneError

#: Budget of a mesh where nobody gives one: the schema's default.
DEFAULT_TRIANGLES = 8_000_000


@dataclass(frozen=True)
class Roughness:
    """Displacement along the normals, see ``mesh_surface.roughened``."""

    key: int
    amplitude_m: float
    scale_m: float
    octaves: int
    gain: float


@dataclass(frozen=True)
class MeshBase:
    """A mesh laid on the terrain: scaled, turned, then moved.

    Attributes:
        file: OBJ, PLY, glTF or USD, see ``read_model``.
        surface: "mesh": the ground is the mesh, overhangs included; "heights": what is seen of it
            from above, sampled on the grid.
        part: One of the file's meshes, or a name above some of them; None takes all.
        unit_m: Meters per unit of the file; None takes what it says itself.
        up: Its upward axis; None takes what it says itself.
        scale: Factor on its size.
        rotation_deg: Turn about the vertical, counterclockwise seen from above.
        place: "center" puts the middle of its extent in plan on the terrain's center; "keep" leaves
            its coordinates.
        position_m: Moved by, afterwards.
        holes: What happens where there is no mesh under the terrain: an error, or a membrane.
        roughness: Of its surface; None leaves it smooth. Of "mesh" only.
    """

    file: Path
    surface: Literal["mesh", "heights"]
    part: str | None
    unit_m: float | None
    up: str | None
    scale: float
    rotation_deg: float
    place: Literal["center", "keep"]
    position_m: tuple[float, float, float]
    holes: Literal["error", "fill"]
    roughness: Roughness | None = None
    #: Its own heights come on top of those before it.
    adds: ClassVar[bool] = True

    def apply(self, grid: Grid, height: NDArray[np.float64]) -> Applied:
        """Heights plus those of the topmost surface.

        Raises:
            SceneError: The file cannot be read, or there is no mesh somewhere under the terrain.
        """
        mesh = self._read()
        seen, report = self._seen(grid, self._placed(mesh), mesh.faces)
        top, filled = self._whole(seen)
        return height + top, {**_read_report(mesh), **report, **filled}

    def stage(self, grid: Grid, max_triangles: int) -> tuple[MeshSurface, dict[str, Any]]:
        """The mesh as a surface, its edges no longer than the grid's spacing.

        Args:
            grid: The terrain's.
            max_triangles: Budget; where it binds, edges stay longer, and the report says so.

        Raises:
            SceneError: As ``apply``.
        """
        mesh = self._read()
        points = self._placed(mesh)
        spacing = max(grid.spacing_m)
        seen, _ = self._seen(grid, points, mesh.faces)
        _, filled = self._whole(seen)
        # Of closed solids and of open sheets, the side seen from above is the front.
        flipped = 2 * int(seen.down.sum()) > int(np.isfinite(seen.top).sum())
        faces = np.ascontiguousarray(mesh.faces[:, ::-1]) if flipped else mesh.faces
        points, faces, edge = subdivided(points, faces, spacing, max_triangles, grid.size_m)
        report: dict[str, Any] = {
            **_read_report(mesh),
            "turned_inside_out": flipped,
            "triangles": len(faces),
            "edge_max_m": edge,
            "budget_bound": edge > spacing * (1.0 + 1e-6),
            **_beyond(grid, points),
        }
        if self.roughness is not None:
            rough = self.roughness
            octaves = octaves_shown(rough.octaves, rough.scale_m, 2.0, edge)
            points = roughened(
                points, faces, rough.key, rough.amplitude_m, rough.scale_m, octaves, rough.gain
            )
            report["roughness_octaves"] = octaves
            report["roughness_octaves_below_edge"] = rough.octaves - octaves
        seen, above = self._seen(grid, points, faces)
        # Roughness may draw the mesh's border in; that is no hole of the file's.
        top = _without_holes(seen)[0]
        return MeshSurface(grid, top, points, faces), {**report, **above, **filled}

    def _read(self) -> Model:
        return read_model(self.file, unit_m=self.unit_m, up=self.up, part=self.part, looks=False)

    def _placed(self, mesh: Model) -> NDArray[np.float64]:
        turn = affine.about_axis(2, self.rotation_deg)
        points = affine.applied(turn, mesh.points * self.scale)
        if self.place == "center":
            low, high = points[:, :2].min(axis=0), points[:, :2].max(axis=0)
            points[:, :2] -= 0.5 * (low + high)
        points += np.array(self.position_m)
        if not np.isfinite(points).all():
            raise SceneError(f"{self.file.name}: its size overflows; use a smaller scale")
        return points

    def _seen(
        self, grid: Grid, points: NDArray[np.float64], faces: NDArray[np.int32]
    ) -> tuple[Above, dict[str, Any]]:
        frame = HeightField(grid, np.zeros(grid.shape)).frame()
        seen = see(points, faces, frame, grid.shape)
        there = np.isfinite(seen.top)
        if not there.any():
            low, high = points.min(axis=0), points.max(axis=0)
            raise SceneError(
                f"{self.file.name}: no part of it lies over a sample of the terrain: it reaches "
                f"from ({low[0]:g}, {low[1]:g}) m to ({high[0]:g}, {high[1]:g}) m, and the terrain "
                f"is {grid.size_m[0]:g} m by {grid.size_m[1]:g} m around (0, 0); check unit_m, up "
                "and place"
            )
        both = np.isfinite(seen.floor)
        gap = np.where(both, seen.ceiling, 0.0) - np.where(both, seen.floor, 0.0)
        over = gap > SAME * max(grid.spacing_m)
        return seen, {
            "overhang_fraction": float(over.sum() / there.sum()),
            "overhang_height_max_m": float(gap[over].max(initial=0.0)),
            "facing_down_fraction": float(seen.down.sum() / there.sum()),
        }

    def _whole(self, seen: Above) -> Applied:
        """Heights without holes."""
        holes = ~np.isfinite(seen.top)
        count = int(holes.sum())
        if count == 0:
            return seen.top, {}
        if self.holes == "error":
            raise SceneError(
                f"{self.file.name}: {count} of {holes.size} samples of the terrain have no mesh "
                "over or under them; make the terrain smaller or the mesh larger, or say "
                '"holes": "fill"'
            )
        filled, error = _without_holes(seen)
        return filled, {"holes_filled": count, "holes_error_m": error}


def _without_holes(seen: Above) -> tuple[NDArray[np.float64], float]:
    holes = ~np.isfinite(seen.top)
    return fill_holes(np.where(holes, 0.0, seen.top), holes)


def _read_report(mesh: Model) -> dict[str, Any]:
    return {
        **({"left_out": list(mesh.notes)} if mesh.notes else {}),
        "triangles_of_file": len(mesh.faces),
        "degenerate_dropped": mesh.degenerate,
        "vertices_welded": mesh.welded,
    }


def _beyond(grid: Grid, points: NDArray[np.float64]) -> dict[str, Any]:
    """How far the mesh reaches over the terrain's rectangle, where heights are its border's."""
    half = 0.5 * np.array(grid.size_m)
    reach = float((np.abs(points[:, :2]) - half).max(initial=0.0))
    return {"beyond_terrain_m": reach if reach > SAME * max(grid.spacing_m) else 0.0}
