import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bidexdata.loaders.permutation import permuted, uniform

LAW = settings(deadline=None, max_examples=60)  # a machine that does other things is slow at times


@LAW
@given(st.integers(0, 300), st.integers(-(2**40), 2**40), st.integers(0, 9))
def test_all_positions_give_all_things_once(length, seed, epoch):
    found = permuted(np.arange(length), length, seed, epoch)
    assert sorted(found.tolist()) == list(range(length))


@pytest.mark.parametrize("length", [1, 2, 3, 4, 5, 16, 17, 65_536, 65_537, 1_000_003])
def test_it_is_a_permutation_at_powers_of_two_and_beside_them(length):
    found = permuted(np.arange(length), length, 7)
    assert np.array_equal(np.sort(found), np.arange(length))


def test_a_block_of_a_large_order_needs_no_other():
    length, at = 100_000_000, np.array([0, 5, 99_999_999])
    alone = [int(permuted(at[i : i + 1], length, 3)[0]) for i in range(3)]
    assert permuted(at, length, 3).tolist() == alone
    assert all(0 <= i < length for i in alone)


def test_lengths_and_keys_may_differ_by_position():
    at, lengths, keys = np.array([0, 1, 2, 0, 1]), np.array([3, 3, 3, 2, 2]), np.array([4, 4, 4, 9, 9])  # fmt: skip
    found = permuted(at, lengths, 1, keys)
    assert found[:3].tolist() == permuted(np.arange(3), 3, 1, 4).tolist()
    assert found[3:].tolist() == permuted(np.arange(2), 2, 1, 9).tolist()


def test_orders_look_random():
    # Over many keys, the first of ten things is each of them about as often, and neighbours of the
    # order are neighbours of the things no more often than by chance (0.2).
    keys = np.arange(3000)
    first = permuted(np.zeros(3000, np.int64), 10, keys)
    assert np.abs(np.bincount(first, minlength=10) - 300).max() < 5 * np.sqrt(300)
    order = permuted(np.arange(100_000), 100_000, 0)
    assert np.mean(np.abs(np.diff(order)) == 1) < 1e-3
    assert abs(np.corrcoef(order[:-1], order[1:])[0, 1]) < 0.02


def test_numbers_drawn_for_rows_are_uniform_and_a_function_of_what_they_are_drawn_by():
    rows = np.arange(20_000)
    drawn = uniform(1, 2, 3, rows)
    assert np.array_equal(drawn[100:110], uniform(1, 2, 3, rows[100:110]))
    assert drawn.min() >= 0
    assert drawn.max() < 1
    # The mean of n uniform numbers deviates by 0.289 / sqrt(n).
    assert abs(drawn.mean() - 0.5) < 5 * 0.289 / np.sqrt(len(rows))
    assert not np.array_equal(drawn, uniform(1, 2, 4, rows))
