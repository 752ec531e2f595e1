"""One HTML page to look at all frames of an output."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from pathlib import Path

from scenec.api.declare import Spread
from scenec.api.listener import Listener
from scenec.api.options import ViewOptions
from scenec.api.site import site_of
from scenec.backends.run.executors import make_executor
from scenec.datasets.outputs import find_outputs
from scenec.datasets.view.ground import Ground
from scenec.datasets.view.page import ViewReport, write_view
from scenec.datasets.view.space import three
from scenec.schemas.budget import usable_cores
from scenec.schemas.errors import OutputError, ScenecError
from scenec.schemas.manifest import Batch

#: Cells along the longer side of a batch's ground; the page keeps fewer where many batches are.
_CELLS = 512
#: Cells of all batches together that are looked at for what the ground is to a vehicle, and along
#: the longer side of one at least and at most: 0.8 CPU s a million, at a yardstick of 0.57.
_SITE_CELLS, _SITE_LEAST, _SITE_MOST = 4_000_000, 256, 1000
#: Bytes of all batches in three dimensions at most, and the part of the page's budget.
_SPACE_BYTES = 8_000_000
_SPACE_PART = 0.3
#: Of these the library takes so many; a batch with fewer is not worth looking at.
_LIBRARY_BYTES = 650_000
_LEAST_SPACE_BYTES = 400_000
#: Stored bytes of a triangle of the ground, of one of a prototype, of an instance.
_GROUND_BYTES, _OBJECT_BYTES, _INSTANCE_BYTES = 18, 12, 36


@Spread(ViewOptions).one
def view(out: Path | str, options: ViewOptions) -> ViewReport:
    """Writes one page to look at all frames, in any browser, offline.

    Args:
        out: Output folder with frames, a whole sweep of such, or a USD file.
        options: As fields of ``ViewOptions``.

    Raises:
        OutputError: The page cannot be written, or is no HTML file.
        FrameError: There are no frames, or with ``faults="stop"`` one is damaged.
    """
    return write_page(Path(out), options)


def page_of(out: Path, options: ViewOptions) -> Path:
    """Returns the path of the page.

    Raises:
        OutputError: It is no HTML file.
    """
    page = Path(options.page or (out if out.is_dir() else out.parent) / "view.html")
    if page.suffix.lower() not in (".html", ".htm"):
        raise OutputError(f"{page}: the view is an HTML page; end its name in .html")
    return page


def write_page(out: Path, options: ViewOptions, watched: str = "") -> ViewReport:
    """Writes the page as ``view`` does.

    Args:
        out: Output folder with frames, or a USD file.
        options: What is shown.
        watched: The state of a watched output, which the page loads itself again at.
    """
    page, listener, ground = page_of(out, options), options.listener, None
    if not options.no_ground:
        rooms = rooms_of(out, options.budget_mb, listener)
        each = _SITE_CELLS / max(1, len(find_outputs(out).find()))
        cells = int(min(_SITE_MOST, max(_SITE_LEAST, each**0.5)))
        ground = partial(ground_of, rooms=rooms, cells=cells, listener=listener)
    workers = options.workers or usable_cores()
    with make_executor(workers if workers > 1 else 0) as executor:
        return write_view(
            out,
            page,
            backends=options.backend,
            budget_mb=options.budget_mb,
            faults=options.faults,
            ground=ground,
            watched=watched,
            executor=executor,
            progress=listener.steps("frame"),
            warn=listener.warn,
        )


def rooms_of(out: Path, budget_mb: float, listener: Listener) -> dict[int, int]:
    """Bytes that batches may take in three dimensions, by their index; without the others."""
    if three() is None:
        listener.say("no 3D view: three.js comes with trimesh (pip install 'scenec[meshes]')")
        return {}
    batches = [batch.index for batch in find_outputs(out).find()]
    room = min(_SPACE_BYTES, _SPACE_PART * 1e6 * budget_mb) - _LIBRARY_BYTES
    shown = batches[: max(0, int(room / _LEAST_SPACE_BYTES))]
    if len(shown) < len(batches):
        listener.say(
            f"3D view: of the first {len(shown)} of {len(batches)} batches, which fill its room"
        )
    return {index: int(room / len(shown)) for index in shown}


def ground_of(
    batch: Batch, rooms: Mapping[int, int], cells: int, listener: Listener
) -> Ground | None:
    """A batch from above, and in three dimensions; None where its stage cannot be read.

    Args:
        batch: Of an output.
        rooms: Bytes that three dimensions may take, by the batch's index; others are without.
        cells: As of ``site_of``.
        listener: Hears why there is none.
    """
    # Reading stages costs USD and numba: only where it is done.
    from scenec.backends.model.collect import coarse_model
    from scenec.backends.stage.ground import relief_of
    from scenec.backends.stage.read import read_stage

    try:
        scene = read_stage(batch.stage)
        relief, site, model = relief_of(scene, _CELLS), site_of(scene, cells), None
        if room := rooms.get(batch.index):
            model = coarse_model(
                scene,
                batch.name,
                ground_faces=int(0.4 * room / _GROUND_BYTES),
                object_faces=int(0.2 * room / _OBJECT_BYTES),
                instances=int(0.4 * room / _INSTANCE_BYTES),
            )
    except ScenecError as error:
        listener.warn(f"no map of {batch.name}: {error}")
        return None
    return Ground(relief.corner, relief.step, relief.heights, relief.suns, model, site)
