"""Draws cfgs from the schemas: each has its faults told, or compiles and is annotated.

    python lab/robustness/cfgs.py [--cfgs N] [--compile K] [--seed S] [--keep FOLDER] [--fast]

A cfg is one of the tests' or of the templates, with one to four things changed as the schemas allow
(or just beyond): numbers at their bounds and over twelve decades, other words of an enumeration,
optional keys added by their examples or taken away, entries doubled, dropped and exchanged. All are
read; of those without faults every K-th is compiled and its first picture annotated, in a process
of its own. It is a fault if that ends in a traceback, dies, or takes 20 s of the processor or
2 GiB.
"""

from __future__ import annotations

import copy
import gc
import json
import math
import shutil
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from scenec.compiler.cfg.load import load
from scenec.compiler.cfg.sources import read
from scenec.compiler.kinds.schema import Field, root, walk
from scenec.lab.runner import CONFIGS, Page, run
from scenec.schemas.errors import CfgError
from scenec.testing.mutants import Outcome, tried
from scenec.testing.small import small_cfg

#: Objects, but for those that a density makes: what is asked for beyond takes as long as it takes.
MOST = 100_000
Rng = np.random.Generator


def bases() -> list[dict[str, Any]]:
    """Cfgs that are small: of a template, ground and objects are made few."""
    found = [small_cfg(), small_cfg(samples=3, batches=2), *map(_behind, ("clear", "overcast"))]
    for file in sorted((CONFIGS / "templates").glob("*.jsonc")):
        cfg: dict[str, Any] = copy.deepcopy(read(file).document.value)
        cfg["terrain"] |= {"spacing_m": 1.0}
        for objects in cfg.get("objects", {}).values():
            if isinstance(objects.get("count"), int):
                objects["count"] = min(objects["count"], 40)
        found.append(cfg)
    return found


def _behind(sky: str) -> dict[str, Any]:
    """A cfg with land beyond its border, clouds or an overcast sky, and stones with dust."""
    cfg = small_cfg()
    relief = [{"type": "plane"}, {"type": "multifractal", "amplitude_m": 40, "scale_m": 300}]
    horizon = {"reach_m": 800, "relief": relief, "material": "sand", "labels": {"class": "ground"}}
    cfg["terrain"] |= {"spacing_m": 1.0, "horizon": horizon}
    coating = {"material": "sand", "tops": 0.7}
    cfg["objects"]["rocks"] |= {"count": 30, "family": "ventifact", "coatings": [coating]}
    cfg["light"]["sky"]["type"] = sky
    if sky == "clear":
        cfg["light"]["clouds"] = {"resolution": 32, "cumulus": {}, "cirrus": {}}
    return cfg


def changed(cfg: dict[str, Any], rng: Rng) -> dict[str, Any]:
    """A cfg with one to four changes."""
    cfg = copy.deepcopy(cfg)
    for _ in range(int(rng.integers(1, 5))):
        fields = [field for field in walk(root(cfg)) if field.path]
        field = fields[int(rng.integers(len(fields)))]
        owner: Any = cfg
        for key in field.path[:-1]:
            owner = owner[key]
        other = _other(field, rng)
        if field.path[-1] == "count" and isinstance(other, int | float):
            other = min(other, MOST)
        owner[field.path[-1]] = other
    return cfg


def _other(field: Field, rng: Rng) -> Any:
    keywords, value = field.keywords, field.value
    if keywords.get("enum"):
        return _choice(keywords["enum"], rng)
    if field.is_number or (isinstance(value, int | float) and not isinstance(value, bool)):
        return _number(keywords, value, rng)
    if isinstance(value, bool):
        return not value
    if isinstance(value, list):
        return _list(keywords, value, rng)
    if isinstance(value, dict):
        return _object(keywords, value, rng)
    if examples := keywords.get("examples"):
        return _choice(examples, rng)
    return _choice(["", "sand", "ground", "rover", "x" * 300, "é", value], rng)


def _choice(values: Any, rng: Rng) -> Any:
    return copy.deepcopy(values[int(rng.integers(len(values)))])


def _number(keywords: Any, value: Any, rng: Rng) -> Any:
    low = keywords.get("minimum", keywords.get("exclusiveMinimum", -1e9))
    high = keywords.get("maximum", keywords.get("exclusiveMaximum", 1e9))
    near = value if isinstance(value, int | float) and value else 1.0
    drawn = [
        low, high, low - 1, high + 1, 0, -near, near * 2,
        math.nextafter(low, math.inf), math.nextafter(high, -math.inf),
        near * 10.0 ** rng.uniform(-6, 6), near * 10.0 ** rng.uniform(-1, 1),
    ]  # fmt: skip
    chosen = _choice(drawn, rng)
    if keywords.get("type") == "integer" and abs(chosen) < 1e300:
        return int(chosen)
    if rng.random() < 0.15:
        return {"type": "uniform", "min": chosen, "max": chosen + abs(near)}
    return chosen


