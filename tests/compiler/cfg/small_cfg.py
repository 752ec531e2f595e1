"""A small cfg that the tests of this folder change."""

from __future__ import annotations

import copy
import json
from pathlib import Path
from typing import Any

from scenec.compiler.cfg.load import Spec, load
from scenec.schemas.errors import CfgError, Fault

_MINIMAL: dict[str, Any] = {
    "version": 1,
    "name": "plain",
    "labels": {"class": {"ground": 1, "rock": 2, "sky": 3}},
    "terrain": {
        "size_m": [20, 10],
        "spacing_m": 0.5,
        "relief": [{"type": "plane"}],
        "ground": [{"material": "sand", "labels": {"class": "ground"}}],
    },
    "materials": {
        "sand": {"base_color": [0.4, 0.3, 0.2]},
        "basalt": {"base_color": [0.1, 0.1, 0.1]},
    },
    "objects": {
        "rocks": {
            "type": "rocks",
            "count": 10,
            "material": "basalt",
            "labels": {"class": "rock"},
            "size_m": 0.3,
        }
    },
    "light": {"sky": {"type": "clear", "labels": {"class": "sky"}}},
    "rigs": {
        "rover": {
            "pose": {
                "type": "random_target",
                "position": {"x_m": 0, "y_m": 0, "height_m": 1.5},
                "target": {"distance_m": 5},
            },
            "sensors": {"front": {"resolution": [64, 48], "fov_deg": 60}},
        }
    },
}

DELETE = object()


def minimal() -> dict[str, Any]:
    """A fresh copy of a cfg without faults."""
    return copy.deepcopy(_MINIMAL)


def changed(changes: dict[str, Any]) -> dict[str, Any]:
    """The cfg with values put at (or, with DELETE, taken from) pointers such as "/light/sun"."""
    cfg = minimal()
    for pointer, value in changes.items():
        *parents, last = pointer.removeprefix("/").split("/")
        owner: Any = cfg
        for key in parents:
            owner = owner[int(key)] if isinstance(owner, list) else owner.setdefault(key, {})
        if isinstance(owner, list):
            if int(last) == len(owner):
                owner.append(value)
            else:
                owner[int(last)] = value
        elif value is DELETE:
            del owner[last]
        else:
            owner[last] = value
    return cfg


def load_cfg(cfg: Any, folder: Path) -> Spec:
    """Loads a cfg by way of a file in ``folder``."""
    file = folder / "cfg.json"
    file.write_text(json.dumps(cfg, indent=2, ensure_ascii=False), encoding="utf-8")
    return load(file)


def faults_of(cfg: Any, folder: Path) -> tuple[Fault, ...]:
    """The faults of a cfg; () where it has none."""
    try:
        load_cfg(cfg, folder)
    except CfgError as error:
        return error.faults
    return ()
