"""Orthographic maps of batches: what ``export --format map`` makes of stages."""

from dataclasses import asdict

from scenec.schemas.vehicle import Vehicle

MAP = "map"
SUMMARY = (
    "stages: heights, slope, roughness, traversability, labels, ids, sun as GeoTIFF; objects "
    "and paths as CSV and GeoJSON"
)
#: Options -> what they are if nobody says, and a line of help.
SETTINGS: dict[str, tuple[str, str]] = {
    "cell_m": ("", "side of a cell, meters (default: a fourteenth of wheel_base_m)"),
    "area_m": ("", "WEST,SOUTH,EAST,NORTH, meters (default: the ground without its horizon)"),
    "layers": ("", "which, such as height,slope (default: all)"),
    "sample": ("0", "time code at which things and the sun stand where they are"),
    "sun_rays": ("1", "rays over the sun's disc at each place; 1 goes to its center"),
    **{
        name: (f"{value:g}", f"of the vehicle: {what}")
        for (name, value), what in zip(
            asdict(Vehicle()).items(),
            (
                "diameter of the disc that it stands on, meters",
                "diameter of its wheels, meters",
                "height of its belly above the plane under it, meters",
                "highest step that a wheel climbs, meters",
                "steepest plane that it drives on, degrees",
                "share of these three from which on a place asks for caution",
            ),
            strict=True,
        )
    },
}