def _list(keywords: Any, value: list[Any], rng: Rng) -> list[Any]:
    value = list(value)
    at = int(rng.integers(len(value) + 1))
    match int(rng.integers(4)):
        case 0 if value:
            del value[at - 1]
        case 1 if value:
            value.insert(at, copy.deepcopy(_choice(value, rng)))
        case 2:
            rng.shuffle(value)
        case _:
            items = keywords.get("items", {})
            if examples := items.get("examples") or keywords.get("examples"):
                example = _choice(examples, rng)
                value[at:at] = example if isinstance(example, list) else [example]
    return value


def _object(keywords: Any, value: dict[str, Any], rng: Rng) -> dict[str, Any]:
    value = dict(value)
    offered = {
        key: schema
        for key, schema in keywords.get("properties", {}).items()
        if key not in value and isinstance(schema, dict)
    }
    spare = [key for key in value if key not in keywords.get("required", ())]
    if spare and rng.random() < 0.4:
        del value[_choice(spare, rng)]
    elif offered:
        key = _choice(list(offered), rng)
        value[key] = _example(offered[key], rng)
    elif examples := keywords.get("examples"):
        return dict(_choice(examples, rng))
    return value


def _example(schema: Any, rng: Rng) -> Any:
    for key in ("examples", "enum"):
        if schema.get(key):
            return _choice(schema[key], rng)
    if "default" in schema:
        return copy.deepcopy(schema["default"])
    kind = schema.get("type")
    plain = {"boolean": True, "array": [], "object": {}, "string": "sand"}
    return plain.get(kind, _number(schema, 1.0, rng)) if isinstance(kind, str) else 1.0


def compiled(file: Path, out: Path) -> Callable[[], None]:
    """Compiles a cfg's first batch, and annotates its first picture on a few pixels."""

    def read() -> None:
        from scenec.backends.annotation.annotate import annotate
        from scenec.backends.exact import ExactCaster
        from scenec.backends.stage.read import read_stage
        from scenec.compiler.compile import compile_cfg

        made = compile_cfg(file, seed=1, out=out, batches=range(1), cache=None).out
        scene = read_stage(made / "batch_0000" / "stage.usda")
        if scene.cameras and scene.cameras[0]:
            camera = scene.cameras[0][0]
            if camera.width * camera.height <= 640 * 480:
                annotate(scene, ExactCaster(scene), camera, ["depth", "instance"], 0)

    return read


def outcomes(page: Page, count: int, every: int) -> Iterator[tuple[Outcome | None, Path, bool]]:
    """Of each cfg: what compiling it came to (None: it was not), its file, and has it no faults."""
    rng, some, sound = np.random.default_rng(page.options.seed), bases(), 0
    file = page.scratch / "drawn.json"
    for _ in range(count):
        file.write_text(json.dumps(changed(_choice(some, rng), rng), indent=1), encoding="utf-8")
        try:
            load(file)
        except CfgError:
            yield None, file, False
            continue
        sound += 1
        if sound % every:
            yield None, file, True
            continue
        yield tried(compiled(file, page.scratch / "out"), "", page.scratch / "jail"), file, True
        shutil.rmtree(page.scratch / "out", ignore_errors=True)


def main(page: Page) -> None:
    """Refreshes how many cfgs ended how, and prints the faults."""
    count = 50 if page.fast else page.options.cfgs
    kept = page.options.keep
    gc.freeze()
    found, faults, slowest = Counter[str](), [], 0.0
    for number, (outcome, file, sound) in enumerate(outcomes(page, count, page.options.compile)):
        if outcome is None:
            found["not compiled" if sound else "faults told"] += 1
            continue
        kind = "refused by the scene" if outcome.kind == "refused" else outcome.kind
        found["compiled" if kind == "taken" else kind] += 1
        slowest = max(slowest, outcome.seconds)
        if outcome.fault:
            faults.append(f"{outcome.kind}: {outcome.text.strip()[:300]}")
            print(number, faults[-1], flush=True)
            if kept is not None:
                kept.mkdir(parents=True, exist_ok=True)
                (kept / f"cfg_{number}.json").write_bytes(file.read_bytes())
    page.value("drawn", f"{count:,}")
    page.value("drawn_faults", str(len(faults)))
    page.block("drawn_cfgs", ["outcome", "cfgs"], found.most_common())
    page.refresh((), ())
    page.say(f"{count:,} cfgs; the slowest took {slowest:.1f} s")
    for fault, times in Counter(faults).most_common():
        page.say(f"- {times} x {fault}")


if __name__ == "__main__":
    run(main, page="robustness", cfgs=1_000, compile=10, seed=0, keep=Path)
