"""``--backend auto``: the first renderer of an order of preference that works here."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import median
from typing import Any

from scenec.backends.registry import backend_names
from scenec.backends.run.jobs import Wanted
from scenec.backends.run.supervise import WorkerProcess
from scenec.schemas.errors import BackendError

#: What ``scenec converge`` measured, in the output folder.
MEASURED = Path("converge", "converge.json")

Say = Callable[[str], None]


@dataclass(frozen=True)
class Choice:
    """A backend, and why it.

    Attributes:
        backend: Name.
        order: Names in the order of preference, and what that stands on.
        left_out: Those before it that do not work here for what is asked, and why.
    """

    backend: str
    order: str
    left_out: dict[str, str]

    def as_json(self) -> dict[str, Any]:
        """As sidecars and ``--json`` hold it."""
        return asdict(self)


def choose(out: Path | None, wanted: Wanted, say: Say = lambda _line: None) -> Choice:
    """Choose the backend that is to render, and say why.

    Where ``scenec converge`` has measured the output, renderers with less variance times seconds
    come first (their efficiency, as Veach 1997 defines it); else, and after these, those of
    ``backend_names`` in turn.

    Args:
        out: Output folder; None: there is none yet.
        wanted: What is to be rendered; its ``backend`` does not count.
        say: Told the reasons.

    Raises:
        BackendError: No renderer works here for what is asked.
    """
    costs = {} if out is None else _costs(out / MEASURED)
    names = sorted(backend_names(), key=lambda name: costs.get(name, math.inf))
    order = ", ".join(names) + (f" (variance times seconds, {MEASURED})" if costs else "")
    left_out: dict[str, str] = {}
    for name in names:
        request = {"op": "describe", "backend": name, "device": wanted.device, "rgb": True}
        try:
            with WorkerProcess() as worker:
                found = worker.ask(request, f"backend {name}")
            if wanted.denoise and found["denoiser"] is None:
                raise BackendError("it has no denoiser")
        except BackendError as error:
            left_out[name] = str(error)
            say(f"auto: {name} is left out: {error}")
            continue
        say(f"auto: {name} renders: the first that works of {order}")
        return Choice(name, order, left_out)
    reasons = "; ".join(f"{name}: {why}" for name, why in left_out.items())
    raise BackendError(f"no backend works here for what is asked: {reasons}")


def _costs(file: Path) -> dict[str, float]:
    """Variance times seconds of each backend with noise that was measured; none without a file."""
    try:
        series = json.loads(file.read_text(encoding="utf-8"))["series"]
        return {
            str(one["backend"]): median(s["seconds"] * s["mean"] ** 2 for s in one["steps"])
            for one in series
            if one["own"] and one["stochastic"] and not one["denoised"]
        }
    except (OSError, ValueError, KeyError, TypeError):
        # Not measured, or not to be told from the noise of its own reference.
        return {}
