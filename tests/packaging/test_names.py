"""One name, one thing: class names are unique in the house."""

from __future__ import annotations

import ast
from collections import Counter
from itertools import chain
from pathlib import Path

from test_rooms import HOUSE

ROOT = Path(__file__).resolve().parents[2]
#: Names that several rooms still share; to become none. The two sides of a stage, which a compiler
#: writes and backends read, have most of them.
SHARED = """
    Bare Case Comparison Context Entry Experiment Fault Finding Focus Frame Geometry Glow Gobo
    Ground Haze Labels Ladder Lamp Layer Lens Level Lidar Look Meter Model Numbers OpenShutter
    Options Outcome Part Picture Pictures Placement Places Plan Record Reflectance Row Rows
    Rung Scene Sensor Shape Sky Slope Source Stack Statistics Surface Table Tally Target Task
    Truth Value View Views
"""


def test_class_names_are_unique_in_the_house():
    files = chain.from_iterable((ROOT / room).rglob("*.py") for room in chain(*HOUSE))
    nodes = chain.from_iterable(ast.walk(ast.parse(file.read_text("utf-8"))) for file in files)
    counts = Counter(node.name for node in nodes if isinstance(node, ast.ClassDef))
    assert {name for name, count in counts.items() if count > 1} == {*SHARED.split()}
