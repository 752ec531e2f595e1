"""What the ground of a batch is to a vehicle, as pages store it: a byte a cell and layer."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.datasets.colors import TRAVERSABILITY_COLORS, viridis
from scenec.datasets.view.record import short
from scenec.schemas.codec import JsonObject
from scenec.schemas.georeference import Georeference
from scenec.schemas.vehicle import TRAVERSABILITY, Vehicle

#: Degrees of a step of a stored slope, and of a color of the map; the last color has all above.
_SLOPE_STEP, _BAND, _BANDS = 0.5, 5, 8


@dataclass(frozen=True)
class Site:
    """What the ground is to a vehicle, on squares, and where it lies.

    Attributes:
        corner: x and y of the middle of the first cell, meters.
        cell_m: Side of a cell.
        heights: Of the topmost surface, NaN where there is none, meters, float [ny, nx], row 0 at
            the least y.
        slope: Of its face, degrees.
        classes: Of ``TRAVERSABILITY``, uint8; None where cells are too coarse for the vehicle.
        vehicle: Whom it is traversable for.
        place: Where on a body it lies; None: nobody knows.
    """

    corner: tuple[float, float]
    cell_m: float
    heights: NDArray[np.floating]
    slope: NDArray[np.floating]
    classes: NDArray[np.uint8] | None
    vehicle: Vehicle
    place: Georeference | None = None


def site_planes(site: Site, side: int, heights: bool = False) -> tuple[JsonObject, bytes]:
    """Returns what a page needs of a site: facts, and codes of its layers one after the other.

    Args:
        site: The site.
        side: Most cells along a side: of a block of cells the first one's slope and height, and
            the worst class.
        heights: Whether heights come last, as 16 bits, little-endian, evenly from low to high.

    Returns:
        Facts for ``site.js``; a byte a cell of each of their layers, 0 where there is nothing.
    """
    every = max(1, -(-max(site.slope.shape) // side))
    slope = site.slope[::every, ::every]
    codes = np.where(np.isnan(slope), 0.0, 1.0 + np.round(slope / _SLOPE_STEP)).astype(np.uint8)
    colors = viridis(np.linspace(0.0, 1.0, _BANDS)).tolist()
    bands = [f"{_BAND * i} to {_BAND * (i + 1)}°" for i in range(_BANDS - 1)]
    layers: list[dict[str, Any]] = [
        {"name": "slope", "step": _SLOPE_STEP, "band": round(_BAND / _SLOPE_STEP),
         "colors": colors, "names": [*bands, f"above {_BAND * (_BANDS - 1)}°"]},
    ]  # fmt: skip
    planes = [codes]
    if site.classes is not None:
        rows, columns = (np.arange(0, n, every) for n in site.classes.shape)
        worst = np.maximum.reduceat(np.maximum.reduceat(site.classes, rows), columns, axis=1)
        planes.append(worst + np.uint8(1))
        layers.append({"name": "traversability", "band": 1, "names": list(TRAVERSABILITY),
                       "colors": [list(color) for color in TRAVERSABILITY_COLORS],
                       "vehicle": asdict(site.vehicle)})  # fmt: skip
    facts: dict[str, Any] = {
        "corner": [short(v, 12) for v in site.corner],
        "cell": short(site.cell_m, 6),
        "step": short(every * site.cell_m, 12),
        "size": [codes.shape[1], codes.shape[0]],
        "layers": layers,
        "place": None if site.place is None else asdict(site.place),
    }
    data = b"".join(plane.tobytes() for plane in planes)
    if heights:
        z = site.heights[::every, ::every].astype(np.float64)
        known = np.isfinite(z)
        low, high = (float(z[known].min()), float(z[known].max())) if known.any() else (0.0, 0.0)
        facts["heights"] = [low, high]
        part = np.where(known, 1.0 + 65534.0 * (z - low) / (high - low or 1.0), 0.0)
        data += np.round(part).astype("<u2").tobytes()
    return facts, data
