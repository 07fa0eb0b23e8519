"""Laws of contact sets: fingertips lead, views share all else, hands without other points have one."""

import dataclasses

import numpy as np
import pytest

from bidexdata.errors import BadConfig
from bidexdata.hands.contact_sets import contact_view, set_numbers, usable_sets
from bidexdata.hands.registry import hand_spec

EVERY = ("fingertips", "pads", "with_palm")


def test_a_set_is_the_fingertips_and_then_one_other_part(hand):
    tips = set_numbers(hand, "fingertips")
    np.testing.assert_array_equal(tips, np.arange(hand.fingertips))
    for name, part in (("pads", "pad"), ("with_palm", "palm")):
        numbers = set_numbers(hand, name)
        np.testing.assert_array_equal(numbers[: len(tips)], tips)
        assert {hand.contact_part[c] for c in numbers[len(tips) :]} == {part}
        assert len(numbers) == 2 * len(tips) == 10


def test_a_view_has_the_points_of_its_set_and_all_else_of_the_hand(hand):
    for name in EVERY:
        view, numbers = contact_view(hand, name), set_numbers(hand, name)
        for field in dataclasses.fields(hand):
            own, seen = getattr(hand, field.name), getattr(view, field.name)
            if not field.name.startswith("contact_"):
                assert seen is own
            else:
                assert list(map(str, seen)) == [str(own[c]) for c in numbers]
        assert view.fingertips == hand.fingertips


def test_a_hand_of_fingertips_alone_has_one_usable_set(hand):
    tips = contact_view(hand, "fingertips")
    assert usable_sets((hand, hand), EVERY) == EVERY
    assert usable_sets((tips, tips), EVERY) == ("fingertips",)
    assert usable_sets((tips, tips), ("with_palm",)) == ("with_palm",)
    assert usable_sets((tips, hand), ("fingertips", "pads")) == ("fingertips", "pads")


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"part": "palm"}, "without one"),
        ({"finger": ""}, "name its finger"),
        ({"part": "pad"}, "begin with the fingertips"),
    ],
)
def test_a_spec_that_mixes_parts_up_is_refused(change, word):
    spec = hand_spec("capsule")

    def changed():
        first = dataclasses.replace(spec.contacts[0], **change)
        return dataclasses.replace(spec, contacts=(first, *spec.contacts[1:]))

    with pytest.raises(BadConfig, match=word):
        changed()
