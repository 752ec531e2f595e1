"""``scenec validate``."""

from __future__ import annotations

import argparse

from scenec.cli.output import print_json, say_next, warn


def run(options: argparse.Namespace) -> int:
    """Reads a cfg, with all its checks, and says what it asks for.

    Raises:
        CfgError: It has faults; all of them are said.
    """
    # Here: NumPy takes a tenth of a second, and ``--help`` needs none.
    from scenec.compiler.cfg.load import load

    spec = warn(load(options.cfg, options.settings))
    cfg = spec.cfg
    sensors = sum(len(rig.get("sensors", {})) for rig in cfg["rigs"].values())
    counts = {
        "batches": cfg["batches"],
        "samples": cfg["samples"],
        "cameras": sensors,
        "lidars": sum(len(rig.get("lidars", {})) for rig in cfg["rigs"].values()),
    }
    if options.json:
        warnings = [str(warning) for warning in spec.warnings]
        print_json({"cfg": options.cfg, "name": cfg["name"], **counts, "warnings": warnings})
    else:
        parts = ", ".join(f"{what} {count:,}" for what, count in counts.items())
        print(f"{options.cfg}: {cfg['name']}: no fault found ({parts})")
        say_next(("run -o OUT", options.cfg))
    return 0
