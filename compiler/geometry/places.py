"""Takes places that are given by latitude and longitude to the scene's plane."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.geometry.lenses import FUNCTIONS
from scenec.schemas.errors import SceneError
from scenec.schemas.georeference import Georeference


def on_plane(
    places: NDArray[np.float64], georeference: Georeference | None, what: str
) -> NDArray[np.float64]:
    """Returns positions whose latitude and longitude have become x and y, float64 [n, 3].

    Args:
        places: Geodetic latitude and eastern longitude in degrees, and z in meters, [n, 3].
        georeference: Of the terrain; None where it says nothing of its place.
        what: Who gives them, for messages.

    Raises:
        SceneError: There is no georeference, or a place is none on the scene's side of the body.
    """
    latitude, longitude = places[:, 0], places[:, 1]
    if georeference is None:
        raise SceneError(
            f"{what}: latitude_deg and longitude_deg: the terrain lies nowhere on a body: expected "
            "x_m and y_m, or a DEM whose file has a georeference"
        )
    x, y = georeference.local(latitude, longitude, FUNCTIONS)
    bad = ~((np.abs(latitude) <= 90.0) & (np.abs(longitude) <= 360.0) & np.isfinite(x + y))
    if bad.any():
        n = int(np.flatnonzero(bad)[0])
        here = georeference.latitude_deg, georeference.longitude_deg
        raise SceneError(
            f"{what}: place {n + 1} is at {latitude[n]:.9g}° N, {longitude[n]:.9g}° E: expected a "
            "latitude from -90 to 90, a longitude from -360 to 360, and less than a quarter of the "
            f"body away from the terrain's center, {here[0]:.9g}° N, {here[1]:.9g}° E"
        )
    return np.stack([x, y, places[:, 2]], axis=1)
