"""Stages as orthographic maps: tiles as units of work, put together batch by batch."""

from __future__ import annotations

import hashlib
import os
import shutil
from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from scenec.api.models import ModelsReport, chosen_batches, dataset_folder
from scenec.api.options import ExportOptions
from scenec.api.steps import hire
from scenec.backends.run.overhead import DescribeSite, MapTile
from scenec.backends.run.units import Opening
from scenec.datasets.export_records import EXPORT
from scenec.datasets.maps import MAP, SETTINGS
from scenec.datasets.maps.rasters import rasters, write_layers
from scenec.datasets.maps.sheet import write_map_sheet
from scenec.datasets.maps.tables import write_table
from scenec.datasets.models.verify import ModelsRecord
from scenec.schemas.codec import encode, read_record
from scenec.schemas.errors import OutputError
from scenec.schemas.files import as_json, check_writable, read_json, sha256, sweep, write_json
from scenec.schemas.lock import LOCK, Lock
from scenec.schemas.manifest import LEFT_OUT, Batch
from scenec.schemas.passes import ANNOTATION
from scenec.schemas.site_map import LAYERS, MapGrid, MapOptions, SiteFacts
from scenec.schemas.spelling import nearest
from scenec.schemas.units import Executor, Unit, run_all
from scenec.schemas.update import finish_update, reading, replace_files
from scenec.schemas.vehicle import Vehicle
from scenec.schemas.versions import version_of

#: Changes whenever the same stage would give other maps.
_VERSION = 1
_SHEET = "map.png"
_TABLES = ("objects", "paths")
_PRUNED = (
    "objects and ground that no camera sees the effect of are not in the stage, or are coarse; "
    "scenec compile --keep all keeps them"
)


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
    folder = dataset_folder(out, MAP, options)
    with rasters():
        # A package that is missing is said before work.
        pass
    finish_update(folder)
    check_writable(folder.parent)
    partial = folder.with_name(f".{folder.name}.partial")
    try:
        (partial / "data").mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"{partial}: cannot be written: {error.strerror or error}") from error
    work = replace(options, workers=options.workers or 0)
    with reading(out), Lock(partial / LOCK, what=folder), hire(work) as executor:
        export = _Export(batches, asked, folder, partial, options, executor)
        return export.run()


@dataclass
class _Export:
    """One call of ``export_maps``."""

    batches: Sequence[Batch]
    asked: MapOptions
    folder: Path
    partial: Path
    options: ExportOptions
    executor: Executor

    def run(self) -> ModelsReport:
        """Makes what is missing."""
        self.executor.prepare(self.partial)
        old = _written(self.folder, self.key, self.options.replace)
        if old is not None and old["key"] == self.key:
            self.options.listener.say("the maps are there already, made of the same stages")
            shutil.rmtree(self.partial, ignore_errors=True)
            return self._report(old)
        made = {batch.name: self._batch(batch) for batch in self.batches}
        content = {
            "format": MAP,
            "scenec": version_of(),
            "key": self.key,
            "options": encode(self.asked),
            "batches": {name: one["batch"] for name, one in made.items()},
            "files": {path: of for one in made.values() for path, of in one["files"].items()},
        }
        data = self.partial / "data"
        sweep([data])
        write_json(data / EXPORT, content)
        gone = set() if old is None else set(old["files"]) - set(content["files"])
        self.folder.parent.mkdir(parents=True, exist_ok=True)
        replace_files(data, self.folder, sorted(p for p in gone if (self.folder / p).is_file()))
        shutil.rmtree(self.partial, ignore_errors=True)
        return self._report(content)

    def _report(self, content: dict[str, Any]) -> ModelsReport:
        files = tuple(self.folder / path for path in content["files"])
        return ModelsReport(self.folder, MAP, files, content)

    @cached_property
    def sites(self) -> dict[str, SiteFacts]:
        """What there is to map, by batch."""
        units = [DescribeSite(_opening(batch), self.asked) for batch in self.batches]
        found = (facts for _, facts in self._done(units, in_order=True))
        return {batch.name: facts for batch, facts in zip(self.batches, found, strict=True)}

    @cached_property
    def key(self) -> str:
        """Digest of all that maps depend on."""
        return _digest([[name, facts.digest] for name, facts in self.sites.items()], self.asked)

    def _done(self, units: Sequence[Unit], in_order: bool = False) -> Iterator[tuple[Unit, Any]]:
        with closing(run_all(self.executor, units, in_order=in_order)) as ended:
            for unit, outcome in ended:
                for line in outcome.warnings:
                    self.options.listener.warn(line)
                yield unit, outcome.result()

    def _batch(self, batch: Batch) -> dict[str, Any]:
        """Makes a batch's files, unless an earlier export has; returns what is said of them."""
        facts = self.sites[batch.name]
        key = _digest([[batch.name, facts.digest]], self.asked)
        record = self.partial / f"{batch.name}.json"
        if record.is_file():
            found: dict[str, Any] = read_json(record, OutputError, "record of an export")
            if found.get("key") == key:
                return found
        grid = MapGrid.over(facts.area_m, self.asked.cell)
        tiles = self.partial / "tiles" / key[:16]
        folder = self.partial / "data" / batch.name
        # What a killed process left half written goes.
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        units = [self._tile(batch, facts, grid, tile, tiles) for tile in grid.tiles]
        todo = [unit for unit in units if not unit.file.is_file()]
        steps = self.options.listener.steps("mapped", unit="tile")
        for number, (unit, _) in enumerate(self._done(todo), len(units) - len(todo) + 1):
            steps(number, len(units), unit.what)
        files = {unit.tile: unit.file for unit in units}
        write_layers(folder, grid, facts.layers, facts.place, files.__getitem__)
        names = [f"{name}.tif" for name in facts.layers]
        for table in _TABLES:
            names += write_table(folder, table, getattr(facts, table), facts.place)
        write_map_sheet(folder / _SHEET, folder, grid, facts.layers, facts.label_names)
        names.append(_SHEET)
        written = {
            f"{batch.name}/{name}": {
                "bytes": (folder / name).stat().st_size,
                "sha256": sha256(folder / name),
            }
            for name in names
        }
        said = _entry(facts, grid)
        if (batch.folder / LEFT_OUT).is_file():
            said["losses"].append(_PRUNED)
        entry = {"key": key, "batch": said, "files": written}
        write_json(record, entry)
        shutil.rmtree(tiles, ignore_errors=True)
        return entry

    def _tile(
        self, batch: Batch, facts: SiteFacts, grid: MapGrid, tile: tuple[int, int], folder: Path
    ) -> MapTile:
        file = folder.absolute() / f"{tile[0]:06d}_{tile[1]:06d}.npz"
        return MapTile(_opening(batch), facts.digest, grid, tile, self.asked, facts.layers, file)


