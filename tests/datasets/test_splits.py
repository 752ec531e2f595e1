"""Splits: whole batches, as many as asked, the same every time."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from scenec.datasets.splits import ALL, assign, parse_splits
from scenec.schemas.errors import OutputError
from scenec.testing.examples import examples

names = st.lists(st.text("abcdefghij", min_size=1, max_size=4), min_size=1, max_size=5, unique=True)
batch_sets = st.sets(st.integers(0, 10_000), min_size=1, max_size=80)


@st.composite
def shares(draw: st.DrawFn) -> dict[str, float | range]:
    keys = draw(names)
    weights = [draw(st.integers(1, 100)) for _ in keys]
    return {key: weight / sum(weights) for key, weight in zip(keys, weights, strict=True)}


@examples(300)
@given(batch_sets, shares(), st.integers(0, 2**64 - 1), st.randoms(use_true_random=False))
def test_every_batch_is_in_one_split_and_sizes_are_within_one_of_the_shares(
    batches, splits, seed, random
):
    if len(batches) < len(splits):
        with pytest.raises(OutputError, match="a terrain is never in two splits"):
            assign(sorted(batches), splits, seed)
        return
    found = assign(sorted(batches), splits, seed)
    assert set(found) == batches
    sizes = {name: list(found.values()).count(name) for name in splits}
    assert sum(sizes.values()) == len(batches)
    exact = {name: float(share) * len(batches) for name, share in splits.items()}
    # A split that its share would leave empty gets one batch, which others have to give.
    lifted = sum(max(0.0, 1.0 - value) for value in exact.values())
    for name, size in sizes.items():
        assert size >= 1
        assert size < max(exact[name], 1.0) + 1.0 + 1e-9
        assert size > exact[name] - 1.0 - lifted - 1e-9
    shuffled = list(batches)
    random.shuffle(shuffled)
    assert assign(shuffled, splits, seed) == found


KNOWN = {"val": 8, "test": 3}


def test_the_assignment_is_the_same_on_every_machine():
    found = assign(range(10), parse_splits("train=0.8,val=0.1,test=0.1"), seed=0)
    # The last of ten by `printf 0/$batch | sha256sum`.
    assert {name: batch for batch, name in found.items() if name != "train"} == KNOWN
    other = assign(range(10), parse_splits("train=0.8,val=0.1,test=0.1"), seed=1)
    assert other != found


@given(batch_sets)
def test_without_splits_all_are_in_one(batches):
    assert assign(sorted(batches), {}) == dict.fromkeys(sorted(batches), ALL)


def test_ranges_take_the_batches_they_name_and_leave_the_others_out():
    splits = parse_splits("train=0:3, test=5:9")
    assert assign([0, 1, 2, 3, 4, 5, 6], splits) == {
        **dict.fromkeys([0, 1, 2], "train"),
        **dict.fromkeys([5, 6], "test"),
    }
    with pytest.raises(OutputError, match="holds none of the batches"):
        assign([0, 1], splits)
    with pytest.raises(OutputError, match="batch 1 would be in a and in b"):
        assign([0, 1], parse_splits("a=0:2,b=1:3"))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "expected NAME=SHARE"),
        ("train", "expected NAME=SHARE"),
        ("train=", "expected a share"),
        ("=1", "expected NAME=SHARE"),
        ("a/b=1", "expected NAME=SHARE"),
        ("train=0.8,val=0.1", "add up to 0.9"),
        ("train=1,train=0", "twice"),
        ("train=0.5,val=0:3", "not both"),
        ("train=nan", "expected a share"),
        ("train=inf", "expected a share"),
        ("train=0", "expected a share"),
        ("train=-1", "expected a share"),
        ("train=3:3", "expected a share"),
        ("train=-1:3", "expected a share"),
        ("train=a:b", "expected a share"),
    ],
)
def test_what_is_no_split_is_said(text, words):
    with pytest.raises(OutputError, match=words):
        parse_splits(text)


@given(shares())
def test_splits_are_read_as_they_are_written(splits):
    text = ",".join(f"{name}={share!r}" for name, share in splits.items())
    read = parse_splits(text)
    assert list(read) == list(splits)
    assert all(math.isclose(read[n], splits[n]) for n in splits)
