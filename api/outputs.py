"""Outputs: folders of stages and frames, which show themselves in a notebook."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from scenec.api.declare import Spread, held_to_types, require
from scenec.api.options import RenderOptions
from scenec.api.steps import render_output
from scenec.schemas.codec import UNSET
from scenec.schemas.errors import FrameError
from scenec.schemas.manifest import STAGE_SUFFIXES, find_batches, read_manifest

if TYPE_CHECKING:
    from scenec.api.shown import FrameView, StageView
    from scenec.backends.run.render import RenderReport
    from scenec.backends.run.scan import ScanReport
    from scenec.compiler.compile import CompileReport


@dataclass(frozen=True)
class OutputFolder:
    """An output folder, or a USD file with frames beside it.

    Attributes:
        path: Where it is.
        compiled, rendered, scanned: What the call that returned it did; None: no such thing.

    Raises:
        OutputError: It is none.
    """

    path: Path | str
    compiled: CompileReport | None = None
    rendered: RenderReport | None = None
    scanned: ScanReport | None = None

    def __post_init__(self) -> None:
        require("path", self.path, "Path | str")
        object.__setattr__(self, "path", Path(self.path))
        if self._is_folder:
            read_manifest(Path(self.path))

    @property
    def _is_folder(self) -> bool:
        return Path(self.path).suffix.lower() not in STAGE_SUFFIXES

    @property
    def stages(self) -> list[StageView]:
        """The stage of each batch."""
        from scenec.api.shown import StageView

        return [StageView(batch) for batch in find_batches(Path(self.path))]

    def render(self, backend: str = RenderOptions.backend, **options: Any) -> OutputFolder:
        """Render what is not rendered yet, as ``scenec.render`` does; returns the output.

        Args:
            backend: Name of a backend; ``annotation`` makes all but pictures.
            options: Of ``scenec.render``: ``spp``, ``passes``, …

        Raises:
            StageError, BackendError, OutputError: As of ``scenec.render``.
        """
        return replace(self, rendered=_rendered(self.path, backend=backend, **options))

    def frames(self, backend: str | None = None) -> list[FrameView]:
        """Frames that are there; as of ``open_frames``."""
        return open_frames(self.path, backend)

    def _repr_html_(self) -> str:
        import numpy as np
        from PIL import Image

        from scenec.api.shown import picture_html, table_html
        from scenec.datasets.sheet import write_sheet
        from scenec.schemas.scratch import scratch_folder

        rows: dict[str, object] = {"output": str(self.path)}
        if self._is_folder:
            manifest = read_manifest(Path(self.path))
            rows |= {
                "cfg": manifest.name or "",
                "seed": "" if manifest.seed is UNSET else manifest.seed,
                "batches": len(manifest.batches),
                "made by": f"scenec {manifest.scenec or ''}",
            }
        try:
            with scratch_folder() as folder:
                sheet = write_sheet(Path(self.path), Path(folder) / "sheet.png", count=3)
                with Image.open(sheet.path) as picture:
                    shown = picture_html(np.asarray(picture.convert("RGB")), picture.width)
        except FrameError:
            shown = "".join(stage._repr_html_() for stage in self.stages[:3])
        return table_html(rows) + shown


@Spread(RenderOptions).one
def _rendered(out: Path | str, options: RenderOptions) -> RenderReport:
    return render_output(out, options)


@held_to_types
def open_frames(out: Path | str, backend: str | None = None) -> list[FrameView]:
    """Frames of an output that are there, by batch, camera and sample.

    Args:
        out: Output folder, or a USD file that was rendered.
        backend: Whose; None takes the first that there is.

    Raises:
        FrameError: There are none.
    """
    from scenec.api.shown import FrameView
    from scenec.datasets.source import Source

    source = Source(Path(out), backend)
    return [FrameView(source, ref) for ref in source.frames]
