"""Which prepared objects are kept: bounds on traits, categories, near duplicates.

What is left out stays on disk and in the index with the reason, so that other bounds need no new
preparation.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from .config import SelectConfig
from .traits import unlikeness

_MOST = ("aspect", "components", "genus")
_LEAST = ("thickness",)


def has_bounds(config: SelectConfig) -> bool:
    """Whether any trait is bounded."""
    names = [f"max_{n}" for n in _MOST] + [f"min_{n}" for n in _LEAST]
    return any(getattr(config, name) is not None for name in names)


def outside(traits: Mapping[str, Any], config: SelectConfig) -> str:
    """Say which bound an object's traits break, as `aspect 12.3 > select.max_aspect 10`; or ''."""
    for name in _MOST:
        bound = getattr(config, f"max_{name}")
        if bound is not None and traits[name] > bound:
            return f"{name} {traits[name]:.4g} > select.max_{name} {bound:g}"
    for name in _LEAST:
        bound = getattr(config, f"min_{name}")
        if bound is not None and traits[name] < bound:
            return f"{name} {traits[name]:.4g} < select.min_{name} {bound:g}"
    return ""


def unwanted(category: str, config: SelectConfig) -> str:
    """Say why a category is not wanted, or ''."""
    if config.categories and category not in config.categories:
        return f"category {category!r} is not in select.categories"
    if category in config.without_categories:
        return f"category {category!r} is in select.without_categories"
    return ""


def near_duplicates(shapes: Sequence[Mapping[str, Any]], config: SelectConfig) -> dict[int, int]:
    """Find shapes that an earlier one has already: number of the later -> number of the first.

    Args:
        shapes: `descriptor` and `mesh_hash` of every object, in the order of the inputs.
        config: How alike is alike.
    """
    found: dict[int, int] = {}
    firsts: list[int] = []
    by_hash: dict[str, int] = {}
    known = np.empty((len(shapes), len(shapes[0]["descriptor"]) if shapes else 0))
    for number, shape in enumerate(shapes):
        own = np.asarray(shape["descriptor"], np.float64)
        first = by_hash.get(shape["mesh_hash"])
        if first is None and firsts:
            apart = unlikeness(own, known[: len(firsts)])
            nearest = int(np.argmin(apart))
            first = firsts[nearest] if apart[nearest] < config.alike else None
        if first is None:
            known[len(firsts)] = own
            firsts.append(number)
            by_hash[shape["mesh_hash"]] = number
        else:
            found[number] = first
    return found
