"""What the solver hands on is what the record takes."""

from __future__ import annotations

import numpy as np
import pytest

from bidexdata.arms import ArmConfig
from bidexdata.arms.config import ClearanceConfig, PathConfig, SearchConfig
from bidexdata.arms.solutions import arm_headers, no_solutions
from bidexdata.errors import BadConfig
from bidexdata.record import GraspBatch, HandHeader, Header
from bidexdata.record.batch import fill_value
from bidexdata.record.fields import FIELDS, columns_of_table


def header(robot, config: ArmConfig) -> Header:
    hands = tuple(
        HandHeader(h.name, h.side, h.spec_hash, h.joint_names, (), h.root_body) for h in robot.hands
    )
    return Header(hands, arms=arm_headers(robot, config))


def test_columns_are_those_of_the_records_table_and_survive_arrow(robot):
    config = ArmConfig(path=PathConfig(knots=(4, 2, 2, 1, 2)))
    columns = no_solutions(robot, config, 3).to_columns()
    assert tuple(columns) == columns_of_table("arms")
    batch = GraspBatch(header(robot, config), columns)
    again = GraspBatch.from_arrow(batch.to_arrow())
    assert again.header == batch.header
    for name, values in columns.items():
        np.testing.assert_array_equal(again[name], values)


def test_rows_without_a_motion_hold_what_stands_for_nothing(made):
    columns = no_solutions(made, ArmConfig(), 2).to_columns()
    assert set(columns["arm_status"]) == {59}
    assert (columns["arm_starts"] == 0).all()
    for name in set(columns) - {"arm_status", "arm_starts"}:
        expected = np.full(columns[name].shape, fill_value(FIELDS[name]), columns[name].dtype)
        np.testing.assert_array_equal(columns[name], expected)


@pytest.mark.parametrize(
    ("kind", "key", "value"),
    [
        (PathConfig, "knots", (1, 1, 1, 1, 0)),
        (PathConfig, "seconds", (1.0, 1.0, 1.0, 1.0, 0.0)),
        (PathConfig, "speed", 0.0),
        (PathConfig, "largest_step", 2.0),
        (ClearanceConfig, "depth", -0.001),
        (SearchConfig, "pairs", 0),
        (SearchConfig, "step", 0.0),
    ],
)
def test_impossible_settings_are_refused_by_their_key(kind, key, value):
    with pytest.raises(BadConfig, match=f"{kind.__name__}.{key}"):
        kind(**{key: value})
