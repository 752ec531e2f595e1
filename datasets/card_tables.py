"""Statistics as Markdown: tables, and histograms whose bars are text."""

from __future__ import annotations

import html
import re
from collections.abc import Iterable, Sequence

from scenec.schemas.codec import JsonObject

_BAR = 24
_EIGHTHS = " ▏▎▍▌▋▊▉█"


def table(header: Sequence[str], rows: Iterable[Sequence[object]], right: str = "") -> str:
    """A Markdown table.

    Args:
        header: Names of columns.
        rows: Of values; whole numbers get thousands separators.
        right: A letter a column, ``r`` where numbers stand; the rest is aligned left.
    """
    marks = right.ljust(len(header), "l")
    lines = [
        "| " + " | ".join(header) + " |",
        "|" + "|".join(" ---: " if mark == "r" else " --- " for mark in marks) + "|",
    ]
    lines += ["| " + " | ".join(map(_cell, row)) + " |" for row in rows]
    return "\n".join(lines) + "\n"


def _cell(value: object) -> str:
    if isinstance(value, int) and not isinstance(value, bool):
        return f"{value:,}"
    if isinstance(value, float):
        return f"{value:.4g}"
    return str(value).replace("|", "\\|").replace("\n", " ")


def plain(text: object) -> str:
    """Text of others as Markdown shows it: no link, no tag, no code, one line."""
    marked = re.sub(r"([\\`*~\[\]])", r"\\\1", " ".join(str(text).split()))
    return html.escape(marked, quote=False)


def code(text: object) -> str:
    """Text of others as a span of code, whatever is in it."""
    inner = " ".join(str(text).split("\n")).replace("\r", " ")
    fence = "`" * (1 + max((len(run) for run in re.findall(r"`+", inner)), default=0))
    room = " " if not inner.strip(" ") or inner[0] == "`" or inner[-1] == "`" else ""
    return f"{fence}{room}{inner}{room}{fence}"


def bar(count: int, most: int) -> str:
    """A bar of text, to an eighth of a character; what is not 0 shows."""
    eighths = round(8 * _BAR * count / most) if most else 0
    eighths = max(eighths, 1) if count else 0
    return (_EIGHTHS[8] * (eighths // 8) + _EIGHTHS[eighths % 8]).strip()


def histogram(entry: JsonObject, what: str, counted: str) -> str:
    """A histogram of ``statistics.json`` as a table with bars.

    Args:
        entry: ``edges``, ``counts``, and what is beyond them.
        what: Header of the first column.
        counted: Header of the second.
    """
    edges, counts = entry["edges"], entry["counts"]
    rows: list[tuple[str, int]] = []
    if entry.get("zero"):
        rows.append(("0", entry["zero"]))
    if entry.get("below"):
        rows.append((f"below {edges[0]:g}" if edges else "below all bins", entry["below"]))
    rows += [
        (f"{low:g} to {high:g}", count)
        for low, high, count in zip(edges, edges[1:], counts, strict=False)
    ]
    if entry.get("above"):
        rows.append((f"from {edges[-1]:g}" if edges else "above all bins", entry["above"]))
    if entry.get("one"):
        rows.append(("1", entry["one"]))
    if entry.get("nothing"):
        rows.append(("nothing hit", entry["nothing"]))
    most = max((count for _, count in rows), default=0)
    return table([what, counted, ""], [(t, c, bar(c, most)) for t, c in rows], "lr")


def levels(entries: JsonObject) -> str:
    """Labels of all levels, with what is seen of them."""
    parts = []
    for level, entry in entries.items():
        rows: list[Sequence[object]] = [
            (
                label["id"],
                plain(name),
                label["pixels"],
                f"{100 * label['share']:.3f} %",
                label["frames"],
            )
            for name, label in entry["labels"].items()
        ]
        for name in ("unlabeled", "unknown"):
            if entry[name]:
                share = 100 * entry[name] / entry["pixels"]
                rows.append(("0" if name == "unlabeled" else "", name, entry[name],
                             f"{share:.3f} %", ""))  # fmt: skip
        header = ["id", "label", "pixels", "share", "frames"]
        parts.append(f"Level {code(level)}:\n\n" + table(header, rows, "rlrrr"))
    return "\n".join(parts)


#: ``maxDets`` of pycocotools' COCOeval, where nobody sets it.
_COCO_DETECTIONS = 100


def instances(part: JsonObject) -> str:
    """Classes of instances, and histograms over all of them."""
    rows = [
        (code(name), entry["seen"], entry["distinct"], entry["frames"], entry["at_border"])
        for name, entry in part["classes"].items()
    ]
    if len(rows) > 1:
        rows.append(("all", part["seen"], part["distinct"], "", ""))
    header = ["class", "seen in frames", "distinct", "frames", "at the border"]
    text = table(header, rows, "lrrrr")
    text += (
        "\n*Seen* counts an instance once for each frame that shows it, *distinct* once for its "
        "batch.\n"
    )
    most = part["most_in_a_frame"]
    text += f"No frame shows more than {most:,}.\n"
    if most > _COCO_DETECTIONS:
        text += (
            f"COCOeval judges the best {_COCO_DETECTIONS} detections of a category in a picture, "
            f"unless it is told: set `params.maxDets = [1, {_COCO_DETECTIONS}, {most}]`. The first "
            f"line of its summary stays that of {_COCO_DETECTIONS}; "
            "`eval['precision'][..., -1]` has them all.\n"
        )
    if part["ignored"]:
        text += f"{part['ignored']:,} are marked as not to be judged, and not counted here.\n"
    titles = {
        "area": ("pixels that show it", "Area"),
        "size": ("longest side, meters", "Size"),
        "distance": ("mean depth, meters", "Distance"),
        "occlusion": ("part hidden by others", "Occlusion"),
        "truncation": ("part beyond the border", "Truncation"),
    }
    text += "\nInstances in a frame:\n\n" + histogram(part["per_frame"], "instances", "frames")
    for key, (what, title) in titles.items():
        if key in part["all"]:
            text += f"\n{title}:\n\n" + histogram(part["all"][key], what, "instances")
    return text


def viewpoints(part: JsonObject) -> str:
    """Tabulates positions and directions of cameras."""
    rows = [(axis, float(low), float(high)) for axis, (low, high) in part["position_m"].items()]
    text = "Positions of cameras, meters:\n\n" + table(["axis", "least", "most"], rows, "lrr")
    titles = {
        "height_above_surface": "Height above the first surface straight below, meters",
        "pitch": "Pitch, degrees above the horizon",
        "roll": "Roll, degrees clockwise about the optical axis",
        "heading": "Heading, degrees clockwise from +Y (north)",
    }
    for key, title in titles.items():
        if key in part:
            text += f"\n{title}:\n\n" + histogram(part[key], key.split("_")[0], "frames")
    return text


def sun(part: JsonObject) -> str:
    """Elevations by bearings of the sun."""
    edges = part["azimuth_edges_deg"]
    header = ["elevation \\ bearing", *(f"{low:g}°" for low in edges[:-1])]
    rows = [
        [f"{10 * int(row) - 90}° to {10 * int(row) - 80}°", *(count or "" for count in counts)]
        for row, counts in reversed(part["frames"].items())
    ]
    text = table(header, rows, "l" + "r" * 12) if rows else ""
    if part["without"]:
        text += f"\n{part['without']:,} frames have no sun.\n"
    return text
