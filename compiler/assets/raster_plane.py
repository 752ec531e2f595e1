"""Lays rasters of a body's ground under the scene's plane: where in a file a place of it lies."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.arithmetic import elementary
from scenec.compiler.geometry.lenses import FUNCTIONS
from scenec.schemas.errors import SceneError
from scenec.schemas.georeference import Georeference, body_of

Affine = tuple[float, float, float, float, float, float]
Pair = tuple[NDArray[np.float64], NDArray[np.float64]]

_RADIAN = elementary.PI / 180.0
#: Part of a pixel to which PROJ's coordinates are rounded: its last bits depend on the CPU.
_SNAP = 1.0 / 1024.0
#: Meters over which the linear part of a reference system is measured.
_STEP_M = 100.0


@dataclass(frozen=True)
class RasterFrame:
    """Describes how a raster lies in its coordinates, and these on a body.

    Attributes:
        crs: Coordinate reference system: an authority's code, or WKT; "" where the file has none.
        axis_m: Meters per unit of its axes; None where they are angles or not known.
        transform: (a, b, c, d, e, f): pixel (column, row) corners lie at (a column + b row + c,
            d column + e row + f).
        radii_m: Of the body's ellipsoid, equatorial and polar; None where it is not known.
        body: Its name, or "".
        degrees: (a, b, c, d) where coordinates x, y are eastern longitude a x + b and latitude
            c y + d: geographic systems, and equidistant cylindrical ones of spheres.
        geographic: Whether its axes are angles.
        centric: Whether its latitudes are planetocentric ones of an ellipsoid.
    """

    crs: str
    axis_m: float | None
    transform: Affine
    radii_m: tuple[float, float] | None = None
    body: str = ""
    degrees: tuple[float, float, float, float] | None = None
    geographic: bool = False
    centric: bool = False

    def at(self, column: float, row: float) -> tuple[float, float]:
        """Returns coordinates of a place in the file, in pixels from its first corner."""
        a, b, c, d, e, f = self.transform
        return a * column + b * row + c, d * column + e * row + f

    def pixels(self, x: Any, y: Any) -> tuple[Any, Any]:
        """Returns (column, row), in pixels from the first corner, of places in its coordinates."""
        a, b, c, d, e, f = self.transform
        determinant = a * e - b * d
        x, y = x - c, y - f
        return (e * x - b * y) / determinant, (a * y - d * x) / determinant

    def cut(self, column: int, row: int) -> RasterFrame:
        """Returns the frame of a part that begins at a pixel."""
        a, b, _, d, e, _ = self.transform
        x, y = self.at(column, row)
        return replace(self, transform=(a, b, x, d, e, y))

    def first_row(self) -> str:
        """Returns which end of the file is its northern one, by the transform: north or south."""
        return "south" if self.transform[4] > 0.0 else "north"

    def pixel_m(self) -> tuple[float, float] | None:
        """Returns the size of a pixel in meters; None where axes are no lengths."""
        a, b, _, d, e, _ = self.transform
        if self.axis_m is None or a * e == b * d:
            return None
        return _length(a, d) * self.axis_m, _length(b, e) * self.axis_m

    def turns(self) -> int | None:
        """Returns how many columns go around the body; None where columns are no longitudes."""
        if self.degrees is None or self.transform[1] != 0.0 or self.transform[3] != 0.0:
            return None
        return round(360.0 / abs(self.degrees[0] * self.transform[0]))


@dataclass(frozen=True)
class RasterPlane:
    """Lays a raster under the scene's plane.

    Attributes:
        frame: Of the raster.
        spot: The scene's origin in the frame's coordinates.
        steps: (columns per x, columns per y, rows per x, rows per y), per meter, where the scene's
            plane is that of the coordinates; None where it touches the body.
        columns: Of the raster. Longitudes are taken by whole turns to the spot, or to the middle of
            what goes around the body.
    """

    frame: RasterFrame
    spot: tuple[float, float]
    steps: tuple[float, float, float, float] | None
    columns: int

    def pixels(self, x: NDArray[np.float64], y: NDArray[np.float64]) -> Pair:
        """Returns (column, row), in pixels from the first corner, of places in the scene."""
        if self.steps is not None:
            column, row = self.frame.pixels(*self.spot)
            a, b, c, d = self.steps
            return a * x + b * y + column, c * x + d * y + row
        latitude, longitude = self.touching().latitude_longitude(x, y, FUNCTIONS)
        return self.pixels_at(latitude, longitude)

    def pixels_at(self, latitude: NDArray[np.float64], longitude: NDArray[np.float64]) -> Pair:
        """Returns the same of geodetic latitudes and eastern longitudes, by ``frame.degrees``."""
        assert self.frame.degrees is not None
        a, b, c, d = self.frame.degrees
        if self.frame.centric:
            latitude = _centric(latitude, self.frame)
        around = self.columns > (self.frame.turns() or np.inf)
        x = self.frame.at(0.5 * self.columns, 0.0)[0] if around else self.spot[0]
        longitude = _near(longitude, a * x + b)
        found: Pair = self.frame.pixels((longitude - b) / a, (latitude - d) / c)
        return found

    def pixel_m(self, half_m: tuple[float, float]) -> tuple[float, float] | None:
        """Returns the size of pixels along columns and rows, meters; None where it varies.

        Args:
            half_m: Half the sides of the rectangle about the origin that they are asked for: at its
                middle and its corners they may differ by a tenth.
        """
        corners = np.array([[0, 0], [1, 1], [1, -1], [-1, 1], [-1, -1]]) * np.array(half_m)
        x, y = corners[:, 0, None], corners[:, 1, None]
        step = np.array([0.5, -0.5, 0.0, 0.0])
        columns, rows = self.pixels((x + step).ravel(), (y + step[[2, 3, 0, 1]]).ravel())
        (a, b), (c, d) = (
            (k[:, 0] - k[:, 1], k[:, 2] - k[:, 3])
            for k in (columns.reshape(5, 4), rows.reshape(5, 4))
        )
        with np.errstate(divide="ignore", invalid="ignore"):
            sizes = np.stack([_length(d, c), _length(a, b)]) / np.abs(a * d - b * c)
        if not (sizes.max(axis=1) < 1.1 * sizes.min(axis=1)).all():
            return None
        return float(sizes[0, 0]), float(sizes[1, 0])

    def touching(self) -> Georeference:
        """Returns the plane that touches the body at the spot.

        Raises:
            SceneError: That is beyond a pole.
        """
        latitude, longitude = _geodetic(self.frame, *(np.array([part]) for part in self.spot))
        if not abs(latitude[0]) <= 90.0 + 1e-9:
            raise SceneError(
                f"its coordinates would be degrees, and have a latitude of {latitude[0]:g}: give "
                "pixel_m"
            )
        return _touching(self.frame, float(latitude[0]), float(longitude[0]))

    def georeference(self, reach_m: float) -> Georeference | None:
        """Returns where the scene lies; None where the file does not say on which body.

        Args:
            reach_m: Distance in x and y at which the error is measured.

        Latitudes and longitudes of projected systems are PROJ's, rounded to 1e-9 degrees; nothing
        else is computed with them.
        """
        frame = self.frame
        if frame.radii_m is None or not (frame.axis_m or frame.degrees):
            return None
        if self.steps is None:
            return replace(self.touching(), crs=frame.crs)
        a, b, c, d = self.steps
        p, q, _, r, s, _ = frame.transform
        linear = p * a + q * c, p * b + q * d, r * a + s * c, r * b + s * d
        # The origin, one step along x and y to either side, and the far corners.
        sides = np.array([0.0, 1.0, -1.0, 0.0, 0.0]) * _STEP_M
        x = np.concatenate([sides, np.array([1.0, 1.0, -1.0, -1.0]) * reach_m])
        y = np.concatenate([sides[[0, 3, 4, 1, 2]], np.array([1.0, -1.0, 1.0, -1.0]) * reach_m])
        found = _geodetic(
            frame,
            linear[0] * x + linear[1] * y + self.spot[0],
            linear[2] * x + linear[3] * y + self.spot[1],
        )
        if not all(np.isfinite(part).all() for part in found):
            return None
        here = _touching(frame, *(round(float(part[0]), 9) for part in found))
        east, north = here.local(*found, FUNCTIONS)
        ex, ey, nx, ny = (
            round(float(part[i] - part[i + 1]) / (2.0 * _STEP_M), 9)
            for part in (east, north)
            for i in (1, 3)
        )
        if ex * ny == ey * nx:
            return None
        off = _length(east - (ex * x + ey * y), north - (nx * x + ny * y))
        return replace(
            here,
            east_north=(ex, ey, nx, ny),
            crs=frame.crs,
            to_crs=(linear[0], linear[1], self.spot[0], linear[2], linear[3], self.spot[1]),
            error_m=float(f"{off[5:].max():.3g}"),
        )


def plane_of(
    frame: RasterFrame,
    columns: int,
    spot: tuple[float, float],
    pixel_m: tuple[float, float] | None,
    touch: bool,
) -> RasterPlane | None:
    """Returns how a raster lies under the scene; None where nothing says how large pixels are.

    Args:
        frame: Of the raster.
        columns: Of it.
        spot: The scene's origin in its coordinates.
        pixel_m: Size along its columns and its rows that pixels get; None takes the file's.
        touch: Whether the plane touches the body, where latitudes and longitudes are known by our
            own arithmetic, though the coordinates are lengths.
    """
    a, b, _, d, e, _ = frame.transform
    if pixel_m is None and frame.degrees and frame.radii_m and (touch or frame.geographic):
        return RasterPlane(frame, spot, None, columns)
    size = pixel_m or frame.pixel_m()
    if size is None or a * e == b * d:
        return None
    # Meters per column and per row, along x and y.
    wide, high = size[0] / _length(a, d), size[1] / _length(b, e)
    xc, xr, yc, yr = a * wide, b * high, d * wide, e * high
    determinant = xc * yr - xr * yc
    steps = yr / determinant, -xr / determinant, -yc / determinant, xc / determinant
    return RasterPlane(frame, spot, steps, columns)


def spot_at(
    file: str, frame: RasterFrame, columns: int, latitude: float, longitude: float
) -> tuple[float, float]:
    """Returns a place of geodetic latitude and eastern longitude in a frame's coordinates.

    Where they are PROJ's, they are rounded to a 1024th of a pixel: no byte depends on its last bit.

    Raises:
        SceneError: The file does not say on which body it lies, or its coordinates do not hold that
            place.
    """
    if frame.degrees is not None:
        a, b, c, d = frame.degrees
        if frame.centric:
            latitude = float(_centric(np.array([latitude]), frame)[0])
        longitude = _near(longitude, a * frame.at(0.5 * columns, 0.0)[0] + b)
        return (longitude - b) / a, (latitude - d) / c
    if frame.radii_m is None or frame.axis_m is None:
        raise SceneError(
            f"{file}: does not say where on a body it lies: give the window's x_m and y_m"
        )
    from rasterio import warp
    from rasterio.crs import CRS

    try:
        x, y = warp.transform(_body(frame), CRS.from_string(frame.crs), [longitude], [latitude])
    except Exception as error:
        if type(error).__module__.partition(".")[0] != "rasterio":
            raise
        raise SceneError(f"{file}: its coordinates have no such latitude: {error}") from error
    column, row = frame.pixels(x[0], y[0])
    if not np.isfinite([column, row]).all():
        raise SceneError(f"{file}: its coordinates do not reach there")
    return frame.at(round(column / _SNAP) * _SNAP, round(row / _SNAP) * _SNAP)


def frame_of(crs: Any, transform: Affine) -> RasterFrame:
    """Returns the frame of a raster's reference system (rasterio's, or None) and transform."""
    if not crs:
        return RasterFrame("", None, transform)
    wkt = crs.to_wkt(version="WKT2_2019")
    axis_m = None
    if crs.is_projected:
        name, factor = crs.linear_units_factor
        axis_m = float(factor) if name and 0.0 < factor < np.inf else None
    frame = RasterFrame(crs.to_string(), axis_m, transform)
    found = re.search(r'ELLIPSOID\["[^"]*",([\d.eE+]+),([\d.eE+]+)', wkt)
    if found is None:
        return frame
    major, inverse = float(found[1]), float(found[2])
    minor = major * (1.0 - 1.0 / inverse) if inverse else major
    titles = re.findall(r'(?:CRS|DATUM|ENSEMBLE|ELLIPSOID)\["([^"]*)"', wkt)
    frame = replace(frame, radii_m=(major, minor), body=body_of("; ".join(titles), major))
    prime = re.search(r'PRIMEM\["[^"]*",([-\d.eE+]+)', wkt)
    zero = float(prime[1]) if prime else 0.0
    if axis_m is None and re.search(r"GEOG?D?CRS\[", wkt) and not crs.is_projected:
        west = re.search(r'AXIS\["[^"]*longitude[^"]*",west', wkt) is not None
        return replace(
            frame,
            degrees=(-1.0 if west else 1.0, zero, 1.0, 0.0),
            geographic=True,
            # GeoTIFF keeps the name alone.
            centric=minor != major and "ocentric" in wkt.lower(),
        )
    terms = crs.to_dict()
    if terms.get("proj") != "eqc" or minor != major or axis_m is None:
        return frame
    # Snyder, Map projections (USGS PP 1395), equations 12-1 and 12-2, in degrees.
    true = float(elementary.cos(float(terms.get("lat_ts", 0.0)) * _RADIAN))
    x0, y0, lon, lat = (float(terms.get(name, 0.0)) for name in ("x_0", "y_0", "lon_0", "lat_0"))
    a, c = axis_m / (major * true * _RADIAN), axis_m / (major * _RADIAN)
    return replace(frame, degrees=(a, zero + lon - a * x0 / axis_m, c, lat - c * y0 / axis_m))


def _geodetic(frame: RasterFrame, x: NDArray[np.float64], y: NDArray[np.float64]) -> Pair:
    """Geodetic latitudes and eastern longitudes of places in a frame's coordinates."""
    if frame.degrees is not None:
        a, b, c, d = frame.degrees
        latitude, longitude = c * y + d, a * x + b
        if frame.centric:
            major, minor = _squares(frame)
            angle = latitude * _RADIAN
            latitude = (
                FUNCTIONS.atan2(major * FUNCTIONS.sin(angle), minor * FUNCTIONS.cos(angle))
                / _RADIAN
            )
        return latitude, _near(longitude, 0.0)
    from rasterio import warp
    from rasterio.crs import CRS

    longitude, latitude = warp.transform(
        CRS.from_string(frame.crs), _body(frame), x.tolist(), y.tolist()
    )
    return np.array(latitude), np.array(longitude)


