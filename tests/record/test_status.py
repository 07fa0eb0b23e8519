import numpy as np

from bidexdata.record import Status
from bidexdata.record.fields import FIELDS
from bidexdata.record.status import ARM_STATUSES, SYNTH_STAGES, by_synth_stage


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


def test_every_status_of_an_attempt_belongs_to_one_stage_of_the_synthesis():
    of_attempts = [s for s in Status if s == Status.OK or 20 <= s <= 50]
    assert sorted(s for stage in SYNTH_STAGES.values() for s in stage) == sorted(of_attempts)
    counts = {s.label: 2**k for k, s in enumerate(of_attempts)}
    stages = by_synth_stage(counts)
    assert list(stages) == list(SYNTH_STAGES)
    assert sum(stages.values()) == sum(counts.values())


def test_runs_without_a_rig_have_no_stage_reach():
    assert list(by_synth_stage({"ok": 1})) == [s for s in SYNTH_STAGES if s != "reach"]


def test_statuses_of_arms_are_their_block():
    assert [s.label for s in ARM_STATUSES if s != Status.NOT_REACHABLE] == [
        *("ik_pregrasp", "ik_grasp", "ik_lift", "jump"),
        *("collision_table", "collision_object", "collision_arms", "collision_self", "no_grasp"),
    ]
    assert [s.value for s in ARM_STATUSES] == list(range(50, 60))
