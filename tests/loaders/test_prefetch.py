import threading
import time

import pytest

from bidexdata.loaders import Prefetch


def test_everything_comes_in_order_and_again():
    source = Prefetch(list(range(20)), depth=3)
    assert list(source) == list(range(20))
    assert list(source) == list(range(20))
    assert len(source) == 20


def test_it_reads_no_further_ahead_than_asked():
    read = []

    def items():
        for k in range(100):
            read.append(k)
            yield k

    with Prefetch(items(), depth=2) as source:
        assert next(iter(source)) == 0
        time.sleep(0.2)
        assert len(read) <= 1 + 2 + 1  # given, waiting, and the one that waits for room


def test_an_exception_comes_where_its_item_would_have():
    def items():
        yield 1
        raise KeyError("lost")

    rows = iter(Prefetch(items()))
    assert next(rows) == 1
    with pytest.raises(KeyError, match="lost"):
        next(rows)


def test_threads_end_when_it_is_closed_or_left():
    before = threading.active_count()
    source = Prefetch(iter(int, 1), depth=1)  # never ends
    next(iter(source))
    rows = iter(source)
    next(rows)
    source.close()
    assert threading.active_count() == before
    for _ in Prefetch(iter(int, 1)):
        break
    assert threading.active_count() == before


def test_a_source_that_is_read_in_a_thread_overlaps_with_the_reader():
    def slow():
        for k in range(5):
            time.sleep(0.05)
            yield k

    start = time.perf_counter()
    for _ in Prefetch(slow()):
        time.sleep(0.05)
    # One after the other would be 0.5 s.
    assert time.perf_counter() - start < 0.45


def test_a_depth_of_none_is_refused():
    with pytest.raises(ValueError, match="depth"):
        Prefetch([], depth=0)
