import pytest
from hypothesis import given
from hypothesis import strategies as st

from bidexdata.loaders.samplers import EpochSampler

lengths = st.integers(0, 50)
seeds = st.integers(0, 2**31)


@given(lengths, seeds, st.integers(0, 5))
def test_seed_and_epoch_decide_the_order(length, seed, epoch):
    a, b = EpochSampler(length, seed), EpochSampler(length, seed)
    a.set_epoch(epoch)
    for _ in range(epoch):
        list(b)
    first = list(a)
    assert first == list(b)
    assert sorted(first) == list(range(length))


@given(lengths, seeds, st.integers(1, 4))
def test_ranks_share_rows_without_overlap(length, seed, world):
    parts = [list(EpochSampler(length, seed, rank=r, world_size=world)) for r in range(world)]
    assert {len(p) for p in parts} == {length // world}
    joined = [i for p in parts for i in p]
    assert len(joined) == len(set(joined))


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


def test_epochs_differ():
    sampler = EpochSampler(100)
    assert list(sampler) != list(sampler)


def test_ranks_outside_the_world_are_refused():
    with pytest.raises(ValueError, match="rank"):
        EpochSampler(3, rank=2, world_size=2)
