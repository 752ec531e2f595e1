"""Seeds of noise: the same from version to version, and no two parts of a job share one."""

from itertools import product

import numpy as np
import pytest

from scenec.backends.noise_seeds import (
    frame_seed,
    half_seed,
    metering_paths,
    metering_places,
    round_seed,
    sub_frame_number,
    sub_frame_seed,
    tile_seed,
    view_seed,
)

BATCHES = [f"batch_{number:04}" for number in range(5)]
CAMERAS = ["front", "left", "right"]


def test_seeds_keep_their_numbers_from_version_to_version() -> None:
    assert frame_seed(7, "batch_0001", "left", 3) == 4056235620
    assert round_seed(7, 3) == 2308433916
    assert half_seed(7, 1) == 2905889783
    assert sub_frame_seed(7, 1, 3) == 417574878
    assert sub_frame_number(7, 1, "u/3") == 0.2932802891216276
    assert view_seed(7, 3) == 2445500232
    assert tile_seed(7, 3) == 3668339994
    assert metering_places(3).random() == 0.9270410920401326
    assert metering_paths(3).random() == 0.45918480252793514


def test_frames_rounds_and_halves_of_a_job_share_no_seed() -> None:
    frames = [frame_seed(*names) for names in product(range(2), BATCHES, CAMERAS, range(20))]
    rounds = [round_seed(seed, number) for seed in frames for number in range(4)]
    halves = [half_seed(seed, half) for seed in frames + rounds for half in range(3)]
    drawn = frames + rounds + halves
    assert len(set(drawn)) == len(drawn) == 600 * 5 + 600 * 5 * 3


def test_the_parts_of_a_frame_share_no_seed() -> None:
    seed = frame_seed(0, *"ab", 0)
    halves = {half_seed(part(seed, i), h) for i in range(64) for part in (view_seed, tile_seed)
              for h in range(2)}  # fmt: skip
    # The first view and the first tile have the frame's own seed: a picture has one or the other.
    assert len(halves) == 2 * (2 * 64 - 1)
    views = {tile_seed(view_seed(seed, view), tile) for view in range(6) for tile in range(500)}
    assert len(views) == 6 * 500
    shown = {sub_frame_seed(seed, half, index) for half in range(2) for index in range(1000)}
    assert len(shown | halves) == 2000 + len(halves)


@pytest.mark.parametrize("name", ["time", "radius", "u/0", "v/0"])
def test_numbers_of_sub_frames_are_even_over_seeds(name) -> None:
    numbers = np.sort([sub_frame_number(s, h, name) for s in range(2000) for h in range(2)])
    # Kolmogorov and Smirnov's distance; above 0.0258 once in a hundred.
    assert np.abs(numbers - (np.arange(4000) + 0.5) / 4000).max() < 0.0258


def test_metering_of_samples_shares_no_numbers() -> None:
    numbers = {
        g(sample).random() for g in (metering_places, metering_paths) for sample in range(99)
    }
    assert len(numbers) == 2 * 99
