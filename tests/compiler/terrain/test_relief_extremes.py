"""All operators on everything: extents from a millimeter to ten thousand kilometers, any ground."""

from __future__ import annotations

import json

import numpy as np
import pytest

from scenec.compiler.distributions.streams import Streams
from scenec.compiler.kinds.context import Context
from scenec.compiler.kinds.draw import draw_kind
from scenec.compiler.kinds.table import CHOICES, kind_of, name_of
from scenec.compiler.terrain.condition import Height, Interval, Noise, Slope
from scenec.compiler.terrain.grid import Grid
from scenec.compiler.terrain.mask import Masked
from scenec.compiler.terrain.operators.craters import Craters
from scenec.compiler.terrain.operators.crust import Crust
from scenec.compiler.terrain.operators.dunes import Dunes, Ripples
from scenec.compiler.terrain.operators.multifractal import Multifractal
from scenec.compiler.terrain.operators.polygons import Polygons
from scenec.compiler.terrain.operators.smooth import Diffusion, Smooth
from scenec.compiler.terrain.operators.stream_power import StreamPower
from scenec.compiler.terrain.operators.terraces import Terraces
from scenec.compiler.terrain.operators.thermal import Thermal
from scenec.compiler.terrain.operators.tracks import Tracks
from scenec.compiler.terrain.operators.worley import Worley
from scenec.compiler.terrain.program import run
from scenec.compiler.terrain.sources.plane import Plane
from scenec.schemas.errors import SceneError

EXTENTS = [1e-3, 1.0, 1e3, 1e6, 1e7]


def operators(size: float, folder) -> list:
    """One of each, about as large as the terrain."""
    (folder / "path.csv").write_text(f"{-0.4 * size},0\n{0.1 * size},{0.2 * size}\n")
    pits = {
        "min_diameter_m": 0.1 * size,
        "max_diameter_m": size,
        "density_per_m2": 10.0,
        "reference_diameter_m": 0.1 * size,
        "exponent": 2.0,
        "depth_ratio": 0.2,
        "rim_ratio": 0.04,
        "degradation": 1.0,
        "irregularity": 0.1,
    }
    pits["density_per_m2"] = 20.0 / (size * size)
    heaps = {"count": 5, "height_m": 0.03 * size, "wind_deg": 20.0, "repose_deg": 33.0}
    boots = {
        "walks": 2,
        "stride_m": 0.9 * size,
        "length_m": 1.3 * size,
        "depth_m": 0.02 * size,
        "tread_m": 0.01 * size,
    }  # fmt: skip

    def scattered(node: dict):
        context = Context(Streams(1, 0), (size, 0.7 * size))
        return draw_kind("relief", node, node["type"], context)

    large = [
        Plane(size, (0.3, -1e6)),
        Multifractal(key=1, amplitude_m=0.1 * size, scale_m=0.3 * size, octaves=24, gain=2.0,
                     variant="hybrid", distortion=2.0),
        Worley(key=2, amplitude_m=-size, scale_m=0.2 * size, distance="f2-f1", octaves=4),
        Polygons(key=2, scale_m=0.3 * size, depth_m=0.02 * size, width_m=0.1 * size,
                 shoulder_m=0.01 * size, irregularity=1.0),
        scattered({"type": "craters", **pits}),
        Dunes(key=3, height_m=0.01 * size, wavelength_m=0.2 * size, wind_deg=70.0, order=0.2),
        scattered({"type": "barchans", **heaps}),
        Ripples(key=3, height_m=0.004 * size, wavelength_m=0.12 * size, wind_deg=70.0,
                repose_deg=30.0, order=0.2),
        Terraces(key=4, step_m=0.03 * size, riser=0.2, tread_slope=0.1, irregularity=1.0,
                 bend_m=0.1 * size, bend_scale_m=0.3 * size),
        StreamPower(erodibility=1e-3, area_exponent=0.4, slope_exponent=1.3, duration_a=1e5,
                    diffusivity_m2_per_a=1e-3, uplift_m_per_a=size, steps=2),
        Thermal(33.0),
        Diffusion(1e6, 1e6),
        Smooth(0.02 * size),
        Crust(key=5, height_m=0.02 * size, plate_m=0.5 * size, missing=0.3),
        scattered({"type": "footprints", **boots}),
        Tracks(file=folder / "path.csv", wheel_distance_m=0.3 * size, wheel_width_m=0.12 * size,
               depth_m=0.01 * size, grouser_spacing_m=0.1 * size, grouser_depth_m=0.01 * size),
    ]  # fmt: skip
    there = {"dem", "downscale", "mesh", *(name_of("relief", type(operator)) for operator in large)}
    rest = [name for name in CHOICES["relief"].kinds if name not in there]
    return [*large, *(scattered(dict(kind_of("relief", name).EXAMPLE)) for name in rest)]


def grounds(grid: Grid) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(0)
    flat = np.zeros(grid.shape)
    return {
        "flat": flat,
        "a million meters up": flat + 1e6,
        "a cliff": flat + np.where(grid.x() > 0.0, 1e6, -1e6)[None, :],
        "rough": 1e6 * rng.normal(size=grid.shape),
        "a needle": np.where((np.indices(grid.shape) == 7).all(axis=0), 1e6, 0.0),
        "tiny": 1e-300 * rng.normal(size=grid.shape),
    }


@pytest.mark.parametrize("size", EXTENTS)
def test_every_operator_takes_every_ground_at_every_extent(size, tmp_path):
    grid = Grid.with_spacing((size, 0.7 * size), size / 40)
    ops = operators(size, tmp_path)
    for name, ground in grounds(grid).items():
        for operator in ops:
            before = ground.copy()
            out, report = operator.apply(grid, ground)
            assert np.isfinite(out).all(), (name, operator)
            assert np.array_equal(ground, before), "the input is not to be changed"
            json.dumps(report, allow_nan=False)


