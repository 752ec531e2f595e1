"""Writes docs/relief.md: what each relief operator looks like, how sound it is over whole ranges.

    python lab/pages/relief.py [--fast] [-o FOLDER]

Needs the extras "demo" (matplotlib) and "geotiff". Times are best readings on the machine that runs
it; everything else is a fact of the code.
"""

from __future__ import annotations

from scenec.lab.benchmarks import relief
from scenec.lab.pages import (
    relief_diffusion,
    relief_erosion,
    relief_forms,
    relief_horizon,
    relief_prints,
    relief_ranges,
    relief_steps,
)
from scenec.lab.runner import Page, run, table

HEAD = """# Relief: what it looks like, and how sound it is

Every operator of `terrain.relief` ([keys](cfg.md#relief-operator)), what it looks like, and what
it keeps to over ranges far wider than sensible ones. Seconds are best readings on {cores} cores
({versions}); everything else does not depend on the machine. Tests check the same facts
(`tests/compiler/terrain/test_relief*.py`, `test_extents.py`, `test_georeference.py`,
`test_fastscapelib.py`); this page makes them readable.
"""


def speed(page: Page) -> str:
    """Seconds on big grids."""
    found = relief.rows(*((256, 1) if page.fast else (2048, 5)), page.scratch)
    return (
        "## Seconds\n\nOf all cores together where it says CPU; pyfastnoiselite and fastscapelib "
        "beside them.\n\n" + table(relief.HEADER, found)
    )


def main(page: Page) -> None:
    """Writes the page and its pictures."""
    page.write(HEAD, ("scenec", "numpy", "numba", "scipy"), [
        relief_forms.gallery, relief_prints.prints, relief_diffusion.steps,
        relief_diffusion.schemes, relief_diffusion.convergence, relief_erosion.rivers,
        relief_steps.river_steps, relief_steps.hillslopes, relief_erosion.slides,
        relief_steps.iterations,
        relief_steps.inventory, relief_ranges.noises, relief_ranges.extents,
        relief_ranges.origins, relief_ranges.dems, relief_forms.craters, relief_horizon.horizon,
        speed,
    ])  # fmt: skip


if __name__ == "__main__":
    run(main, page="relief")
