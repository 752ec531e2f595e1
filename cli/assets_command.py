"""``scenec assets``."""

from __future__ import annotations

import argparse
import json

from scenec.api.text import table
from scenec.cli.output import print_json
from scenec.compiler.assets.library import Asset, shipped, snippet
from scenec.schemas.codec import Facts
from scenec.schemas.errors import ScenecError
from scenec.schemas.presets import PRESETS, SOURCES
from scenec.schemas.spelling import nearest

#: Of a line of the cfg that is shown.
_WIDTH = 90


def run(options: argparse.Namespace) -> int:
    """Lists the models, or the cameras, or says all of one."""
    assets = shipped()
    if options.cameras:
        return _cameras(options.json)
    if options.name in PRESETS:
        return _camera(options.name, options.json)
    if options.name is None:
        if options.json:
            print_json([_as_json(asset) for asset in assets.values()])
            return 0
        rows = [[a.name, _size(a), f"{a.triangles:,}", a.label] for a in assets.values()]
        lines = table(rows, ["name", "x × y × z, m", "triangles", "label"]).splitlines()
        for line, about in zip(lines, ("", "", *(a.about for a in assets.values())), strict=True):
            print(f"{line}  {about}".rstrip())
        print(
            "\n'scenec assets NAME' shows parts and the lines for a cfg; --cameras lists cameras."
        )
        return 0
    asset = assets.get(options.name.removesuffix(".glb"))
    if asset is None:
        raise ScenecError(f"no asset {options.name!r}{nearest(options.name, [*assets, *PRESETS])}")
    lines_of_cfg = snippet(asset, assets)
    if options.json:
        print_json({**_as_json(asset), "cfg": lines_of_cfg})
        return 0
    print(f"{asset.name}: {asset.about}")
    print(f"size {_size(asset)} m (x, y, z); {asset.bytes:,} bytes; {asset.license}")
    parts = [[name, f"{n:,}", asset.materials[name]] for name, n in asset.parts.items()]
    print(f"\n{table(parts, ['part', 'triangles', 'material'])}\n")
    print(_indented(lines_of_cfg))
    return 0


def _cameras(as_json: bool) -> int:
    """Lists the presets of cameras."""
    if as_json:
        print_json([_preset(name) for name in PRESETS])
        return 0
    rows = [
        [name, " × ".join(map(str, p.keys["resolution"])), p.title] for name, p in PRESETS.items()
    ]
    print(table(rows, ["preset", "pixels", "camera"]))
    print("\n'scenec assets PRESET' shows its keys and their sources.")
    return 0


def _camera(name: str, as_json: bool) -> int:
    """Says all of a preset: the keys that it stands for, and where their numbers are from."""
    if as_json:
        print_json(_preset(name))
        return 0
    print(f"{PRESETS[name].title}\n\n{_indented(PRESETS[name].keys)}\n")
    print("\n".join(f"source: {SOURCES[source]}" for source in PRESETS[name].sources))
    return 0


def _preset(name: str) -> Facts:
    preset = PRESETS[name]
    sources = [SOURCES[source] for source in preset.sources]
    return {"preset": name, "title": preset.title, "keys": preset.keys, "sources": sources}


def _as_json(asset: Asset) -> Facts:
    size = [round(extent, 3) for extent in asset.size_m]
    return {**asset._asdict(), "size_m": size, "triangles": asset.triangles}


def _indented(value: Facts, depth: int = 0) -> str:
    """JSON that a person reads: one line for what fits into one."""
    line = json.dumps(value)
    if len(line) + 2 * depth <= _WIDTH and depth > 1:
        return line
    inner = "  " * (depth + 1)
    rows = [
        f"{inner}{json.dumps(key)}: "
        + (_indented(item, depth + 1) if isinstance(item, dict) else json.dumps(item))
        for key, item in value.items()
    ]
    return "{\n" + ",\n".join(rows) + "\n" + "  " * depth + "}"


def _size(asset: Asset) -> str:
    return " × ".join(f"{extent:.2f}" for extent in asset.size_m)