def _opening(batch: Batch) -> Opening:
    return Opening(os.path.abspath(batch.stage), ANNOTATION, "auto", ())


def _digest(stages: list[list[str]], asked: MapOptions) -> str:
    known = [version_of(), _VERSION, encode(asked), stages]
    return hashlib.sha256(as_json(known).encode()).hexdigest()


def _entry(facts: SiteFacts, grid: MapGrid) -> dict[str, Any]:
    """What ``export.json`` says of a batch."""
    return {
        "stage_digest": facts.digest,
        "grid": asdict(grid),
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
        "rows": {name: len(next(iter(getattr(facts, name).values()))) for name in _TABLES},
        "losses": list(facts.losses),
    }


def _written(folder: Path, key: str, may_replace: bool) -> dict[str, Any] | None:
    """What ``export.json`` of the maps says that are there; None where the folder is free.

    Raises:
        OutputError: Something else is there, and is not to be replaced.
    """
    if not folder.exists() or (folder.is_dir() and not any(folder.iterdir())):
        return None
    path = folder / EXPORT
    found = read_json(path, OutputError, "export.json") if path.is_file() else None
    if not isinstance(found, dict) or found.get("format") != MAP:
        raise OutputError(
            f"{folder}: is not empty and holds no maps of scenec; choose another folder with -o"
        )
    read_record(path, ModelsRecord, OutputError, f"{EXPORT} of scenec")
    if found.get("key") != key and not may_replace:
        raise OutputError(
            f"{folder}: holds other maps (of other stages, or made in another way); choose another "
            "folder with -o, or give --replace"
        )
    return found


def map_options(settings: Sequence[str]) -> MapOptions:
    """The maps that ``--set`` asks for.

    Raises:
        OutputError: A name is unknown, or a value makes no sense.
    """
    given: dict[str, Any] = {}
    for text in settings:
        name, equals, value = (part.strip() for part in text.partition("="))
        if not equals or name not in SETTINGS:
            raise OutputError(
                f"--set {text!r}: expected NAME=VALUE of {', '.join(SETTINGS)}"
                f"{nearest(name, SETTINGS)}"
            )
        given[name] = _value(name, value, text)
    of_vehicle = {one.name for one in fields(Vehicle)} & given.keys()
    vehicle = Vehicle(**{name: given.pop(name) for name in of_vehicle})
    return MapOptions(**given, vehicle=vehicle)


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
