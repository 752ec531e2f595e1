"""Settled poses as the CSV file that a class of placed objects takes."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

from scenec.compiler.assets.pose_table import COLUMNS
from scenec.schemas.files import atomic
from scenec.settle.bodies import Body


def write_poses(file: Path, bodies: Sequence[Body], comments: Sequence[str]) -> None:
    """Writes poses with heights in the world, in order of ids, to the last digit.

    Args:
        file: The CSV file; replaced when it is complete.
        bodies: Objects of one class.
        comments: Lines above the header.

    Raises:
        OutputError: It cannot be written.
    """
    columns = [name for name in COLUMNS if name != "time_s"]
    # One cell each, which begins with a #: what stands behind a comma could be a formula.
    lines = [f"# {' '.join(re.split(r'[\s,;]+', text.strip()))}" for text in comments]
    lines.append(",".join(columns))
    for body in sorted(bodies, key=lambda body: body.id):
        numbers = [*body.position.tolist(), *body.quaternion.tolist(), body.scale]
        lines.append(",".join([str(body.id), *(repr(float(v)) for v in numbers), str(body.model)]))
    with atomic(file) as temporary:
        temporary.write_text("\n".join(lines) + "\n", encoding="utf-8")
