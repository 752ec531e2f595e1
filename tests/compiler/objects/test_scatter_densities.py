"""Spatial laws: objects lie as each says, whatever the grid is."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from laying import laid, plan, surroundings
from PIL import Image
from scipy.spatial import cKDTree

from scenec.compiler.objects.density import (
    AroundDensity,
    ClusterDensity,
    Density,
    ImageDensity,
    NoiseDensity,
    PathDensity,
    WorleyDensity,
)
from scenec.compiler.objects.height_candidates import candidates_on
from scenec.compiler.objects.lattice import Circles, PlanLattice, nearest
from scenec.compiler.objects.rings import RingDensity
from scenec.compiler.terrain.operators.craters import Craters
from scenec.schemas.errors import SceneError

N = 100_000


def uniforms(n: int = N, seed: int = 1) -> np.ndarray:
    return np.random.default_rng(seed).random((n, 3))


def points(density: Density, around=None, n: int = N) -> tuple[np.ndarray, np.ndarray]:
    around = around or surroundings()
    return candidates_on(around.surface.field, density, (), around, "rocks").at(uniforms(n))[:2]


def chi_square(x: np.ndarray, y: np.ndarray, wanted: np.ndarray) -> float:
    """Standard deviations from the mean of chi-square, over 20 by 16 squares of 2 m.

    Args:
        x, y: What was placed.
        wanted: Relative density at the middles of 0.1 m squares, [320, 400].
    """
    found, _, _ = np.histogram2d(y, x, bins=(16, 20), range=[[-16, 16], [-20, 20]])
    sums = wanted.reshape(16, 20, 20, 20).sum(axis=(1, 3))
    sums *= len(x) / sums.sum()
    there = sums > 5.0
    # Squares that expect next to nothing hold next to nothing.
    assert found[~there].sum() <= 3.0 * sums[~there].sum() + 10.0
    degrees = there.sum() - 1
    chi = ((found - sums) ** 2 / np.where(there, sums, 1.0))[there].sum()
    return float((chi - degrees) / np.sqrt(2.0 * degrees))


def middles() -> tuple[np.ndarray, np.ndarray]:
    x, y = (0.1 * (np.arange(n) + 0.5) - 0.05 * n for n in (400, 320))
    return np.meshgrid(x, y)


def path_file(folder):
    file = folder / "path.csv"
    file.write_text("x_m,y_m\n-18,-10\n-4,7\n15,-6\n")
    return file


def to_path(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Distance from the path of ``path_file``, by brute force."""
    corners = np.array([[-18, -10], [-4, 7], [15, -6]], float)
    found = np.full(x.shape, np.inf)
    for a, b in pairwise(corners):
        t = ((x - a[0]) * (b - a)[0] + (y - a[1]) * (b - a)[1]) / ((b - a) ** 2).sum()
        t = np.clip(t, 0.0, 1.0)
        found = np.minimum(found, np.hypot(x - a[0] - t * (b - a)[0], y - a[1] - t * (b - a)[1]))
    return found


def craters(state: tuple[float, ...] = (0.0, 0.3)) -> Craters:
    n = len(state)
    return Craters(
        x_m=np.linspace(-9.0, 9.0, n),
        y_m=np.linspace(2.0, -4.0, n),
        diameter_m=np.linspace(8.0, 5.0, n),
        depth_ratio=np.full(n, 0.2),
        rim_ratio=np.full(n, 0.04),
        state=np.array(state),
        outline=np.arange(n).astype(np.uint64),
        irregularity=0.0,
    )


def test_every_law_places_as_its_formula_says(tmp_path):
    x, y = middles()
    flat = x.ravel(), y.ravel()
    away = to_path(x, y)
    worley = WorleyDensity(key=3, scale_m=7.0, distance="f2-f1", sharpness=6.0, jitter=0.9)
    noise = NoiseDensity(key=5, scale_m=6.0, octaves=3, contrast=2.0)
    parents = np.random.default_rng(4).uniform(-1, 1, (2, 9)) * [[22], [18]]
    square = (x[..., None] - parents[0]) ** 2 + (y[..., None] - parents[1]) ** 2
    thomas = np.where(square < 16 * 1.2**2, np.exp(-0.5 * square / 1.2**2), 0.0).sum(axis=2)
    band = (np.abs(away - 2.0) <= 0.7).astype(float)
    file = path_file(tmp_path)
    for density, wanted in (
        (worley, worley.at(*flat).reshape(x.shape)),
        (noise, noise.at(*flat).reshape(x.shape)),
        (ClusterDensity(*parents, 1.2, 0.0), thomas),
        (ClusterDensity(*parents, 1.2, 0.3), 0.3 + 0.7 * thomas / thomas.mean()),
        (
            PathDensity(file=file, law="gaussian", width_m=0.8, offset_m=0.0, background=0.0),
            np.exp(-0.5 * (away / 0.8) ** 2),
        ),
        (PathDensity(file=file, law="band", width_m=0.7, offset_m=2.0, background=0.0), band),
        (
            PathDensity(file=file, law="band", width_m=0.7, offset_m=2.0, background=0.2),
            0.2 + 0.8 * band / band.mean(),
        ),
    ):
        # Four standard deviations and a little: a cell's width shows at 1e5 points.
        assert abs(chi_square(*points(density), wanted)) < 6.0, density


