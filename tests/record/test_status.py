import numpy as np

from bidexdata.record import Status
from bidexdata.record.fields import FIELDS


def test_every_status_has_a_sentence_and_fits_its_column():
    for status in Status:
        assert status.sentence[0].islower()
        assert status == np.int8(status)
        assert Status[status.label.upper()] is status


def test_numbers_lie_in_their_stage_block_and_are_unique():
    values = [s.value for s in Status]
    assert len(values) == len(set(values))
    assert all(0 <= v < 100 for v in values)
    assert Status.OK == 0
    blocks = {"UNREADABLE": 1, "NO_REGION_PAIR": 20, "NOT_REACHABLE": 50, "NOT_RUN": 70}
    # Each block opens with its first number, and the members are written in their order.
    assert {name: Status[name].value for name in blocks} == blocks
    assert values == sorted(values)


def test_the_two_status_columns_are_separate():
    assert FIELDS["synth_status"].written_by == "synth"
    assert FIELDS["verdict_status"].written_by == "validate"
