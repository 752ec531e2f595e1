"""The dataset card: what a dataset is, how it was made, how it can be made again.

Markdown with a head of YAML, as the Hugging Face hub reads it
(https://huggingface.co/docs/hub/datasets-cards). It holds the whole cfg: with it, the files that
the cfg names, and scenec of the version it states, the dataset can be made again, and proved to be.
"""

from __future__ import annotations

import json
import re
import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from scenec.datasets import card_tables as tables
from scenec.datasets.formats.contract import Narrowed
from scenec.schemas.codec import JsonObject
from scenec.schemas.files import atomic
from scenec.schemas.frames import CONVENTIONS

#: The hub's classes of size: fewer frames than this.
_SIZES = ((1_000, "n<1K"), (10_000, "1K<n<10K"), (100_000, "10K<n<100K"),
          (1_000_000, "100K<n<1M"), (10_000_000, "1M<n<10M"))  # fmt: skip
#: Conventions that hold for all frames, whatever their passes.
_ALWAYS = ("pixel", "intrinsics", "camera_to_world")


def write_card(
    path: Path,
    summary: JsonObject,
    statistics: JsonObject,
    usage: str,
    cfg: str | None = None,
) -> None:
    """Write it; the same dataset gives the same bytes.

    Args:
        path: ``README.md`` of the dataset.
        summary: What ``export.json`` holds.
        statistics: What ``statistics.json`` holds.
        usage: The format's own paragraph; may begin with YAML for the head, see
            ``formats.contract.Format.usage``.
        cfg: The cfg's text; None where it is not known.

    Raises:
        OutputError: It cannot be written.
    """
    head, usage = _parted(usage)
    parts = [
        _front_matter(summary, statistics, head),
        _introduction(summary, statistics),
        "## Splits\n\n" + _splits(summary),
        f"## How to load it\n\n{usage.strip()}\n" if usage.strip() else "",
        "## Labels\n\n" + tables.levels(statistics["levels"]) if statistics["levels"] else "",
        "## Instances\n\n" + tables.instances(statistics["instances"])
        if "instances" in statistics
        else "",
        "## Depth\n\n" + tables.histogram(statistics["depth"], "meters", "pixels")
        if "depth" in statistics
        else "",
        "## Views\n\n" + _cameras(statistics) + "\n" + tables.viewpoints(statistics["view"]),
        "## Sun\n\nFrames by where the sun stands:\n\n" + tables.sun(statistics["sun"])
        if "sun" in statistics
        else "",
        "## Conventions\n\n" + _conventions(statistics),
        "## How it was made\n\n" + _making(summary, statistics),
        "## Licenses\n\n" + _licenses(summary),
        "## Make it again\n\n" + _again(summary, statistics, cfg),
        "## Is it whole, is it the same\n\n" + _proof(summary),
    ]
    with atomic(path) as temporary:
        text = "\n".join(part for part in parts if part)
        temporary.write_text(text, encoding="utf-8")


def _parted(usage: str) -> tuple[str, str]:
    """YAML for the head, and the rest."""
    match = re.match(r"---\n(.*?\n)---\n", usage, re.DOTALL)
    return (match[1], usage[match.end() :]) if match else ("", usage)


def _front_matter(summary: dict[str, Any], statistics: dict[str, Any], head: str) -> str:
    passes = _passes(statistics)
    tasks = []
    if any(name.startswith("label.") for name in passes) or "instance" in passes:
        tasks.append("image-segmentation")
    if "instance" in passes:
        tasks.append("object-detection")
    if "depth" in passes:
        tasks.append("depth-estimation")
    size = next((name for most, name in _SIZES if summary["frames"] < most), "n>10M")
    lines = ["---", f"pretty_name: {json.dumps(_name(summary), ensure_ascii=False)}"]
    # What made the frames does not decide on what terms they are given on.
    lines += ["license: unknown", "annotations_creators:", "- machine-generated"]
    lines += ["task_categories:", *(f"- {task}" for task in tasks)] if tasks else []
    lines += ["size_categories:", f"- {size}", "tags:", "- synthetic", "- robotics", "- scenec"]
    return "\n".join([*lines, *head.splitlines(), "---", ""])


