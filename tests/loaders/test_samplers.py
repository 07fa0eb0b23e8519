import tracemalloc
from itertools import islice

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bidexdata.loaders.samplers import EpochSampler, ObjectSampler

LAW = settings(deadline=None, max_examples=60)  # a machine that does other things is slow at times
lengths = st.integers(0, 50)
seeds = st.integers(0, 2**31)
counts = st.lists(st.integers(0, 9), max_size=8).map(lambda c: np.array(c, np.int64))


def emitted(samplers, each):
    """What all ranks have had when each has had `each` samples."""
    return [i for s in samplers for i in islice(s, each)]


@LAW
@given(lengths, seeds, st.integers(0, 5))
def test_seed_and_epoch_decide_the_order(length, seed, epoch):
    a, b = EpochSampler(length, seed), EpochSampler(length, seed)
    a.set_epoch(epoch)
    for _ in range(epoch):
        list(b)
    first = list(a)
    assert first == list(b)
    assert sorted(first) == list(range(length))


@LAW
@given(lengths, seeds, st.integers(1, 4))
def test_ranks_share_rows_without_overlap(length, seed, world):
    parts = [list(EpochSampler(length, seed, rank=r, world_size=world)) for r in range(world)]
    assert {len(p) for p in parts} == {length // world}
    joined = [i for p in parts for i in p]
    assert len(joined) == len(set(joined))


@LAW
@given(st.integers(1, 50), seeds, st.data())
def test_resuming_goes_on_exactly(length, seed, data):
    stop = data.draw(st.integers(0, length - 1))
    sampler = EpochSampler(length, seed)
    whole = list(EpochSampler(length, seed))
    rows = iter(sampler)
    begun = [next(rows) for _ in range(stop)]
    resumed = EpochSampler(length)
    resumed.load_state_dict(sampler.state_dict())
    assert begun + list(resumed) == whole
    ahead = EpochSampler(length)
    ahead.load_state_dict(sampler.state_dict(consumed=0))
    assert list(ahead) == whole
    assert ahead.epoch == 1


@LAW
@given(lengths, seeds, st.sampled_from([1, 2, 3]), st.sampled_from([1, 2, 3]), st.data())
def test_what_is_left_does_not_depend_on_how_many_ranks_there_were(
    length, seed, world, after, data
):
    whole = list(EpochSampler(length, seed))
    each = data.draw(st.integers(0, length // world))
    ranks = [EpochSampler(length, seed, rank=r, world_size=world) for r in range(world)]
    had = emitted(ranks, each)
    assert sorted(had) == sorted(whole[: each * world])
    # A rank whose epoch is over has begun the next one.
    states = [s.state_dict(each) for s in ranks]
    assert all(state == states[0] for state in states)
    if states[0]["epoch"] == 1:
        return
    resumed = [EpochSampler(length, rank=r, world_size=after) for r in range(after)]
    for sampler in resumed:
        sampler.load_state_dict(states[0])
    rest = [list(s) for s in resumed]
    left = whole[each * world :]
    assert [len(r) for r in rest] == [len(left) // after] * after
    assert [row for turn in zip(*rest, strict=True) for row in turn] == left[: len(rest[0]) * after]


@LAW
@given(counts, st.integers(1, 4), seeds, st.integers(1, 3))
def test_grouped_ranks_share_rows_without_overlap(counts, group, seed, world):
    parts = [list(ObjectSampler(counts, group, seed, rank=r, world_size=world)) for r in range(world)]  # fmt: skip
    joined = [i for p in parts for i in p]
    assert len(joined) == len(set(joined))
    assert {len(p) for p in parts} == {len(parts[0])}
    if world == 1:
        assert sorted(joined) == list(range(counts.sum()))


def test_rows_of_an_object_follow_each_other_in_groups():
    counts = np.array([7, 1, 12, 4])
    owner = np.repeat(np.arange(4), counts)
    order = list(ObjectSampler(counts, 4, seed=3))
    runs = np.split(owner[order], np.flatnonzero(np.diff(owner[order])) + 1)
    # Pieces of an object may meet, so a run is one piece or more; no piece is torn.
    assert sum(len(r) % 4 != 0 for r in runs) <= 3
    assert len(runs) <= 2 + 1 + 3 + 1
    assert order != list(ObjectSampler(counts, 4, seed=4))


@LAW
@given(counts, st.integers(1, 4), seeds, st.data())
def test_grouped_samplers_resume_at_any_place(counts, group, seed, data):
    whole = list(ObjectSampler(counts, group, seed))
    place = data.draw(st.integers(0, len(whole)))
    sampler = ObjectSampler(counts, group)
    sampler.load_state_dict({"seed": seed, "epoch": 0, "emitted": place})
    assert list(sampler) == whole[place:]
    # The same sampler again, of another seed: nothing is left of the first.
    sampler.load_state_dict({"seed": seed + 1, "epoch": 0, "emitted": 0})
    assert list(sampler) == list(ObjectSampler(counts, group, seed + 1))


def test_large_grouped_orders_are_permutations_across_blocks():
    counts = np.full(3000, 77)
    order = ObjectSampler(counts, 16, seed=1).order()
    assert np.array_equal(np.sort(order), np.arange(counts.sum()))


def test_ranks_that_stop_within_a_group_cannot_be_resumed():
    sampler = ObjectSampler(np.array([40]), 4, world_size=2)
    next(iter(sampler))
    with pytest.raises(ValueError, match="multiple of 4"):
        sampler.state_dict(3)


def test_memory_does_not_grow_with_the_number_of_rows():
    tracemalloc.start()
    rows = iter(EpochSampler(100_000_000))
    assert len({next(rows) for _ in range(1000)}) == 1000
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 20e6  # a list of the order would be 800 MB


def test_epochs_differ():
    sampler = EpochSampler(100)
    assert list(sampler) != list(sampler)


def test_ranks_outside_the_world_are_refused():
    with pytest.raises(ValueError, match="rank"):
        EpochSampler(3, rank=2, world_size=2)
    with pytest.raises(ValueError, match="group"):
        ObjectSampler(np.array([1]), 0)
