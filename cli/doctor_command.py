"""``scenec doctor``."""

from __future__ import annotations

import argparse
from dataclasses import asdict

from scenec.api.text import table
from scenec.backends.run.doctor import diagnose, library_versions
from scenec.cli.output import print_json, say_next
from scenec.schemas.plugins import installed


def run(options: argparse.Namespace) -> int:
    """Prints what works here; 1 if a backend does not."""
    found = diagnose()
    libraries = library_versions()
    plugins = installed()
    if options.json:
        backends = [asdict(d) for d in found]
        print_json({"backends": backends, "libraries": libraries, "plugins": plugins})
    else:
        rows = [
            [d.name, "works" if d.works else "does not work", d.device or "-", d.version or "-"]
            for d in found
        ]
        print(table(rows, ["backend", "here", "device", "version"]))
        for d in found:
            if d.message:
                print(f"{d.name}: {d.message}")
        print("libraries: " + ", ".join(f"{name} {v}" for name, v in libraries.items()))
        for package, names in plugins.items():
            print(f"plug-in {package}: {', '.join(names)}")
        say_next(("init", "mars"))
    return 0 if all(d.works for d in found) else 1