def _name(summary: dict[str, Any]) -> str:
    source = summary["source"]
    return str(source.get("name") or source.get("stage", ""))


def _passes(statistics: dict[str, Any]) -> list[str]:
    return list(
        dict.fromkeys(
            name for how in statistics["made"].get("rendering", []) for name in how["passes"] or ()
        )
    )


def _introduction(summary: dict[str, Any], statistics: dict[str, Any]) -> str:
    batches = len(summary["batches"])
    backends = sorted({str(how["backend"]) for how in statistics["made"].get("rendering", [])})
    return (
        f"# {tables.plain(_name(summary))}\n\n"
        f"{summary['frames']:,} frames of {batches:,} "
        f"{'batch' if batches == 1 else 'batches'} (a batch is one terrain with its objects), made "
        f"by scenec {summary['scenec']} from a cfg and a seed, rendered by "
        f"{tables.plain(', '.join(backends))}, in the format `{summary['format']}`. "
        "Nothing in them was photographed or labeled by "
        "hand: annotation is the exact nearest hit of the ray through each pixel's center, the "
        "same whichever renderer drew the picture.\n\n"
        f"Each frame has: {', '.join(tables.code(name) for name in _passes(statistics))}. "
        "`frames.csv` lists all frames, `statistics.json` holds the numbers below, `export.json` "
        "what was exported and how.\n"
    )


def _splits(summary: dict[str, Any]) -> str:
    batches: dict[str, list[int]] = {name: [] for name in summary["splits"]}
    for batch, split in summary["batches"].items():
        batches[split].append(int(batch))
    rows = [
        (tables.code(name), frames, len(batches[name]), _ranges(sorted(batches[name])))
        for name, frames in summary["splits"].items()
    ]
    text = tables.table(["split", "frames", "batches", "which"], rows, "lrr")
    ranges = any(isinstance(value, str) for value in summary["asked"]["splits"].values())
    if "sweep" in summary["source"] and ranges:
        return text + "\nPoints with the same seed may have the same terrain, in any split.\n"
    return text + "\nNo terrain is in two splits.\n" if len(rows) > 1 else text


def _ranges(numbers: list[int]) -> str:
    """Formats numbers as ``0-3, 7``, cut where that is long."""
    runs: list[list[int]] = []
    for number in numbers:
        if runs and number == runs[-1][1] + 1:
            runs[-1][1] = number
        else:
            runs.append([number, number])
    texts = [f"{a}" if a == b else f"{a}-{b}" for a, b in runs]
    return ", ".join(texts[:20]) + (", … (`export.json` has all)" if len(texts) > 20 else "")


def _cameras(statistics: dict[str, Any]) -> str:
    rows = []
    for camera in statistics["made"].get("cameras", []):
        k = camera["intrinsics"]
        width, height = camera["resolution"]
        rows.append((tables.code(camera["camera"]), f"{width} × {height}", float(k[0][0]),
                     float(k[1][1]), float(k[0][2]), float(k[1][2]), camera["frames"]))  # fmt: skip
    header = ["camera", "pixels", "fx", "fy", "cx", "cy", "frames"]
    return tables.table(header, rows[:50], "lrrrrrr")


def _conventions(statistics: dict[str, Any]) -> str:
    passes = {name.partition(".")[0] for name in _passes(statistics)}
    lines = [
        f"- **{name}**: {text}"
        for name, text in CONVENTIONS.items()
        if name in _ALWAYS or name in passes
    ]
    return (
        "Of the frames as they were rendered; where the format has its own, they stand above.\n\n"
        + "\n".join(lines)
        + "\n"
    )