@pytest.mark.parametrize("size", EXTENTS)
def test_every_operator_is_the_same_at_every_extent(size, tmp_path):
    # Lengths in units of the extent: powers of two keep every bit but for squares of lengths.
    unit = 2.0 ** round(np.log2(size))
    results = []
    for scale in (1.0, unit):
        grid = Grid.with_spacing((scale, 0.7 * scale), scale / 40)
        ops = [op for op in operators(scale, tmp_path) if name_of("relief", type(op)) in SCALE_FREE]
        base = Multifractal(
            key=1, amplitude_m=0.1 * scale, scale_m=0.3 * scale, octaves=6, variant="fbm"
        )
        ground = base.apply(grid, np.zeros(grid.shape))[0]
        results.append([op.apply(grid, ground)[0] / scale for op in ops])
    for a, b in zip(*results, strict=True):
        assert np.allclose(a, b, rtol=0, atol=1e-9)


#: Operators without a physical constant of their own, and whose draws do not depend on a scale.
SCALE_FREE = (
    "multifractal",
    "worley",
    "polygons",
    "crust",
    "dunes",
    "barchans",
    "ripples",
    "terraces",
    "thermal",
    "smooth",
    "tracks",
    "footprints",
)


@pytest.mark.parametrize("size", EXTENTS)
def test_masks_take_every_ground(size):
    grid = Grid.with_spacing((size, 0.7 * size), size / 40)
    conditions = (
        Interval(Height(), -1e6, 1e6, 0.0),
        Interval(Slope(over_m=0.0), 0.0, 89.0, 5.0),
        Interval(
            Noise(key=1, scale_m=0.3 * size, octaves=24, lacunarity=2.0, gain=0.5), -0.5, None, 0.0
        ),
    )
    for ground in grounds(grid).values():
        out, _ = Masked(Thermal(30.0), conditions).apply(grid, ground)
        assert np.isfinite(out).all()


def test_craters_without_any_are_nothing():
    empty = Craters(*(np.zeros(0) for _ in range(6)), np.zeros(0, np.uint64), 0.1)
    grid = Grid((4.0, 4.0), (5, 5))
    assert np.array_equal(empty.apply(grid, np.ones((5, 5)))[0], np.ones((5, 5)))


def test_craters_that_would_take_hours_are_refused():
    n = 500_000
    grid = Grid.with_spacing((1e6, 1e6), 5e3)
    everywhere = Craters(
        np.zeros(n),
        np.zeros(n),
        np.full(n, 1e6),
        *(np.full(n, 0.1) for _ in range(3)),
        np.zeros(n, np.uint64),
        0.1,
    )
    with pytest.raises(SceneError, match=r"500,000 craters reach over 2e\+10 samples"):
        everywhere.apply(grid, np.zeros(grid.shape))


@pytest.mark.parametrize("kind", [Dunes, Ripples])
@pytest.mark.parametrize("wavelength", [5e-324, 1e-300, 1.0])
def test_bedforms_too_high_for_their_distance_are_refused(kind, wavelength):
    grid = Grid.with_spacing((20.0, 20.0), 1.0)
    with pytest.raises(SceneError, match="raise wavelength_m"):
        kind(key=1, height_m=10.0, wavelength_m=wavelength).apply(grid, np.zeros(grid.shape))


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("scale", [5e-324, 1e-300, 1e-30, 1e-9, 1.0, 1e9])
@pytest.mark.parametrize("lacunarity", [1.0, 2.0, 8.0])
def test_detail_finer_than_float64_can_place_is_left_out(scale, lacunarity):
    # 8^24 wavelengths to one: the whole numbers of such a lattice overflow.
    grid = Grid.with_spacing((20.0, 14.0), 0.5)
    x = np.linspace(-10.0, 10.0, 101)
    found = []
    for kind, variants in ((Multifractal, FRACTALS), (Worley, ("f1", "f2-f1", "blocks"))):
        for variant in variants:
            if kind is Worley:
                noise = Worley(
                    key=2,
                    amplitude_m=1.0,
                    scale_m=scale,
                    distance=variant,
                    octaves=24,
                    lacunarity=lacunarity,
                )
            else:
                noise = Multifractal(
                    key=1,
                    amplitude_m=1.0,
                    scale_m=scale,
                    octaves=24,
                    lacunarity=lacunarity,
                    variant=variant,
                    distortion=0.5,
                )
            assert np.isfinite(noise.apply(grid, np.zeros(grid.shape))[0]).all()
            details = (noise.detail(grid), noise.everywhere())
            found += [detail.at(x, 0.3 * x) for detail in details if detail is not None]
    # A few cells, or wavelengths, of height; coordinates would be 1e18 of them.
    assert found
    assert np.abs(np.array(found)).max() < 10.0


#: The kinds of fractals.
FRACTALS = ("fbm", "hetero", "hybrid", "ridged", "billow")


@pytest.mark.filterwarnings("error")
def test_detail_that_no_renderer_can_hold_is_refused():
    # Below the grid, octave upon octave of twice the amplitude of the one before.
    grid = Grid.with_spacing((20.0, 20.0), 5.0)
    wild = Multifractal(key=1, amplitude_m=1e6, scale_m=5.0, octaves=24, gain=2.0, variant="hybrid")
    assert np.abs(wild.apply(grid, np.zeros(grid.shape))[0]).max() < 1e9
    with pytest.raises(SceneError, match=r"heights reach .*e\+\d\d m, at most 1e\+18 m"):
        run((wild,), grid)
