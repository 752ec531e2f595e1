"""``--workers auto``: how many processes render, from cores, memory and the GPU."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Collection
from dataclasses import dataclass

from scenec.backends.run.memory import SHARE, default_limit
from scenec.schemas.budget import thread_budget, usable_cores
from scenec.schemas.errors import BackendError, PluginError
from scenec.schemas.memory import GB
from scenec.schemas.passes import ANNOTATION_NAMES

#: Cores that one process keeps busy: where it casts annotation alone, and where it draws, too.
CORES_ANNOTATING, CORES_DRAWING = 2, 8
#: Bytes that one holds of the machine, and of a GPU that draws the demo (docs/backends.md).
HOST, OF_GPU = int(1.0 * GB), int(2.8 * GB)
#: Devices that are no GPU.
_NO_GPU = ("cpu", "auto")


@dataclass(frozen=True)
class Machine:
    """Describes what workers share.

    Attributes:
        cores: That they may use.
        memory: Bytes that they may hold together.
        gpu: Free bytes of its GPU, the fullest of several; None: it has none, or that is not known.
    """

    cores: int
    memory: int
    gpu: int | None = None


def choose_workers(
    machine: Machine, *, draws: bool, on_gpu: bool = False, each: int = HOST
) -> tuple[int, str]:
    """Chooses how many processes render; returns that, and why, in words.

    On a GPU one a core: it is idle for most of a frame, of which the cores do the rest. A renderer
    on the CPU fills several by itself, and the cast of annotation alone two.

    Args:
        machine: What they share.
        draws: Whether pictures are drawn; else annotation alone is made.
        on_gpu: Whether a GPU draws them.
        each: Bytes of the machine that each may need.
    """
    if not draws:
        found = machine.cores // CORES_ANNOTATING, f"one for {CORES_ANNOTATING} cores annotates"
    elif on_gpu:
        found = machine.cores, "one a core, beside a GPU"
    else:
        found = machine.cores // CORES_DRAWING, f"one for {CORES_DRAWING} cores draws"
    choices = [found]
    together = f"{machine.memory / GB:.2g} GB that they may hold together"
    choices.append((machine.memory // each, f"each may need {each / GB:.2g} GB of the {together}"))
    if draws and on_gpu:
        if machine.gpu is None:
            choices.append((1, "how much memory its GPU has is not known"))
        else:
            free = f"{machine.gpu / GB:.2g} GB that are free"
            why = f"each needs {OF_GPU / GB:.2g} GB of the GPU's {free}"
            choices.append((int(SHARE * machine.gpu) // OF_GPU, why))
    # The first of equals.
    count, why = min(choices, key=lambda choice: choice[0])
    return max(1, count), why


def this_machine() -> Machine:
    """Returns what workers of this machine share."""
    cores = thread_budget() or usable_cores()
    return Machine(cores, default_limit(), _free_of_gpu())


def workers_for(
    machine: Machine, backend: str, device: str, passes: Collection[str] | None, each: int | None
) -> tuple[int, str]:
    """Chooses as ``choose_workers`` does, by what is asked; starts no renderer.

    Args:
        machine: What they share.
        backend, device, passes: As of ``RenderPlan``.
        each: Bytes that each worker may hold; None: not said.
    """
    draws = backend not in ANNOTATION_NAMES and (passes is None or "rgb" in passes)
    on_gpu = draws and device not in _NO_GPU
    if draws and device == "auto" and machine.gpu is not None:
        on_gpu = _has_gpu_device(backend)
    return choose_workers(machine, draws=draws, on_gpu=on_gpu, each=max(HOST, each or 0))


def _has_gpu_device(backend: str) -> bool:
    # Imported here: few machines have one, and who asks may start a worker before it imports NumPy.
    from scenec.backends.registry import AUTO, backend_class

    if backend == AUTO:
        return True
    try:
        return bool(set(backend_class(backend).devices) - set(_NO_GPU))
    except (BackendError, PluginError):
        # Who renders says what is wrong with it.
        return False


def _free_of_gpu() -> int | None:
    """Free bytes of the fullest GPU, by NVIDIA's driver; None where there is none."""
    tool = shutil.which("nvidia-smi")
    if tool is None:
        return None
    words = [tool, "--query-gpu=memory.free", "--format=csv,noheader,nounits"]
    try:
        said = subprocess.run(words, capture_output=True, text=True, check=False, timeout=10.0)
    except (OSError, subprocess.TimeoutExpired):
        return None
    # What a GPU does not tell it calls so: "[N/A]".
    found = [int(line) << 20 for line in said.stdout.split() if line.isdigit()]
    return min(found, default=None)