def _making(summary: dict[str, Any], statistics: dict[str, Any]) -> str:
    source = summary["source"]
    rows: list[tuple[str, object]] = []
    if "stage" in source:
        rows.append(("stage", tables.code(source["stage"])))
    elif "sweep" in source:
        points = len(source["sweep"])
        rows.append(("sweep", f"{tables.code(source['name'])}, {points:,} points (`points.csv`)"))
    else:
        digest = source.get("cfg", {}).get("sha256", "unknown")
        libraries = ", ".join(f"{name} {v}" for name, v in source.get("libraries", {}).items())
        rows.append(("cfg", f"{tables.code(source['name'])}, sha256 `{digest}`"))
        rows.append(("seed", str(source["seed"])))
        rows.append(("compiled by", f"scenec {source.get('scenec', 'of unknown version')}"))
        rows.append(("libraries", libraries or "unknown"))
    for how in statistics["made"].get("rendering", []):
        text = tables.plain(how["version"])
        text += f", {how['samples_per_pixel']} samples per pixel, noise seed "
        text += f"{how['noise_seed']}"
        text += f", denoised by {how['denoised']}" if how["denoised"] else ""
        rows.append((f"{how['frames']:,} frames rendered by", text))
    if "relative_rms_noise" in statistics:
        low, high = statistics["relative_rms_noise"]
        rows.append(("noise of pictures", f"relative RMS {low:.3g} to {high:.3g} (estimated)"))
    rows.append(("exported by", f"scenec {summary['scenec']}, `{summary['format']}`"))
    instances = summary["instances"]
    if summary["keep"]:
        conditions = ", ".join(map(tables.code, summary["keep"]))
        rest = "dropped" if summary["rejected"] == "drop" else "marked as ignored"
        rows.append(("filters", f"{conditions}; the rest is {rest}"))
        for condition, count in instances["rejected"].items():
            rows.append((f"rejected by {tables.code(condition)}", f"{count:,} instances"))
        rows.append(("kept", f"{instances['kept']:,} of {instances['seen']:,} instances"))
    for what, count in summary.get("left_out", {}).items():
        rows.append(("left out by the format", f"{count:,} {what}"))
    if unheld := summary.get("passes_left_out"):
        names = ", ".join(map(tables.code, unheld))
        rows.append(("passes without a place in the format", names))
    for what, one in summary["narrowed"].items():
        counts = Narrowed(one["lost"], one["of"], one["most"])
        rows.append(("lost by the format", counts.text(what, one["mend"])))
    if summary["fault_count"]:
        kinds = sorted({fault["kind"] for fault in summary["faults"]})
        rows.append(("frames left out", f"{summary['fault_count']:,} ({', '.join(kinds)})"))
    text = tables.table(["", ""], rows)
    if summary["remap"]:
        remap = json.dumps(summary["remap"], ensure_ascii=False, indent=1)
        text += f"\nLabels were changed (`--remap remap.json`):\n\n{_fenced(remap, 'json')}"
    return text


def _licenses(summary: dict[str, Any]) -> str:
    cfg = summary["source"].get("cfg", {})
    said = cfg.get("licenses", {})
    inputs = cfg.get("inputs", {})
    text = (
        "Pictures and annotation were computed. On what terms this dataset is given on is for its "
        "publisher to say, within those of the files that went in"
    )
    if not inputs:
        return text + ": the cfg names none.\n"
    rows = []
    for pointer, digest in inputs.items():
        of = said.get(pointer, {})
        rows.append((
            tables.code(f"/{pointer}"), tables.code(of["file"]) if "file" in of else "",
            tables.plain(of.get("license") or "unknown"),
            tables.plain("; ".join(of.get("copyright", ())) or "unknown"),
            tables.plain(of.get("source") or "nothing says so"), f"`{digest[:16]}…`",
        ))  # fmt: skip
    header = ["in the cfg", "file", "license", "copyright", "as said by", "sha256"]
    return text + ":\n\n" + tables.table(header, rows)


