"""A cache by keys: a value is made once while it is kept, and the one unused longest goes first."""

from __future__ import annotations

from threading import Barrier, Thread

import pytest

from bidexdata.arms.keyed_cache import KeyedCache


def test_a_value_is_made_once_and_what_was_asked_for_last_is_kept():
    made: list[str] = []
    cache = KeyedCache[str](2)

    def ask(key: str) -> str:
        return cache.get(key, lambda: made.append(key) or f"<{key}>")

    assert [ask(k) for k in "abab"] == ["<a>", "<b>"] * 2
    assert made == ["a", "b"]
    ask("a")
    ask("c")  # b was not asked for longest
    assert [ask("a"), ask("c")] == ["<a>", "<c>"]
    assert made == ["a", "b", "c"]
    assert ask("b") == "<b>"
    assert made == ["a", "b", "c", "b"]


def test_what_fails_is_not_kept():
    cache = KeyedCache[int](1)
    with pytest.raises(ZeroDivisionError):
        cache.get("a", lambda: 1 // 0)
    assert cache.get("a", lambda: 2) == 2


def test_threads_that_ask_at_once_are_given_the_same():
    cache, gate, found = KeyedCache[object](1), Barrier(2), []

    def ask() -> None:
        def make() -> object:
            gate.wait(timeout=10)  # both are making it
            return object()

        found.append(cache.get("a", make))

    threads = [Thread(target=ask) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert found[0] is found[1]
