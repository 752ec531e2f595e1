"""Pictures of terrains, each setting made once, and what they cost."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable, Collection, Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from scenec.lab.experiments.terrains import FULL, SEED, SETTINGS, cfg
from scenec.lab.runner import SCENEC, Page, command
from scenec.schemas.errors import OutputError
from scenec.schemas.spelling import nearest

#: Samples a pixel of a preview; path tracers have those of their setting.
PREVIEW = ("--spp", "8")


@dataclass(frozen=True)
class Frames:
    """Pictures to learn from, or to be asked about.

    Attributes:
        out: Output folder.
        backend: Whose frames.
        batches: Of the output.
    """

    out: Path
    backend: str
    batches: range


@dataclass(frozen=True)
class Renders:
    """Pictures that are made when they are first asked for, in a folder that may be kept.

    Attributes:
        work: The folder.
        resolution: Of pictures.
        batches: Terrains.
        held: The last ones, to be tested on; only ``FULL`` shows them.
        samples: Pictures of each.
    """

    work: Path
    resolution: tuple[int, int]
    batches: int
    held: int
    samples: int

    @property
    def train(self) -> range:
        """Batches to learn from."""
        return range(self.batches - self.held)

    @property
    def held_out(self) -> range:
        """Batches to be tested on."""
        return range(self.batches - self.held, self.batches)

    def count(self, setting: str) -> int:
        """Pictures of a setting."""
        return self.samples * self._terrains(setting)

    def out(self, setting: str) -> Path:
        """Output folder of a setting."""
        return self._folder(setting) / "out"

    def cost(self, setting: str, backend: str) -> float:
        """Makes pictures where they are not made yet; returns CPU seconds a picture."""
        compiled = self._compiled(setting)
        rendered = _once(
            self._folder(setting) / f"{backend}.json", lambda: self._render(setting, backend)
        )
        return (compiled + rendered) / self.count(setting)

    def _terrains(self, setting: str) -> int:
        return self.batches if setting == FULL else len(self.train)

    def _folder(self, setting: str) -> Path:
        return self.work / file_name(setting)

    def _compiled(self, setting: str) -> float:
        """CPU seconds of the stages of a setting; those that change no cfg share them."""
        if setting == FULL or SETTINGS[setting].change:
            file = self._folder(setting) / "compile.json"
            return _once(file, lambda: self._compile(setting))
        seconds = self._compiled(FULL)
        if not self.out(setting).exists():
            ignored = shutil.ignore_patterns("frames")
            shutil.copytree(self.out(FULL), self.out(setting), ignore=ignored)
        return seconds * len(self.train) / self.batches

    def _compile(self, setting: str) -> float:
        made = cfg(self.resolution, self.batches, self.samples)
        if change := SETTINGS[setting].change:
            change(made)
        file = self._folder(setting) / "cfg.json"
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(json.dumps(made), encoding="utf-8")
        return command((*SCENEC, "compile", file, "--seed", str(SEED), "--batches",
                        f"0:{self._terrains(setting)}", "--no-cache", "--replace",
                        "-o", self.out(setting))).cpu_s  # fmt: skip

    def _render(self, setting: str, backend: str) -> float:
        words = PREVIEW if backend == "pyrender" else SETTINGS[setting].words
        return command((*SCENEC, "render", self.out(setting), "--backend", backend, *words,
                        "--batches", f"0:{self._terrains(setting)}",
                        "--workers", str(os.cpu_count()))).cpu_s  # fmt: skip


def of_page(page: Page) -> Renders:
    """Those of a page's form, in its options' folder; experiments share them."""
    work = Path(page.options.work) if page.options.work else page.scratch
    if page.options.full:
        return Renders(work, (320, 240), batches=200, held=40, samples=5)
    if page.fast:
        return Renders(work, (64, 48), batches=4, held=2, samples=1)
    return Renders(work, (96, 72), batches=26, held=6, samples=3)


def chosen(page: Page, known: Collection[str]) -> tuple[str, ...]:
    """Returns the names that ``--only`` gives.

    Raises:
        OutputError: It has one that is not known.
    """
    for name in page.options.only:
        if name not in known:
            raise OutputError(f"--only: there is no {name!r}{nearest(name, known)}")
    return tuple(page.options.only)


def on_all_cores(calls: Iterable[tuple[Any, ...]]) -> Iterator[Any]:
    """Calls functions, one a core in a fresh process, each with its arguments."""
    with ProcessPoolExecutor(os.cpu_count(), mp_context=get_context("spawn")) as pool:
        for job in [pool.submit(*call) for call in calls]:
            yield job.result()


def file_name(setting: str) -> str:
    """Of a setting's folder."""
    return setting.replace(" ", "_").replace(",", "")


def _once(file: Path, work: Callable[[], float]) -> float:
    """What work returned when it was done."""
    if not file.exists():
        file.write_text(json.dumps(work()), encoding="utf-8")
    return float(json.loads(file.read_text(encoding="utf-8")))
