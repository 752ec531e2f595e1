"""All there is to say of an output: what it keeps, leaves out, what each pass cost and erred."""

from __future__ import annotations

import html
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from scenec.api.declare import held_to_types
from scenec.api.explain.data import BatchData, read_batches
from scenec.api.explain.left_out import as_json, left_out_of, left_out_text, parts_of, rates_of
from scenec.api.explain.passes import frames_text, passes_text, rows_of
from scenec.api.explain.stage import StageContents, read_contents
from scenec.schemas.codec import Facts
from scenec.schemas.errors import OutputError
from scenec.schemas.files import read_json
from scenec.schemas.manifest import REPORT

#: Columns of a text, where nobody says otherwise.
WIDTH = 100


@dataclass(frozen=True)
class BatchExplanation:
    """Explains one batch.

    Attributes:
        data: The batch.
    """

    data: BatchData

    @cached_property
    def _contents(self) -> StageContents:
        return read_contents(self.data.stage)

    def text(self, width: int = WIDTH) -> str:
        """For people.

        Args:
            width: Columns that lines may have.

        Raises:
            StageError: Its stage cannot be read.
        """
        batch, contents = self.data, self._contents
        rates = rates_of(batch, contents)
        left = left_out_of(batch.report, rates)
        parts = [
            f"{batch.name}: {parts_of(batch.report, contents, left).text}",
            left_out_text(left, rates, width),
            passes_text(rows_of(batch.report, batch.seconds), width),
            frames_text(batch.frames) if batch.frames else "",
        ]
        return "\n\n".join(part for part in parts if part)

    def as_json(self) -> Facts:
        """Returns what is in the stage and what is left out, for scripts."""
        left = left_out_of(self.data.report, rates_of(self.data, self._contents))
        kept = vars(parts_of(self.data.report, self._contents, left))
        return {
            "kept": {name: {"kept": part, "of": whole} for name, (part, whole) in kept.items()},
            "left_out": as_json(left),
        }


@dataclass(frozen=True)
class Explanation:
    """Explains an output; prints and shows itself as text.

    Attributes:
        batches: Of each batch that was asked for.
    """

    batches: tuple[BatchExplanation, ...]

    def text(self, width: int = WIDTH) -> str:
        """For people; see ``BatchExplanation.text``."""
        return "\n\n".join(batch.text(width) for batch in self.batches)

    def as_json(self) -> Facts:
        """For scripts."""
        data = [one.data for one in self.batches]
        return {
            "reports": {
                one.name: read_json(one.folder / REPORT, OutputError, "report") for one in data
            },
            "seconds": {batch.name: batch.seconds for batch in data if batch.seconds},
            "batches": {one.data.name: one.as_json() for one in self.batches},
        }

    def __str__(self) -> str:
        return self.text()

    def _repr_html_(self) -> str:
        return f"<pre>{html.escape(self.text())}</pre>"


@held_to_types
def explain(out: Path | str, batch: int | None = None) -> Explanation:
    """Explains each pass's time and error, what was left out, and what that spared.

    Args:
        out: Output folder of a compile.
        batch: Only this batch; None takes all.

    Raises:
        OutputError: There is no manifest, or a file is damaged.
        StageError: There is no such batch.
    """
    batches = read_batches(Path(out), None if batch is None else [batch])
    return Explanation(tuple(map(BatchExplanation, batches)))
