"""Maps of a stage as units of work: first what there is to map, then a tile each."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from scenec.backends.run.units import Opening
from scenec.schemas.errors import OutputError, StageError
from scenec.schemas.files import atomic, sweep
from scenec.schemas.site_map import MapGrid, MapOptions, SiteFacts
from scenec.schemas.units import Keeper

if TYPE_CHECKING:
    from scenec.backends.run.session import Session


@dataclass(frozen=True)
class DescribeSite:
    """Opens a stage, and tells what there is to map: ``SiteFacts``.

    Attributes:
        holds: The stage.
        options: What maps are asked for.
    """

    holds: Opening
    options: MapOptions

    @property
    def what(self) -> str:
        """In messages."""
        return f"map of {self.holds.stage}"

    def run(self, keeper: Keeper) -> SiteFacts:
        """Reads it, unless it is held.

        Raises:
            StageError: It cannot be read.
            OutputError: It has no such sample.
        """
        session, sample = self.holds.session(keeper), self.options.sample
        if not 0 <= sample < session.scene.samples:
            raise OutputError(
                f"sample={sample}: {self.holds.stage} has the samples 0 to "
                f"{session.scene.samples - 1}"
            )
        return _facts(session, self.options)


def _facts(session: Session, options: MapOptions) -> SiteFacts:
    # Imported here: who gives units out has no need of it.
    from scenec.backends.annotation.overhead import brightest
    from scenec.backends.annotation.overhead_tables import (
        craters_table,
        ground_area,
        objects_table,
        paths_table,
    )

    scene, sample = session.scene, options.sample
    area = options.area_m or ground_area(scene)
    sun = brightest(scene, sample)
    layers: list[str] = []
    for name in options.layers:
        if name == "label":
            layers += [f"label_{level}" for level in scene.levels]
        elif name != "sun" or sun is not None:
            layers.append(name)
    return SiteFacts(
        digest=scene.digest,
        area_m=area,
        layers=tuple(layers),
        label_names=scene.label_names,
        objects=objects_table(scene, session.caster(trees=False), session.instances, sample, area),
        paths=paths_table(scene),
        sun=sun,
        losses=scene.losses,
        place=scene.georeference,
        craters=craters_table(scene, session.caster(trees=False), sample, area),
        vehicle=options.for_vehicle(scene.vehicle),
    )


@dataclass(frozen=True)
class MapTile:
    """Maps a tile, and writes its layers as NumPy arrays by name.

    Attributes:
        holds: Its stage.
        digest: Of the stage.
        grid: All cells of the map.
        tile: Row and column of its first cell.
        options: What maps are asked for.
        layers: As of ``SiteFacts``.
        file: The .npz, absolute.
    """

    holds: Opening
    digest: str
    grid: MapGrid
    tile: tuple[int, int]
    options: MapOptions
    layers: tuple[str, ...]
    file: Path

    @property
    def what(self) -> str:
        """In messages."""
        row, column = self.tile
        return f"{self.file.parent.name}, cells from row {row} and column {column} on"

    def run(self, keeper: Keeper) -> None:
        """Casts its rays and writes it.

        Raises:
            StageError: The stage is no more what it was.
            OutputError: A file cannot be written.
        """
        from scenec.backends.annotation.overhead import map_tile

        session = self.holds.session(keeper)
        scene = session.scene
        if scene.digest != self.digest:
            raise StageError(f"{scene.source}: has changed since its map was begun; export again")
        arrays = map_tile(
            scene, session.caster(trees=False), self.grid, self.tile, self.options, self.layers
        )
        with atomic(self.file) as temporary, temporary.open("wb") as out:
            np.savez(out, allow_pickle=False, **arrays)

    def clean(self) -> None:
        """Removes what a worker that died left half written."""
        sweep([self.file.parent])
