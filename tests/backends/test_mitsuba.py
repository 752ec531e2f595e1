"""What is special to Mitsuba, and its conformance."""

from __future__ import annotations

import os
import subprocess
import sys

import numpy as np
import pytest

from scenec.backends.mitsuba import Mitsuba, variant
from scenec.backends.mitsuba.adapter import MAX_WAVEFRONT, mix, split_samples
from scenec.backends.mitsuba.emitter import dome_dict
from scenec.backends.picture.sky import combine, lookup, texel_directions
from scenec.backends.stage.scene import Dome
from scenec.backends.testing import Conformance
from scenec.backends.testing import scenes as ms


class TestMitsuba(Conformance):
    """All of it, within the default tolerance."""

    backend = Mitsuba


@pytest.mark.parametrize("rotation", range(2))
def test_mitsubas_sky_is_the_shared_lookup_in_every_direction(tmp_path, rotation):
    rng = np.random.default_rng(4)
    file = ms.write_latlong(tmp_path / "sky.exr", rng.uniform(0.1, 5, (7, 12, 3)))
    to_world = ms.DOME_Z_UP if rotation == 0 else ms.rotation(rng)
    sky = combine((Dome(file, np.array([1.0, 2.0, 0.5]), to_world),))
    assert sky is not None
    mi = variant.load_mitsuba()
    directions = rng.normal(size=(5000, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    # Centers of texels too, and the neighborhoods of the poles; at a pole itself longitude, and
    # with it the lookup, is undefined.
    texels = texel_directions(7, 12).reshape(-1, 3)
    poles = np.array([[0.01, 1, 0.02], [-0.02, 1, 0.01], [0.01, -1, -0.02], [-0.01, -1, 0.02]])
    near = poles / np.linalg.norm(poles, axis=1)[:, None]
    directions = np.concatenate([directions, texels @ to_world.T, near @ to_world.T])
    emitter = mi.load_dict(dome_dict(mi, sky))
    si = mi.SurfaceInteraction3f()
    si.wi = mi.Vector3f(np.ascontiguousarray(-directions.T, np.float32))
    theirs = np.array(emitter.eval(si)).T
    np.testing.assert_allclose(theirs, lookup(sky, directions), rtol=2e-4, atol=2e-4)


@pytest.mark.parametrize("spp", [1, 2, 7, 24, 64, 1000])
def test_sample_counts_split_into_passes_that_fit_and_add_up(spp):
    for pixels in (100, 640 * 480, 1 << 24, 1 << 26):
        parts = split_samples(spp, pixels, MAX_WAVEFRONT)
        assert sum(parts) == spp
        assert min(parts) >= 1
        assert max(parts) == 1 or (max(parts) - 1) * pixels < MAX_WAVEFRONT


def test_seeds_of_parts_are_all_different():
    seeds = {mix(seed, half, part) for seed in range(20) for half in range(2) for part in range(9)}
    assert len(seeds) == 360


def test_libllvm_is_found_in_the_wheel_without_importing_it():
    code = (
        "import sys; from scenec.backends.mitsuba.variant import wheel_llvm; p = wheel_llvm(); "
        "assert p and p.is_file(), p; assert not any('llvm' in m for m in sys.modules if m in "
        "('llvm', 'llvm_nanobind')), 'imported'"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


@pytest.mark.parametrize(
    ("setting", "told"),
    [
        ((variant.VARIANT_VARIABLE, "no_such_variant"), "no_such_variant"),
        ((variant.VARIANT_VARIABLE, "scalar_rgb"), "of LLVM or CUDA"),
        ((variant.LLVM_VARIABLE, "/no/such/library"), "Mend it with: pip install llvm-nanobind"),
    ],
)
def test_an_unusable_variant_is_said_in_one_line(setting, told):
    code = (
        "from scenec.backends.mitsuba import Mitsuba\n"
        "from scenec.schemas.errors import BackendError\n"
        "try:\n    Mitsuba()\nexcept BackendError as error:\n    print(error)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, setting[0]: setting[1]},
        capture_output=True,
        text=True,
        check=True,
    )
    assert told in done.stdout
    assert len(done.stdout.splitlines()) == 1