def test_a_chi_square_tells_a_density_from_a_slightly_other_one():
    x, y = middles()
    other = (
        NoiseDensity(key=5, scale_m=6.0, octaves=3, contrast=2.2)
        .at(x.ravel(), y.ravel())
        .reshape(x.shape)
    )
    assert (
        chi_square(*points(NoiseDensity(key=5, scale_m=6.0, octaves=3, contrast=2.0)), other) > 6.0
    )


def test_a_picture_lies_with_its_top_in_the_north_and_is_followed_pixel_by_pixel(tmp_path):
    gray = np.random.default_rng(0).integers(0, 256, (16, 20)).astype(np.uint8)
    gray[:4] //= 8
    Image.fromarray(gray).save(tmp_path / "map.png")
    x, y = points(ImageDensity(file=tmp_path / "map.png"))
    wanted = np.kron(gray[::-1].astype(float), np.ones((20, 20)))
    assert abs(chi_square(x, y, wanted)) < 4.0
    assert (y > 8).mean() < 0.1


def test_one_pixel_that_is_not_black_holds_everything(tmp_path):
    gray = np.zeros((50, 70), np.uint16)
    gray[7, 11] = 3
    Image.fromarray(gray).save(tmp_path / "map.png")
    x, y = points(ImageDensity(file=tmp_path / "map.png"))
    west, south = -20 + 40 * 11 / 70, 16 - 32 * 8 / 50
    # But for the cells that reach over its border: a quarter of a pixel wide at most.
    cell = 0.25 * 40 / 70
    assert x.min() >= west - cell
    assert x.max() <= west + 40 / 70 + cell
    assert y.min() >= south - cell
    assert y.max() <= south + 32 / 50 + cell
    assert x.mean() == pytest.approx(west + 20 / 70, abs=0.01)


def test_rings_follow_the_ejecta_and_favor_fresh_craters():
    # One crater alone: the number between r1 and r2 goes as the integral of r^-3 2 pi r dr.
    alone = RingDensity(craters=((craters((0.0,)), ()),), min_radii=1.0, max_radii=4.0)
    x, y = points(alone)
    away = np.hypot(x + 9.0, y - 2.0) / 4.0
    inner = ((away > 1.2) & (away < 1.5)).sum() / ((away > 1.5) & (away < 2.0)).sum()
    assert inner == pytest.approx((1 / 1.2 - 1 / 1.5) / (1 / 1.5 - 1 / 2), rel=0.03)
    assert away.max() < 4.1
    assert (away < 0.75).sum() == 0
    both = RingDensity(craters=((craters((0.0, 0.0)), ()),), min_radii=1.0, max_radii=3.0)
    worn = RingDensity(craters=((craters((0.0, 0.3)), ()),), min_radii=1.0, max_radii=3.0)
    equal = RingDensity(
        craters=((craters((0.0, 0.3)), ()),), min_radii=1.0, max_radii=3.0, freshness=0.0
    )
    second = [(points(density)[0] > 2.0).mean() for density in (both, worn, equal)]
    assert second[0] > 2.0 * second[1]
    assert second[2] == pytest.approx(second[0], abs=0.01)


