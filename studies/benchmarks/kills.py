"""Kills a worker, the scheduler or the command at a random moment, and looks at what is left.

    python studies/benchmarks/kills.py [--runs N] [--backend NAME] [--seed S]

Each run renders the demo (configs/jacksboro.json, small pictures) on a dask scheduler and two dask
workers of its own. One process of theirs gets SIGKILL at a random moment; then what died is started
again, and the command is run until it succeeds. It is an error if a frame that has its sidecar
differs from the undisturbed one, then or in the end, if one is missing in the end, or if anything
temporary or any process is left.
"""

from __future__ import annotations

import hashlib
import random
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from scenec.schemas.errors import ScenecError
from scenec.schemas.frames import read_frame
from scenec.studies.benchmarks.workers import compiled
from scenec.studies.runner import Study, run

from dask_processes import DaskProcesses, dask_processes
from processes import until_gone

KINDS = ("unit's process", "dask worker", "scheduler", "command")
SAMPLES = 24
FRAMES = "batch_0000/frames/*/*/0*.json"


def annotation(out: Path) -> dict[str, str]:
    """Digest of all passes but rgb, and of the table, of each frame that has its sidecar."""
    found = {}
    for path in sorted(out.glob(FRAMES)):
        digest = hashlib.sha256(path.with_suffix(".instances.csv").read_bytes())
        for name, values in sorted(read_frame(path).passes.items()):
            if name != "rgb":
                digest.update(name.encode() + values.tobytes())
        found[f"{path.parent.name}/{path.stem}"] = digest.hexdigest()
    return found


def start(out: Path, dask: DaskProcesses, backend: str) -> subprocess.Popen[bytes]:
    """The command, under way."""
    passes = "label,instance,depth" + ("" if backend == "annotation" else ",rgb")
    words = ["render", out, "--backend", backend, "--spp", "2", "--passes", passes,
             "--cluster", dask.file]  # fmt: skip
    return subprocess.Popen(
        [sys.executable, "-m", "scenec.cli.main", *map(str, words)],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )


def victim_of(
    kind: str, dask: DaskProcesses, client: subprocess.Popen[bytes], chance: random.Random
) -> Any:
    """A process of a kind; where no unit is being run, the dask worker that would run one."""
    if kind == "scheduler":
        return dask.scheduler
    if kind == "command":
        return client
    units = dask.units() if kind == "unit's process" else []
    return chance.choice(units or dask.workers)


def check(out: Path, calm: dict[str, str], *, whole: bool) -> int:
    """How many frames are there, each as it should be."""
    found = annotation(out)
    wrong = [name for name, digest in found.items() if calm[name] != digest]
    if wrong or (whole and found.keys() != calm.keys()):
        raise SystemExit(f"{out}: differ: {wrong}; missing: {sorted(calm.keys() - found.keys())}")
    return len(found)


def disturbed(
    stage: Path, folder: Path, calm: dict[str, str], backend: str, kind: str, chance: random.Random
) -> list[str]:
    """One run; a row of the table."""
    out = shutil.copytree(stage, folder / "out")
    when = chance.randrange(len(calm))
    starts = 1
    with dask_processes(folder / "dask", 2) as dask:
        client = start(out, dask, backend)
        while client.poll() is None and len(list(out.glob(FRAMES))) < when:
            time.sleep(0.002)
        units = dask.units()
        victim_of(kind, dask, client, chance).kill()
        status = client.wait()
        made = check(out, calm, whole=False)
        while status != 0 and dask.scheduler.poll() is None:
            starts += 1
            status = start(out, dask, backend).wait()
        units += dask.units()
    if status != 0:
        with dask_processes(folder / "again", 2) as dask:
            starts += 1
            status = start(out, dask, backend).wait()
            units += dask.units()
    for unit in units:
        until_gone(unit.pid)
    check(out, calm, whole=True)
    left = [path.name for path in out.rglob(".scenec-*")]
    if status or left:
        raise SystemExit(f"{out}: status {status}, left: {left}")
    return [kind, str(when), str(made), str(starts)]


def main(study: Study) -> None:
    """Prints a row a run."""
    options = study.options
    chance = random.Random(options.seed)
    stage = compiled(study.scratch, SAMPLES, (96, 72))
    undisturbed = shutil.copytree(stage, study.scratch / "calm")
    with dask_processes(study.scratch / "dask", 1) as dask:
        if start(undisturbed, dask, options.backend).wait() != 0:
            raise ScenecError("the undisturbed run failed")
    calm = annotation(undisturbed)

    def rows() -> Iterator[list[str]]:
        for number in range(2 if study.fast else options.runs):
            place = study.scratch / str(number)
            kind = KINDS[number % len(KINDS)]
            yield disturbed(stage, place, calm, options.backend, kind, chance)
            shutil.rmtree(place)

    study.table(["killed", "after frames", "there then", "commands until all were there"], rows())
    study.say(f"each of {len(calm)} frames, {options.backend}: all there, annotation equal")


if __name__ == "__main__":
    run(main, runs=20, backend="pyrender", seed=1)
