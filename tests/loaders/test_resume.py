"""Training that stops in mid-epoch goes on with exactly what is left."""

from itertools import islice

import numpy as np
import pytest
from batches_alike import EVERYTHING, same_batches

from bidexdata.loaders import BiDexDataset, EpochSampler, ObjectSampler, ResumableLoader

# Forked: workers that are spawned import torch first, and test_dataset has those.
WORKERS = {"num_workers": 2, "multiprocessing_context": "fork"}


@pytest.fixture(scope="module")
def data(floating):
    return BiDexDataset(floating, split=None, fields=("grasp_id",), cloud=None)


def loader(data, world=1, rank=0, batch=2, **options):
    return ResumableLoader(data, batch, EpochSampler(len(data), 5, rank=rank, world_size=world), **options)  # fmt: skip


def ids(batches):
    return [i for b in batches for i in b["grasp_id"]]


@pytest.mark.parametrize("options", [{}, {"prefetch": 2}, WORKERS], ids=["0", "thread", "2"])
def test_the_remaining_stream_is_that_of_a_run_that_never_stopped(data, options):
    whole = [b["grasp_id"] for b in loader(data)]
    first = loader(data, **options)
    for batch in islice(first, 3):
        had = batch["grasp_id"]
    assert had == whole[2]
    again = loader(data)
    again.load_state_dict(first.state_dict())
    assert [b["grasp_id"] for b in again] == whole[3:]
    # The loader itself goes on too, and then begins the next epoch.
    assert ids(first) == ids(loader(data))[6:]
    second = ids(first)
    assert sorted(second) == sorted(ids(loader(data)))
    assert second != ids(loader(data))


@pytest.mark.parametrize("world", [1, 2, 3])
@pytest.mark.parametrize("after", [1, 2, 3])
def test_ranks_resume_on_another_number_of_ranks(data, world, after):
    order = ids(loader(data, batch=1))
    ranks = [loader(data, world, rank) for rank in range(world)]
    had = []
    for rank in ranks:
        had += ids(islice(rank, 2))
    assert sorted(had) == sorted(order[: 4 * world])
    state = ranks[0].state_dict()
    assert all(rank.state_dict() == state for rank in ranks)
    rest = []
    for rank in range(after):
        resumed = loader(data, after, rank)
        resumed.load_state_dict(state)
        rest += ids(resumed)
    left = order[4 * world :]
    assert sorted(rest) == sorted(left[: len(left) // after * after])


@pytest.mark.parametrize("drop_last", [True, False])
def test_the_last_batch_ends_the_epoch(data, drop_last):
    source = loader(data, batch=7, drop_last=drop_last)
    count = len(data) // 7 if drop_last else -(-len(data) // 7)
    assert len(source) == count
    for number, _ in enumerate(source, 1):
        assert (source.state_dict()["epoch"] == 1) == (number == count)
    assert source.state_dict() == {"seed": 5, "epoch": 1, "emitted": 0}


def test_grouped_orders_resume_too(data):
    def grouped():
        return ResumableLoader(data, 4, ObjectSampler(data.object_rows, 4, seed=1))

    whole, source = ids(grouped()), grouped()
    for _ in islice(source, 2):
        pass
    again = grouped()
    again.load_state_dict(source.state_dict())
    assert ids(again) == whole[8:]


def test_a_prefetched_run_counts_what_was_handed_out_only(data):
    source = loader(data, prefetch=3)
    batches = iter(source)
    next(batches)
    assert source.state_dict()["emitted"] == 2
    batches.close()


@pytest.mark.parametrize("batch", [3, 8, 4096])
@pytest.mark.parametrize("options", [{}, {"augment": ("yaw",)}, {"clouds": "unique"}, {"where": "suc_f"}], ids=str)  # fmt: skip
def test_batches_cut_from_many_rows_are_those_that_are_read_alone(floating, batch, options):
    data = BiDexDataset(floating, points=16, fields=EVERYTHING, **options)
    order = EpochSampler(len(data), 2).order()
    found = list(ResumableLoader(data, batch, EpochSampler(len(data), 2)))
    parts = [order[k : k + batch] for k in range(0, len(order), batch)]
    assert same_batches(found, [data.__getitems__(part).stacked for part in parts])
    by_pytorch = ResumableLoader(data, batch, EpochSampler(len(data), 2), num_workers=0)
    assert same_batches(found, list(by_pytorch))


def test_no_batch_writes_to_another(floating):
    data = BiDexDataset(floating, points=16)
    batches = list(ResumableLoader(data, 3, EpochSampler(len(data), 2)))
    expected = list(ResumableLoader(data, 3, EpochSampler(len(data), 2)))
    for batch in batches[::2]:
        for values in batch.values():
            values.zero_()
    assert same_batches(batches[1::2], expected[1::2])
    assert same_batches(list(ResumableLoader(data, 3, EpochSampler(len(data), 2))), expected)


@pytest.mark.parametrize("rows", [1, 5, 7, 100])
def test_chunks_are_the_order_that_iterating_gives(data, rows):
    a, b = EpochSampler(len(data), 3), EpochSampler(len(data), 3)
    chunks = list(a.chunks(rows))
    assert np.concatenate(chunks).tolist() == list(b)
    assert all(len(chunk) == rows for chunk in chunks[:-1])
    assert a.state_dict() == b.state_dict()