def _again(summary: dict[str, Any], statistics: dict[str, Any], cfg: str | None) -> str:
    source, asked = summary["source"], summary["asked"]
    lines = []
    swept = "sweep" in source
    compiled = "stage" not in source
    if compiled and not swept:
        lines.append(f"scenec compile cfg.json --seed {source['seed']} -o OUT")
    out = "OUT" if compiled else source["stage"]
    for how in () if swept else statistics["made"].get("rendering", []):
        words = ["scenec", "render", out, "--backend", str(how["backend"])]
        if "rgb" in (how["passes"] or ()):
            words += ["--spp", str(how["samples_per_pixel"])]
            words += ["--noise-seed", str(how["noise_seed"])]
        words += ["--passes", ",".join(_requested_passes(how["passes"] or ()))]
        words += ["--denoise"] if how["denoised"] else []
        words += ["--rgb", how["rgb"]] if "rgb" in how else []
        words += _span("--samples", asked["samples"])
        lines.append(shlex.join(words))
    words = ["scenec", "export", out, "--format", summary["format"], "-o", "AGAIN"]
    words += ["--backend", summary["backend"]]
    words += _span("--batches", asked["batches"]) + _span("--samples", asked["samples"])
    words += ["--cameras", ",".join(asked["cameras"])] if asked["cameras"] else []
    words += [word for condition in summary["keep"] for word in ("--keep", condition)]
    words += ["--rejected", "ignore"] if summary["rejected"] == "ignore" else []
    words += ["--remap", "remap.json"] if summary["remap"] else []
    words += ["--level", summary["level"]] if summary["level"] else []
    if asked["splits"]:
        splits = ",".join(f"{name}={value}" for name, value in asked["splits"].items())
        words += ["--split", splits, "--split-seed", str(asked["split_seed"])]
    for name, value in summary["options"].items():
        words += ["--set", f"{name}={value}"]
    words += ["--faults", "skip"] if asked["faults"] == "skip" else []
    lines += [shlex.join(words), "scenec check AGAIN --against DATASET"]
    text = (
        f"With scenec {source.get('scenec', summary['scenec'])} and the libraries above, in a "
        "folder of its own, where DATASET is this one:\n\n" + _fenced("\n".join(lines), "sh")
    )
    if swept:
        text += (
            "\nOUT is the sweep: `scenec sweep` with the settings and seeds of `points.csv`, and "
            "the renderer named above.\n"
        )
    elif cfg is not None:
        inputs = source.get("cfg", {}).get("inputs")
        text += "\nSave this cfg as `cfg.json`"
        text += (
            "; paths in it are relative to the folder it lies in, and the files must be those "
            "listed under Licenses.\n"
            if inputs
            else ".\n"
        )
        text += "\n<details><summary>cfg.json</summary>\n\n" + _fenced(cfg, "json")
        text += "\n</details>\n"
    elif compiled:
        text += "\nThe cfg itself is not known: its output holds no copy of it.\n"
    return text


def _requested_passes(passes: Sequence[str]) -> list[str]:
    """``label`` for all its levels, in the order of the frame."""
    return list(dict.fromkeys("label" if p.startswith("label.") else p for p in passes))


def _span(option: str, numbers: list[int] | None) -> list[str]:
    if not numbers or numbers[-1] - numbers[0] + 1 != len(numbers):
        return []
    return [option, f"{numbers[0]}:{numbers[-1] + 1}"]


def _proof(summary: dict[str, Any]) -> str:
    digest = summary["digest"]
    return (
        "`sha256sum -c SHA256SUMS` and `scenec check .` tell whether every file is as it was "
        "written. `scenec check . --against OTHER` proves, frame by frame, that another dataset "
        "(in any format), or an output folder with its frames, has the same annotation: "
        "`frames.csv` holds its digests. Annotation is exact, so they are the same on every "
        "machine; pictures of some renderers differ in their noise.\n\n"
        + tables.table(
            ["sha256 over all frames", ""],
            [
                ("annotation", f"`{digest['annotation']}`"),
                ("pictures", f"`{digest['pictures']}`"),
            ],
        )
    )


def _fenced(text: str, language: str) -> str:
    """A block of code, whatever is in it."""
    longest = max((len(run) for run in re.findall(r"`+", text)), default=0)
    fence = "`" * max(3, longest + 1)
    return f"{fence}{language}\n{text.rstrip()}\n{fence}\n"
