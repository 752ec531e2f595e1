"""Pictures have the codes of the definition, and are counted as NumPy counts them."""

from __future__ import annotations

import numpy as np
import pytest

from scenec.schemas.picture import BLACK, BURNT, LUMINANCE, develop, develop_exactly, tally


@pytest.mark.parametrize("exposure_ev", [0.0, -7.3, 11.25, 40.0, 900.0])
def test_codes_are_those_of_the_definition_to_the_bit(exposure_ev: float):
    rng = np.random.default_rng(1)
    scale = 2.0 ** min(-exposure_ev, 120.0)
    radiance = (np.exp2(rng.uniform(-20, 6, (700, 300, 3))) * scale).astype(np.float32)
    radiance[0] *= -1
    # Subnormal, most and least, nothing, and no numbers.
    special = [0.0, -0.0, 1e-45, 3e38, np.inf, -np.inf, np.nan]
    radiance[1, : len(special), 0] = special
    with np.errstate(over="ignore"):
        exact, found = (of(radiance, exposure_ev) for of in (develop_exactly, develop))
    np.testing.assert_array_equal(found, exact)


def test_codes_change_where_those_of_the_definition_do():
    ascending = np.arange(0x38000000, 0x40800000, 997, dtype=np.int32).view(np.float32)
    steps = np.flatnonzero(np.diff(develop(ascending, 0.5).astype(int)))
    around = ascending.view(np.int32)[steps][:, None] + np.arange(0, 998)
    floats = around.astype(np.int32).view(np.float32)
    assert len(steps) > 200
    np.testing.assert_array_equal(develop(floats, 0.5), develop_exactly(floats, 0.5))


def test_a_tally_counts_surfaces_alone():
    rng = np.random.default_rng(2)
    pixels = rng.choice(np.array([0, 1, 2, 128, 253, 254, 255], np.uint8), (200, 90, 3))
    radiance = rng.exponential(3.0, (200, 90, 3)).astype(np.float32)
    surfaces = rng.random((200, 90)) < 0.4
    found = tally(pixels, radiance, surfaces)
    seen = pixels[surfaces]
    assert found.surfaces == surfaces.sum()
    assert found.black == (seen < BLACK).all(axis=1).sum() > 0
    assert found.burnt == (seen >= BURNT).all(axis=1).sum() > 0
    level = (radiance[surfaces].astype(np.float64) * LUMINANCE).sum(axis=1)
    assert found.mean_luminance == pytest.approx(level.mean(), rel=1e-14)
    nothing = tally(pixels, radiance, np.zeros_like(surfaces))
    assert (nothing.surfaces, nothing.mean_luminance) == (0, 0.0)
