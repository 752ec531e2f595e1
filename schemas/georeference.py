"""Says where on a body a scene lies, and takes its places to latitude and longitude and back.

Places go through the plane that touches the ellipsoid at the scene's center, its axes east and
north: the orthographic projection (EPSG method 9840; PROJ ``ortho``; the first two coordinates of a
local "east, north, up" frame at height 0). Both directions are closed forms, at poles and over the
date line, too: a place's foot on the ellipsoid is the root of a quadratic equation. Distances from
the center come out shorter by what ``shortening_m`` bounds: 0.06 m at 10 km on the Moon.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scenec.schemas.lens import NUMPY, Functions

#: Names that reference systems give bodies, and their equatorial radii in kilometers (IAU 2015).
BODIES = {
    "Mercury": 2440.53, "Venus": 6051.8, "Earth": 6378.14, "Moon": 1737.4, "Mars": 3396.19,
    "Phobos": 13.0, "Deimos": 7.8, "Ceres": 487.3, "Vesta": 289.0, "Eros": 17.0, "Io": 1829.4,
    "Europa": 1562.6, "Ganymede": 2631.2, "Callisto": 2410.3, "Enceladus": 256.6, "Titan": 2575.15,
    "Pluto": 1188.3, "Charon": 606.0,
}  # fmt: skip


@dataclass(frozen=True)
class Georeference:
    """Ties the scene's x and y, in meters, to places on a body.

    Attributes:
        body: Its name, of ``BODIES``; "" where the reference system does not tell.
        semi_major_m, semi_minor_m: Radii of its ellipsoid at the equator and to a pole.
        latitude_deg, longitude_deg: Geodetic (planetographic) latitude and eastern longitude of the
            scene's origin.
        east_north: Meters to the east that go with one of x and of y, then meters to the north:
            (1, 0, 0, 1) where y is north; else the turn and stretch of the plane of ``crs``.
        crs: Coordinate reference system of the file: an authority's code, or WKT; "" for none.
        to_crs: (a, b, c, d, e, f) where the scene's plane is that of ``crs``: x, y lie there at
            (a x + b y + c, d x + e y + f), exactly; None where it touches the ellipsoid.
        error_m: How far latitudes and longitudes are off at the DEM's corners, in meters: 0 but
            where the scene's plane is that of ``crs``, of which ``east_north`` is the linear part.
    """

    body: str
    semi_major_m: float
    semi_minor_m: float
    latitude_deg: float
    longitude_deg: float
    east_north: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 1.0)
    crs: str = ""
    to_crs: tuple[float, float, float, float, float, float] | None = None
    error_m: float = 0.0

    def latitude_longitude(
        self, x: ArrayLike, y: ArrayLike, functions: Functions = NUMPY
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Returns geodetic latitudes and eastern longitudes in degrees of places in the scene.

        Args:
            x, y: Meters, arrays of one shape.
            functions: The compiler's own where bytes depend on the result.

        Returns:
            Longitudes in (-180, 180]; NaN where a place is beyond the body's limb.
        """
        x, y = np.asarray(x, np.float64), np.asarray(y, np.float64)
        ex, ey, nx, ny = self.east_north
        east, north = ex * x + ey * y, nx * x + ny * y
        center, axes = self._frame(functions)
        radii = self.semi_major_m, self.semi_major_m, self.semi_minor_m
        flat = [axes[0][i] * east + axes[1][i] * north for i in range(3)]
        # center + flat + t up lies on the ellipsoid: a t^2 + 2 b t + c = 0. The center is on it and
        # flat is tangent there, which leaves of c only the last term.
        a = sum((axes[2][i] / radii[i]) * (axes[2][i] / radii[i]) for i in range(3))
        b = sum(axes[2][i] * (center[i] + flat[i]) / (radii[i] * radii[i]) for i in range(3))
        c = sum((flat[i] / radii[i]) * (flat[i] / radii[i]) for i in range(3))
        with np.errstate(invalid="ignore"):
            t = -c / (b + np.sqrt(b * b - a * c))
        px, py, pz = (center[i] + flat[i] + t * axes[2][i] for i in range(3))
        shape = (self.semi_minor_m / self.semi_major_m) * (self.semi_minor_m / self.semi_major_m)
        latitude = functions.atan2(pz, shape * np.sqrt(px * px + py * py))
        longitude = functions.atan2(py, px)
        return np.asarray(latitude * (180.0 / math.pi)), np.asarray(longitude * (180.0 / math.pi))

    def local(
        self, latitude_deg: ArrayLike, longitude_deg: ArrayLike, functions: Functions = NUMPY
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Returns x and y of places on the ellipsoid, in meters; NaN beyond the body's limb.

        Args:
            latitude_deg, longitude_deg: Geodetic and eastern: arrays of one shape.
            functions: The compiler's own where bytes depend on the result.
        """
        center, axes = self._frame(functions)
        place = self._on_ellipsoid(
            np.asarray(latitude_deg, np.float64), np.asarray(longitude_deg, np.float64), functions
        )
        away = [place[i] - center[i] for i in range(3)]
        east, north = (sum(axis[i] * away[i] for i in range(3)) for axis in axes[:2])
        # In front of the limb the surface faces up.
        radii = self.semi_major_m, self.semi_major_m, self.semi_minor_m
        facing = sum(axes[2][i] * place[i] / (radii[i] * radii[i]) for i in range(3))
        ex, ey, nx, ny = self.east_north
        determinant = ex * ny - ey * nx
        x = (ny * east - ey * north) / determinant
        y = (ex * north - nx * east) / determinant
        return np.where(facing > 0.0, x, np.nan), np.where(facing > 0.0, y, np.nan)

    def shortening_m(self, distance_m: float) -> float:
        """Bounds by how much a distance from the center in the plane is shorter than on the ground.

        The bound is Lagrange's remainder of the arc's sine on a sphere of the ellipsoid's smallest
        radius of curvature; inf at and beyond that radius.
        """
        b, a = sorted((self.semi_major_m, self.semi_minor_m))
        u = distance_m * a / (b * b)
        if not u < 1.0:
            return math.inf
        s = 1.0 - u * u
        return distance_m * u * u * (1.0 + 2.0 * u * u) / (6.0 * s * s * math.sqrt(s))

    def plane(self) -> tuple[str, tuple[float, float, float, float, float, float]]:
        """Returns a reference system that holds the scene's plane, as PROJ and GDAL read it.

        Returns:
            Its text, and (a, b, c, d, e, f): x, y lie there at (a x + b y + c, d x + e y + f).
        """
        if self.to_crs is not None:
            return self.crs, self.to_crs
        text = (
            f"+proj=ortho +lat_0={self.latitude_deg!r} +lon_0={self.longitude_deg!r} "
            f"+a={self.semi_major_m!r} +b={self.semi_minor_m!r} +units=m +no_defs"
        )
        ex, ey, nx, ny = self.east_north
        return text, (ex, ey, 0.0, nx, ny, 0.0)

    def _frame(self, functions: Functions) -> tuple[list[float], list[list[float]]]:
        """The center from the body's own, and directions east, north and up there."""
        sin, cos = _sine_cosine(functions, np.array([self.latitude_deg, self.longitude_deg]))
        (sp, sl), (cp, cl) = sin.tolist(), cos.tolist()
        here = np.array([self.latitude_deg]), np.array([self.longitude_deg])
        center = [float(part[0]) for part in self._on_ellipsoid(*here, functions)]
        return center, [[-sl, cl, 0.0], [-sp * cl, -sp * sl, cp], [cp * cl, cp * sl, sp]]

    def _on_ellipsoid(
        self, latitude: NDArray[np.float64], longitude: NDArray[np.float64], functions: Functions
    ) -> tuple[NDArray[np.float64], ...]:
        """Places from the body's center."""
        sp, cp = _sine_cosine(functions, latitude)
        sl, cl = _sine_cosine(functions, longitude)
        a, b = self.semi_major_m, self.semi_minor_m
        scale = 1.0 / np.sqrt((a * cp) * (a * cp) + (b * sp) * (b * sp))
        return a * a * cp * cl * scale, a * a * cp * sl * scale, b * b * sp * scale


def body_of(words: str, radius_m: float) -> str:
    """Returns the body that a reference system is of, by its words, else by its radius; or ""."""
    for name in BODIES:
        if re.search(f"(?<![a-z]){name.lower()}(?![a-z])", words.lower()):
            return name
    near = [name for name, km in BODIES.items() if abs(radius_m / (1e3 * km) - 1.0) < 0.005]
    return near[0] if len(near) == 1 else ""


def _sine_cosine(
    functions: Functions, degrees: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    angles = degrees * (math.pi / 180.0)
    return functions.sin(angles), functions.cos(angles)
