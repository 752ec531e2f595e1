"""Randomness keyed by name."""

from __future__ import annotations

import hashlib
import itertools
import struct

import numpy as np
import pytest
import scipy.stats
from hypothesis import given
from hypothesis import strategies as st

from scenec.compiler.distributions.streams import Streams
from scenec.schemas.errors import ScenecError

_SEEDS = st.integers(0, 2**64 - 1)


@given(_SEEDS, st.text(max_size=12), st.none() | st.integers(0, 10**6), st.integers(0, 40))
def test_more_numbers_of_a_stream_begin_with_the_same_ones(seed, path, sample, n):
    streams = Streams(seed, 3)
    few = streams.uniforms(path, n, sample)
    # Another draw in between changes nothing.
    streams.uniforms(path + "/other", 5)
    many = streams.uniforms(path, n + 13, sample)
    assert few.dtype == np.float64
    assert many.shape == (n + 13,)
    assert np.array_equal(few, many[:n])
    assert ((many >= 0.0) & (many < 1.0)).all()


def test_seed_batch_sample_and_path_each_make_another_stream():
    seen = set()
    for seed, batch, sample, path in itertools.product(
        (0, 1, 2**64 - 1), (0, 1, 256), (None, 0, 1, 256), ("", "a", "a/b", "ab", "a/0", "a/1")
    ):
        streams = Streams(seed, batch)
        seen.add(tuple(streams.uniforms(path, 2, sample)))
        seen.add(streams.key(path, sample))
    assert len(seen) == 2 * 3 * 3 * 4 * 6


def test_a_stream_is_numpys_philox_under_the_documented_key():
    message = struct.pack("<QQ?Q", 7, 2, True, 5) + b"light/sun"
    digest = hashlib.blake2b(message, digest_size=16, person=b"scenec/uniforms").digest()
    generator = np.random.Generator(np.random.Philox(key=int.from_bytes(digest, "little")))
    assert np.array_equal(Streams(7, 2).uniforms("light/sun", 9, 5), generator.random(9))


def test_streams_keep_their_numbers_from_version_to_version():
    assert Streams(0, 0).uniforms("objects/rocks/size_m", 2).tolist() == [
        0.1108012910318057,
        0.4112570101378843,
    ]
    assert Streams(0, 0).key("terrain/relief/1") == 11642956698609688387


def test_a_stream_is_uniform_and_its_neighbors_are_independent():
    streams = Streams(0, 0)
    numbers = np.stack([streams.uniforms("x", 5000, sample) for sample in range(8)])
    assert scipy.stats.kstest(numbers.ravel(), "uniform").pvalue > 1e-4
    correlation = np.corrcoef(numbers) - np.eye(8)
    assert np.abs(correlation).max() < 5.0 / np.sqrt(5000)


def test_keys_use_all_64_bits():
    keys = [Streams(0, 0).key(str(i)) for i in range(200)]
    assert all(0 <= key < 2**64 for key in keys)
    bits = np.array([[key >> bit & 1 for bit in range(64)] for key in keys]).mean(axis=0)
    assert bits.min() > 0.3
    assert bits.max() < 0.7


@pytest.mark.parametrize("seed", [-1, 2**64])
def test_a_seed_out_of_range_is_refused(seed):
    with pytest.raises(ScenecError, match="expected a whole number from 0 to 18446744073709551615"):
        Streams(seed, 0)
