"""Begins with a mesh from a file: as it is from above, or itself with its overhangs."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.assets.model import MeshModel, read_model
from scenec.compiler.geometry import affine
from scenec.compiler.kinds import Finding, Node, an, bounded, file, forms, key, list_of, noise_key
from scenec.compiler.terrain.grid import Applied, Grid, HeightField
from scenec.compiler.terrain.operators.multifractal import octaves_resolved
from scenec.compiler.terrain.sources.fill_holes import fill_holes
from scenec.compiler.terrain.sources.mesh_plan import SAME, Above, see
from scenec.compiler.terrain.sources.mesh_surface import MeshSurface, roughened, subdivided
from scenec.schemas.codec import Facts
from scenec.schemas.errors import SceneError

#: Budget of a mesh where nobody gives one: the schema's default.
DEFAULT_TRIANGLES = 8_000_000


@dataclass(frozen=True)
class Roughness:
    """Displacement along the surface's normals by three-dimensional fBm.

    Note: see ``mesh_surface.roughened``.
    """

    EXAMPLE: ClassVar = {"amplitude_m": 0.02, "scale_m": 0.5}
    TITLE: ClassVar = "Relief: mesh, roughness"

    amplitude_m: float = key(forms.LENGTH_PER_BATCH, at_least=0, at_most=1_000_000)
    """Of the first octave. Above the surface's radius of curvature, the surface can cross
    itself."""
    scale_m: float = key(forms.NOISE_SCALE_M)
    octaves: int = key(forms.WHOLE_PER_BATCH, default=8, at_least=0, at_most=24)
    """Octaves at most, each half the size of the one before; those finer than two edges of the mesh
    are left out."""
    gain: float = key(forms.GAIN)
    key: int = noise_key()


@dataclass(frozen=True)
class MeshBase:
    """A base from a mesh file, scaled, turned, then moved: the ground itself with overhangs and
    caves, or its surface from above.
    """

    EXAMPLE: ClassVar = {"type": "mesh", "file": "photogrammetry.obj", "unit_m": 1, "up": "z"}

    file: Path = key(file("mesh"))
    """A .obj, .ply, .stl, .off, .glb, .gltf, .usd, .usda, .usdc or .usdz file, relative to the cfg,
    or "package:NAME/path". Its materials are not read."""
    surface: Literal["mesh", "heights"] = key(forms.CHOICE, default="mesh")
    """mesh: its triangles are the ground, halved until no edge exceeds the spacing; later relief
    moves them up and down, objects lie on every floor. heights: its topmost surface on the grid;
    what is below is lost, and reported."""
    part: str | None = key(forms.WORDS, optional=True)
    """One of the file's meshes, by a name or a path, with what stands under it. Left out, all."""
    unit_m: float | None = key(forms.CONSTANT, optional=True, above=0, at_most=1_000_000, unit="m")
    """Meters per unit. Left out, what the file says: 1 in glTF, metersPerUnit in USD; OBJ, PLY, STL
    and OFF say nothing."""
    up: Literal["x", "y", "z", "-x", "-y", "-z"] | None = key(forms.CHOICE, optional=True)
    """Upward axis. Left out, what the file says: y in glTF, upAxis in USD; OBJ, PLY, STL and OFF
    say nothing."""
    scale: float = key(forms.PER_BATCH, default=1, above=0, at_most=1_000_000_000)
    """Factor on its size."""
    rotation_deg: float = key(forms.PER_BATCH, default=0, at_least=-360, at_most=360, unit="deg")
    """Turn about the vertical, counterclockwise seen from above."""
    place: Literal["center", "keep"] = key(forms.CHOICE, default="center")
    """center: its middle in plan lies at the terrain's center. keep: its coordinates are the
    terrain's."""
    position_m: tuple[float, float, float] = key(
        list_of(
            bounded(forms.LENGTH_PER_BATCH, at_least=-1_000_000_000, at_most=1_000_000_000),
            "Along one axis.",
            least=3,
            most=3,
        ),
        default=[0, 0, 0],
        unit="m",
    )
    """Moved by this: x, y, z."""
    holes: Literal["error", "fill"] = key(forms.CHOICE, default="error")
    """Where no mesh is over or under the terrain: an error; or fill, a membrane (Laplace's
    equation), while the ground of surface mesh keeps its hole."""
    roughness: Roughness | None = key(an("relief_mesh_roughness", drawn=True), optional=True)
    """Moves the surface along its normals, walls and ceilings too. With surface mesh only."""

    #: What a mask is of it.
    VARIANTS: ClassVar = {
        "relief_mesh": {
            "mask": {
                "description": "Where the operator acts: conditions whose product is the mask. "
                "Left out, everywhere. Where surface is heights only."
            }
        }
    }
    #: Its own heights come on top of those before it.
    adds: ClassVar[bool] = True

    @staticmethod
    def check(node: Node) -> Iterator[Finding]:
        """Yields what does not go with a mesh that is kept, and with one that becomes heights."""
        if node["surface"] == "mesh":
            if node.path[-1] != 0:
                yield node.fault(
                    'a mesh can be kept by the first operator only: expected "surface": "heights"',
                    *(("surface",) if "surface" in node else ()),
                )
            if "mask" in node:
                yield node.key_fault(
                    "a mask blends heights, and the mesh is kept as it is: take it away, or say "
                    '"surface": "heights"',
                    "mask",
                )
        elif "roughness" in node and node["surface"] == "heights":
            yield node.key_fault(
                "roughness moves a mesh along its normals, and heights have none: take it away "
                'and add another operator, or say "surface": "mesh"',
                "roughness",
            )

    def apply(self, grid: Grid, height: NDArray[np.float64]) -> Applied:
        """Heights plus those of the topmost surface.

        Raises:
            SceneError: The file cannot be read, or there is no mesh somewhere under the terrain.
        """
        mesh = self._read()
        view, report = self._viewed(grid, self._placed(mesh), mesh.faces)
        top, filled = self._filled(view)
        return height + top, {**_read_report(mesh), **report, **filled}

    def stage(self, grid: Grid, max_triangles: int) -> tuple[MeshSurface, Facts]:
        """The mesh as a surface, its edges no longer than the grid's spacing.

        Args:
            max_triangles: Budget; where it binds, edges stay longer, and the report says so.

        Raises:
            SceneError: As ``apply``.
        """
        mesh = self._read()
        points = self._placed(mesh)
        spacing = max(grid.spacing_m)
        view, _ = self._viewed(grid, points, mesh.faces)
        _, filled = self._filled(view)
        # Of closed solids and of open sheets, the side seen from above is the front.
        flipped = 2 * int(view.down.sum()) > int(np.isfinite(view.top).sum())
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
            octaves = octaves_resolved(rough.octaves, rough.scale_m, 2.0, edge)
            points = roughened(
                points, faces, rough.key, rough.amplitude_m, rough.scale_m, octaves, rough.gain
            )
            report["roughness_octaves"] = octaves
            report["roughness_octaves_below_edge"] = rough.octaves - octaves
        view, above = self._viewed(grid, points, faces)
        # Roughness may draw the mesh's border in; that is no hole of the file's.
        top = _without_holes(view)[0]
        return MeshSurface(grid, top, points, faces), {**report, **above, **filled}

    def _read(self) -> MeshModel:
        return read_model(self.file, unit_m=self.unit_m, up=self.up, part=self.part, looks=False)

    def _placed(self, mesh: MeshModel) -> NDArray[np.float64]:
        turn = affine.about_axis(2, self.rotation_deg)
        points = affine.applied(turn, mesh.points * self.scale)
        if self.place == "center":
            low, high = points[:, :2].min(axis=0), points[:, :2].max(axis=0)
            points[:, :2] -= 0.5 * (low + high)
        points += np.array(self.position_m)
        if not np.isfinite(points).all():
            raise SceneError(f"{self.file.name}: its size overflows; use a smaller scale")
        return points

    def _viewed(
        self, grid: Grid, points: NDArray[np.float64], faces: NDArray[np.int32]
    ) -> tuple[Above, dict[str, Any]]:
        frame = HeightField(grid, np.zeros(grid.shape)).frame()
        view = see(points, faces, frame, grid.shape)
        there = np.isfinite(view.top)
        if not there.any():
            low, high = points.min(axis=0), points.max(axis=0)
            raise SceneError(
                f"{self.file.name}: no part of it lies over a sample of the terrain: it reaches "
                f"from ({low[0]:g}, {low[1]:g}) m to ({high[0]:g}, {high[1]:g}) m, and the terrain "
                f"is {grid.size_m[0]:g} m by {grid.size_m[1]:g} m around (0, 0); check unit_m, up "
                "and place"
            )
        both = np.isfinite(view.floor)
        gap = np.where(both, view.ceiling, 0.0) - np.where(both, view.floor, 0.0)
        over = gap > SAME * max(grid.spacing_m)
        return view, {
            "overhang_fraction": float(over.sum() / there.sum()),
            "overhang_height_max_m": float(gap[over].max(initial=0.0)),
            "facing_down_fraction": float(view.down.sum() / there.sum()),
        }

    def _filled(self, view: Above) -> Applied:
        """Heights without holes."""
        holes = ~np.isfinite(view.top)
        count = int(holes.sum())
        if count == 0:
            return view.top, {}
        if self.holes == "error":
            raise SceneError(
                f"{self.file.name}: {count} of {holes.size} samples of the terrain have no mesh "
                "over or under them; make the terrain smaller or the mesh larger, or say "
                '"holes": "fill"'
            )
        filled, error = _without_holes(view)
        return filled, {"holes_filled": count, "holes_error_m": error}


def _without_holes(view: Above) -> tuple[NDArray[np.float64], float]:
    holes = ~np.isfinite(view.top)
    return fill_holes(np.where(holes, 0.0, view.top), holes)


def _read_report(mesh: MeshModel) -> dict[str, Any]:
    return {
        **({"left_out": list(mesh.notes)} if mesh.notes else {}),
        "triangles_of_file": len(mesh.faces),
        "degenerate_dropped": mesh.degenerate,
        "vertices_welded": mesh.welded,
    }


def _beyond(grid: Grid, points: NDArray[np.float64]) -> dict[str, Any]:
    """Reports how far the mesh exceeds the terrain's rectangle; heights there are its border's."""
    half = 0.5 * np.array(grid.size_m)
    reach = float((np.abs(points[:, :2]) - half).max(initial=0.0))
    return {"beyond_terrain_m": reach if reach > SAME * max(grid.spacing_m) else 0.0}
