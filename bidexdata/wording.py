"""Numbers with the word for what they count, as a person writes them."""

from __future__ import annotations

from collections.abc import Sequence


def counted(n: int, one: str, many: str = "") -> str:
    """A number and its noun, singular or plural.

    Args:
        n: How many.
        one: The words for one, such as `task` or `task is`.
        many: Those for any other number; `one` with an s when empty.

    >>> counted(1, "row"), counted(0, "row"), counted(2, "task is", "tasks are")
    ('1 row', '0 rows', '2 tasks are')
    """
    return f"{n} {one if n == 1 else many or one + 's'}"


def listed(words: Sequence[str], first: int = 3) -> str:
    """The first of some words, and how many more there are.

    >>> listed(["a", "b"]), listed(["a", "b", "c", "d", "e"])
    ('a, b', 'a, b, c and 2 more')
    """
    more = f" and {len(words) - first} more" if len(words) > first else ""
    return ", ".join(words[:first]) + more


def share(value: float | None, missing: str = "-") -> str:
    """A share in percent, or the word for one that there is not.

    >>> share(0.875), share(None)
    ('87.5 %', '-')
    """
    return missing if value is None else f"{100 * value:.1f} %"
