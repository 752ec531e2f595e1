"""Holds JSON values that were read from files against the shape that the code relies on.

A shape is written as the value looks: ``{"batches": [{"index": natural, "path": str}]}``.

=================  ================================================================================
``str``, ``bool``  of this type; ``int`` is no ``bool``, ``float`` any finite number
``dict``, ``list`` whatever is in them
``None``           null
``(a, b)``         one of these
``[a]``            a list of these, of any length
``[a, b]``         a list of just these
``Each(a)``        an object with any keys and such values
``{"k": a}``       an object with at least these keys; one spelled ``"k?"`` may be missing, one
                   spelled ``"k?other"`` where ``other`` is missing, too
a function         called with the value: None, or what was expected instead
=================  ================================================================================
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from scenec.schemas.codec import NAMES, escaped, is_number, told
from scenec.schemas.codec import natural as natural
from scenec.schemas.errors import ScenecError
from scenec.schemas.files import read_json
from scenec.schemas.spelling import closest, shown


@dataclass(frozen=True)
class Each:
    """Of an object with any keys: what its values are."""

    shape: Any


def read_shaped(path: Path, shape: Any, error: type[ScenecError], what: str) -> Any:
    """The JSON value in a file, of a shape.

    Args:
        path: The file.
        shape: See the module.
        error: What is raised.
        what: What the file should be, for messages.

    Raises:
        FileNotFoundError: It is not there.
        ScenecError: It cannot be read, or is of another shape; the message has the JSON pointer.
    """
    value = read_json(path, error, what)
    require_shape(value, shape, error, f"{path}: is no {what}")
    return value


def require_shape(value: Any, shape: Any, error: type[ScenecError], where: str) -> None:
    """Raises ``error`` where a value is of another shape, with ``where`` before the pointer."""
    fault = _fault(value, shape, "")
    if fault is not None:
        raise error(f"{where}: {fault}")


def _fault(value: Any, shape: Any, at: str) -> str | None:
    """The first thing wrong, with its JSON pointer (RFC 6901)."""
    if isinstance(shape, tuple):
        faults = [_fault(value, one, at) for one in shape]
        # The last alternative is the usual one: null and the like come first.
        return None if None in faults else faults[-1]
    if isinstance(shape, dict) and isinstance(value, dict):
        return _fault_of_keys(value, shape, at)
    if isinstance(shape, Each) and isinstance(value, dict):
        inner = ((f"{at}/{escaped(key)}", value[key], shape.shape) for key in value)
    elif isinstance(shape, list) and isinstance(value, list):
        if len(shape) > 1 and len(value) != len(shape):
            return f"{at or '/'}: expected {len(shape)} values, not {len(value)}"
        shapes = shape if len(shape) > 1 else shape * len(value)
        inner = ((f"{at}/{i}", value[i], one) for i, one in enumerate(shapes))
    else:
        expected = _expected(value, shape)
        return expected and f"{at or '/'}: expected {expected}, not {told(value)}"
    return next((fault for place, v, s in inner if (fault := _fault(v, s, place))), None)


def _fault_of_keys(value: dict[str, Any], shape: dict[str, Any], at: str) -> str | None:
    known = {spelled.partition("?")[0] for spelled in shape}
    for spelled, one in shape.items():
        key, may, other = spelled.partition("?")
        if key in value:
            fault = _fault(value[key], one, f"{at}/{escaped(key)}")
            if fault:
                return fault
        elif not may or (other and other in value):
            others = [name for name in value if name not in known]
            guess = closest(key, others)
            told = "" if guess is None else f"; is it {shown(guess)}?"
            return f"{at or '/'}: the key {shown(key)} is missing{told}"
    return None


def _expected(value: Any, shape: Any) -> str | None:
    """What was expected of a value that is no list or object, or of another kind than its shape."""
    if shape is None:
        return None if value is None else "null"
    if isinstance(shape, dict | Each):
        return NAMES[dict]
    if isinstance(shape, list):
        return NAMES[list]
    if not isinstance(shape, type):
        expected: str | None = shape(value)
        return expected
    fine = is_number(value) if shape is float else type(value) is shape
    return None if fine else NAMES[shape]