def test_skirts_lie_around_the_objects_they_are_asked_for():
    around = surroundings()
    size = {"type": "choice", "values": [1, 3], "weights": [1, 3]}
    boulders = laid(around, name="boulders", count=8, size_m=size, apart={"gap_m": 4.5})
    around = surroundings(boulders=boulders)
    x, y = points(
        AroundDensity(of="boulders", reach=1.5, inside=0.6, min_size_m=2.0, background=0.0), around
    )
    large = boulders.scales[:, 0] > 2.0
    away = cKDTree(boulders.positions[large, :2]).query(np.stack([x, y], axis=1))[0] / 1.5
    assert 2 < large.sum() < 8
    assert away.max() <= 2.5 + 0.3
    assert away.min() >= 0.6 - 0.3
    # Within the circle as dense as beside it, and four times as dense as half-way out.
    area = [np.pi * (b * b - a * a) for a, b in ((0.7, 0.9), (1.65, 1.85))]
    dense = [((away > a) & (away < b)).sum() for a, b in ((0.7, 0.9), (1.65, 1.85))]
    assert (dense[0] / area[0]) / (dense[1] / area[1]) == pytest.approx(4.0, rel=0.15)


def test_pairs_in_thomas_clusters_are_as_close_as_the_process_says():
    sigma, parents, x, y = 0.6, 60, [], []
    density = {"type": "clusters", "sigma_m": sigma, "parents_per_m2": parents / 1280.0}
    close, expected = 0.0, 0.0
    for seed in range(40):
        drawn = plan(count=600, density=density, seed=seed)
        around = surroundings()
        places = candidates_on(around.surface.field, drawn.density, (), around, "rocks")
        x, y, _ = places.at(drawn.position_u)
        inside = (np.abs(x) < 18) & (np.abs(y) < 14)
        tree = cKDTree(np.stack([x, y], axis=1))
        found = tree.query_ball_point(np.stack([x, y], axis=1)[inside], 1.0, return_length=True)
        close += (found - 1).sum()
        # Ripley's K of a Thomas process: pi r^2 + (1 - exp(-r^2 / 4 sigma^2)) / kappa.
        k = np.pi + (1.0 - np.exp(-1.0 / (4.0 * sigma * sigma))) * 1280.0 / parents
        expected += inside.sum() * (600 / 1280.0) * k
    # Conditioned on the count, and cut at four sigma: some per cent.
    assert close / expected == pytest.approx(1.0, abs=0.1)


def test_parents_are_a_poisson_process_and_more_of_them_leave_the_first():
    per = {"type": "clusters", "sigma_m": 1.0, "parents_per_m2": 0.05}
    counts = [len(plan(count=1, density=per, seed=seed).density.x_m) for seed in range(300)]
    mean = 0.05 * 48 * 40
    assert np.mean(counts) == pytest.approx(mean, abs=4 * np.sqrt(mean / 300))
    assert np.var(counts) == pytest.approx(mean, rel=0.35)
    few, many = (
        plan(count=1, density={"type": "clusters", "sigma_m": 1.0, "parents": n}).density
        for n in (10, 30)
    )
    assert np.array_equal(few.x_m, many.x_m[: len(few.x_m)])


def test_clusters_much_finer_than_the_grid_are_as_narrow_as_asked():
    x, y = points(ClusterDensity(np.array([3.0]), np.array([-2.0]), 0.05, 0.0))
    assert x.std() == pytest.approx(0.05, rel=0.03)
    assert y.mean() == pytest.approx(-2.0, abs=0.01)


@pytest.mark.parametrize("reach", [0.5, 3.0, 100.0])
def test_the_nearest_circle_is_that_of_brute_force(reach):
    rng = np.random.default_rng(2)
    x, y, radius = rng.uniform(-22, 22, 50), rng.uniform(-18, 18, 50), rng.uniform(0, 4, 50)
    lattice = PlanLattice(-20.0, -16.0, 0.8, 0.5, (64, 50))
    found = nearest(lattice, Circles(x, y, radius), reach)
    px, py = lattice.points()
    wanted = (np.hypot(px[:, None] - x, py[:, None] - y) - radius).min(axis=1)
    assert np.allclose(found.ravel(), np.minimum(wanted, reach), atol=1e-12)


def test_a_density_that_is_nowhere_is_refused():
    for density in (
        ClusterDensity(np.array([500.0]), np.array([0.0]), 1.0, 0.0),
        RingDensity(craters=(), min_radii=1.0, max_radii=5.0, freshness=1.0, background=0.0),
    ):
        with pytest.raises(SceneError, match="objects/rocks: its density is zero everywhere"):
            points(density)
    # A background is then all there is.
    x, _ = points(ClusterDensity(np.array([500.0]), np.array([0.0]), 1.0, 0.1))
    assert x.std() == pytest.approx(40 / np.sqrt(12), rel=0.01)


def test_too_many_parents_are_refused_with_their_number():
    with pytest.raises(SceneError, match=r"objects/rocks/density: .* parents are expected"):
        plan(count=1, density={"type": "clusters", "sigma_m": 1e6, "parents_per_m2": 1.0})
