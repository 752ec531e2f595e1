"""Digests of the shipped cfgs' stages and annotation, to compare before and after a change.

    python lab/benchmarks/shipped_hashes.py -o before.json [CFG ...]
    python lab/benchmarks/shipped_hashes.py -o after.json --against before.json

Each file of the stage has its digest, and so has each pass of each frame (its values, not its
file); ``--against`` lists what differs and exits with status 1 if anything does.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import sys
import tempfile
import time
from pathlib import Path

from scenec.backends.run.render import render
from scenec.compiler.compile import compile_cfg
from scenec.schemas.frames import read_frame

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
PASSES = ("depth", "face", "instance", "label", "normal")


def digests(cfg: Path) -> dict[str, str]:
    """Digest of each file of the first batch's stage and of each pass of its frames, seed 1."""
    found = {}
    with tempfile.TemporaryDirectory() as scratch:
        out = Path(scratch, "out")
        compile_cfg(cfg, seed=1, out=out, batches=range(1))
        files = json.loads((out / "manifest.json").read_text(encoding="utf-8"))["files"]
        found |= {f"stage/{name}": digest for name, digest in files.items()}
        for path in render(out, "reference", passes=PASSES).frames:
            frame = read_frame(path)
            place = f"{path.parent.name}/{path.stem}"
            for name, values in sorted(frame.passes.items()):
                found[f"frames/{place}/{name}"] = hashlib.sha256(values.tobytes()).hexdigest()
    return found


def main() -> int:
    """Digests of all cfgs into a file; compares them with another."""
    arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    arguments.add_argument("cfgs", nargs="*", help="names in configs/, all if none is given")
    arguments.add_argument("-o", "--out", type=Path, required=True)
    arguments.add_argument("--against", type=Path)
    options = arguments.parse_args()
    names = options.cfgs or sorted(path.stem for path in CONFIGS.glob("*.json"))
    found = {}
    for name in names:
        start = time.process_time()
        found[name] = digests(CONFIGS / f"{name}.json")
        print(f"{name}: {len(found[name])} digests, {time.process_time() - start:.1f} CPU s")
    options.out.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    if options.against is None:
        return 0
    before = json.loads(options.against.read_text(encoding="utf-8"))
    differ = 0
    for name in names:
        old, new = before.get(name, {}), found[name]
        for key in sorted(old.keys() | new.keys()):
            if old.get(key) != new.get(key):
                differ += 1
                what = "gone" if key not in new else "new" if key not in old else "differs"
                print(f"{name} {key}: {what}")
    print(f"{differ} of {sum(map(len, found.values()))} differ")
    return int(differ > 0)


if __name__ == "__main__":
    sys.exit(main())
