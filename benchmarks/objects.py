"""The objects and grasps that all scripts measure on: built in, fixed seeds."""

from __future__ import annotations

from functools import cache

from bidexdata.hands import Hand, load_hands
from bidexdata.objects.prepare import prepare_object
from bidexdata.objects.prepared import PreparedObject
from bidexdata.record import GraspBatch, Scene
from bidexdata.synthesis.pipeline import synthesize

FAMILIES = ("box", "cylinder", "bottle", "mug")
SIZES_MM = (300, 500, 800)


@cache
def prepared(family: str) -> PreparedObject:
    """The object of a family."""
    return prepare_object(f"shapes:{family}")


def objects() -> tuple[PreparedObject, ...]:
    """One object of each family."""
    return tuple(prepared(family) for family in FAMILIES)


@cache
def hands() -> tuple[Hand, Hand]:
    """The built-in hand, left and right."""
    return load_hands("capsule")


def scenes(obj: PreparedObject) -> list[Scene]:
    """An object floating at every size."""
    return [Scene(obj.object_id, size) for size in SIZES_MM]


@cache
def grasps(index: int, kept: int = 4) -> GraspBatch:
    """Rows of one object at every size, selected and audit."""
    obj = objects()[index]
    return synthesize(obj, hands(), scenes(obj), seed=0, grasps=kept)