def _near(longitude: Any, middle: float) -> Any:
    """Longitudes within half a turn of another."""
    return longitude - 360.0 * np.floor((longitude - middle) / 360.0 + 0.5)


def _centric(latitude: NDArray[np.float64], frame: RasterFrame) -> NDArray[np.float64]:
    """Planetocentric latitudes of geodetic ones, in degrees."""
    major, minor = _squares(frame)
    angle = latitude * _RADIAN
    return FUNCTIONS.atan2(minor * FUNCTIONS.sin(angle), major * FUNCTIONS.cos(angle)) / _RADIAN


def _body(frame: RasterFrame) -> str:
    """Latitudes and eastern longitudes on a frame's ellipsoid, for PROJ."""
    assert frame.radii_m is not None
    return "+proj=longlat +a={!r} +b={!r} +no_defs".format(*frame.radii_m)


def _squares(frame: RasterFrame) -> tuple[float, float]:
    assert frame.radii_m is not None
    major, minor = frame.radii_m
    return major * major, minor * minor


def _touching(frame: RasterFrame, latitude: float, longitude: float) -> Georeference:
    assert frame.radii_m is not None
    return Georeference(frame.body, *frame.radii_m, latitude, longitude)


def _length(x: Any, y: Any) -> Any:
    return np.sqrt(x * x + y * y)
