"""Stages as orthographic maps: tiles as units of work, put together batch by batch."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, fields, replace
from pathlib import Path
from typing import Any

from scenec.api.models import ModelsReport, chosen_batches
from scenec.api.options import ExportOptions
from scenec.api.stage_export import StageExport, opening, parsed
from scenec.backends.run.overhead import DescribeSite, MapTile
from scenec.datasets.maps import MAP, SETTINGS
from scenec.datasets.maps.rasters import rasters, write_layers
from scenec.datasets.maps.sheet import SIDE, write_map_sheet
from scenec.datasets.maps.tables import write_table
from scenec.schemas.codec import JsonObject
from scenec.schemas.errors import OutputError
from scenec.schemas.manifest import Batch
from scenec.schemas.site_map import LAYERS, MapGrid, MapOptions, SiteFacts, Table
from scenec.schemas.vehicle import Vehicle

_SHEET = "map.png"
_TABLES = ("objects", "paths", "craters")


def export_maps(out: Path, options: ExportOptions) -> ModelsReport:
    """Writes a folder of maps and tables a batch, and ``export.json`` about them.

    What an export that was cut short has made is not made again.

    Args:
        out: Output folder of a compile, or a USD file.
        options: Those that choose among frames must not be set.

    Raises:
        StageError: A stage cannot be read.
        OutputError: An option makes no sense, or the folder holds another dataset.
    """
    asked = map_options(options.settings)
    batches = chosen_batches(out, MAP, options)
    with rasters():
        # A package that is missing is said before work.
        pass
    return _Maps.export(out, batches, asked, options)


class _Maps(StageExport[SiteFacts]):
    """One call of ``export_maps``."""

    format, files, version = MAP, "maps", 2
    asked: MapOptions

    def describe(self, batch: Batch) -> DescribeSite:
        return DescribeSite(opening(batch), self.asked)

    def make(self, batch: Batch, folder: Path, tiles: Path) -> tuple[JsonObject, list[str]]:
        facts = self.facts[batch.name]
        asked = replace(self.asked, vehicle=facts.vehicle)
        if "traversability" in facts.layers:
            self.options.listener.say(f"{batch.name}: traversability is for {facts.vehicle}")
        grid = MapGrid.over(facts.area_m, asked.cell)
        units = [self._tile(batch, facts, grid, tile, tiles) for tile in grid.tiles]
        todo = [unit for unit in units if not unit.file.is_file()]
        steps = self.options.listener.steps("mapped", unit="tile")
        for number, (unit, _) in enumerate(self.done(todo), len(units) - len(todo) + 1):
            steps(number, len(units), unit.what)
        places = {unit.tile: unit.file for unit in units}
        small = write_layers(folder, grid, facts.layers, facts.place, places.__getitem__, side=SIDE)
        names = [f"{name}.tif" for name in facts.layers]
        for name, table in _tables(facts).items():
            names += write_table(folder, name, table, facts.place)
        write_map_sheet(folder / _SHEET, small, grid, facts.label_names)
        names.append(_SHEET)
        return _entry(facts, grid), names

    def _tile(
        self, batch: Batch, facts: SiteFacts, grid: MapGrid, tile: tuple[int, int], folder: Path
    ) -> MapTile:
        asked = replace(self.asked, vehicle=facts.vehicle)
        file = folder.absolute() / f"{tile[0]:06d}_{tile[1]:06d}.npz"
        return MapTile(opening(batch), facts.digest, grid, tile, asked, facts.layers, file)


def _tables(facts: SiteFacts) -> dict[str, Table]:
    """The tables that there are, by name."""
    found: dict[str, Table] = {name: getattr(facts, name) for name in _TABLES}
    return {name: table for name, table in found.items() if table}


def _entry(facts: SiteFacts, grid: MapGrid) -> dict[str, Any]:
    """What ``export.json`` says of a batch."""
    return {
        "stage_digest": facts.digest,
        "grid": asdict(grid),
        "vehicle": asdict(facts.vehicle),
        "layers": {
            name: dict(zip(("unit", "what"), LAYERS[name.split("_")[0]], strict=True))
            for name in facts.layers
        },
        "labels": {
            level: {str(number): name for number, name in sorted(names.items())}
            for level, names in facts.label_names.items()
        },
        "sun": None if facts.sun is None else {"to_light": facts.sun[:3], "angle": facts.sun[3]},
        "georeference": None if facts.place is None else asdict(facts.place),
        "rows": {name: len(table["x_m"]) for name, table in _tables(facts).items()},
        "losses": list(facts.losses),
    }


def map_options(settings: Sequence[str]) -> MapOptions:
    """The maps that ``--set`` asks for.

    Raises:
        OutputError: A name is unknown, or a value makes no sense.
    """
    given: dict[str, Any] = {
        name: _value(name, value, text)
        for name, (value, text) in parsed(settings, list(SETTINGS)).items()
    }
    of_vehicle = {one.name for one in fields(Vehicle)} & given.keys()
    changes = {name: given.pop(name) for name in sorted(of_vehicle)}
    return MapOptions(**given, changes=changes)


def _value(name: str, value: str, text: str) -> Any:
    if name == "layers":
        return tuple(part.strip() for part in value.split(","))
    try:
        if name in ("sample", "sun_rays"):
            return int(value)
        if name == "area_m":
            west, south, east, north = map(float, value.split(","))
            return west, south, east, north
        return float(value)
    except ValueError:
        what = {"sample": "a whole number", "sun_rays": "a whole number"}
        what["area_m"] = "WEST,SOUTH,EAST,NORTH"
        raise OutputError(f"--set {text!r}: expected {what.get(name, 'a number')}") from None
