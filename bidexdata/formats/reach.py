"""What of the loss of a test with arms is the arms': trials of its own, beside those of the test.

Definitions: `formats.figures`.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any, NamedTuple

import numpy as np

from bidexdata.formats.trials import Place, TrialTally
from bidexdata.record import GraspBatch, Status
from bidexdata.record.fields import WITH_ARMS
from bidexdata.record.status import ARM_STATUSES, TestStage

ARM_RATES = ("reachable", "given_reachable", "lift_given_reachable")
"""Names of these figures."""
_LIFT = "l"


class ArmTrials(NamedTuple):
    """Trials, by names as `TrialTally.add` takes them for tests."""

    passed: dict[str, np.ndarray]
    among: dict[str, np.ndarray]


def arm_trials(
    batch: GraspBatch,
    verdicts: Mapping[str, Mapping[str, np.ndarray]],
    passed: Mapping[str, np.ndarray],
) -> ArmTrials:
    """Give the trials of the tests with arms among those that were run.

    Args:
        batch: The rows.
        verdicts: Verdict columns per test.
        passed: Per test that was run, the rows that count as successes.
    """
    found = ArmTrials({}, {})
    for test in (t for t in passed if t in WITH_ARMS):
        every, given, lift = (_name(test, name) for name in ARM_RATES)
        reached = _reached(batch, verdicts[test])
        found.passed.update({every: reached, given: passed[test]})
        found.among[given] = reached
        if _LIFT in passed:
            found.passed[lift], found.among[lift] = passed[_LIFT], reached
    return found


def arm_rates(trials: TrialTally, test: str, places: Collection[Place]) -> dict[str, Any]:
    """`ARM_RATES` of a test, each with `selected` and `unselected`; nothing without arms."""
    if test not in WITH_ARMS:
        return {}
    return {
        name: {
            kind: trials.rate(kind, _name(test, name), places).to_dict()
            for kind in ("selected", "unselected")
        }
        for name in ARM_RATES
    }


def arm_rates_of(
    trials: TrialTally, tests: Collection[str], places: Collection[Place]
) -> dict[str, Any]:
    """The same of all tests in one, `<name>_<test>`."""
    return {
        f"{name}_{test}": rates
        for test in tests
        for name, rates in arm_rates(trials, test, places).items()
    }


def _name(test: str, rate: str) -> str:
    return f"{test} {rate}"


def _reached(batch: GraspBatch, verdict: Mapping[str, np.ndarray]) -> np.ndarray:
    """Rows with a grasp that arms have a motion to: all but those they failed before simulation."""
    unsimulated = verdict["failed_stage"] == TestStage.NONE
    by_arms = np.isin(verdict["verdict_status"], ARM_STATUSES) & unsimulated
    untested = verdict["verdict_status"] == Status.NOT_RUN
    return ~by_arms & ~untested & (batch["synth_status"] == Status.OK)
