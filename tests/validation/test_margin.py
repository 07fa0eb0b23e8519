from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from box_solids import box_solid
from grasps import HALF, batch_of, squeeze, turned

from bidexdata.record import Status
from bidexdata.validation import Execution, load_protocol, validate_grasps
from bidexdata.validation.margin import BISECTIONS, LARGEST, SMALLEST, largest_multiple
from bidexdata.validation.rest import probe

PAPER = load_protocol("paper-1")
RATIO = 2 ** (1 / 2**BISECTIONS)


@pytest.mark.parametrize("truth", [0.07, 0.3, 0.999, 1.0, 1.5, 7.3, 63.0])
def test_the_margin_is_just_below_the_truth(truth):
    tried = []

    def holds(multiple):
        tried.append(multiple)
        return multiple <= truth

    found = largest_multiple(holds, holds_one=truth >= 1.0)
    assert found <= truth < found * RATIO * (1 + 1e-9)
    assert (found >= 1.0) == (truth >= 1.0)
    assert 1.0 not in tried  # the verdict itself already says that


def test_beyond_its_range_the_margin_is_an_end_of_it():
    assert largest_multiple(lambda m: True, holds_one=True) == LARGEST
    assert largest_multiple(lambda m: False, holds_one=False) == 0.0
    assert largest_multiple(lambda m: m <= SMALLEST, holds_one=False) >= SMALLEST


def test_heavier_objects_have_margins_in_proportion(hands):
    """Twice the mass halves the margin: it is one of the load, not of the object."""
    grasp = squeeze(hands)
    margins = []
    for density in (400.0, 800.0):
        rules = replace(PAPER, hold=0.5, scene=replace(PAPER.scene, density=density))
        out = validate_grasps(
            batch_of(hands, [grasp]),
            box_solid(),
            hands,
            rules,
            execution=Execution(load_margin=True),
        )
        assert out["success"][0] == (out["load_margin"][0] >= 1)
        margins.append(out["load_margin"][0])
    assert margins[0] / margins[1] == pytest.approx(2.0, rel=0.3)


def test_a_lift_is_probed_under_its_own_load_alone(hands, monkeypatch):
    from bidexdata.validation import lift

    probes = []
    grasp = turned(squeeze(hands), np.array([1.0, 0, 0, 0]), np.array([0.0, 0.0, HALF]))
    batch = batch_of(hands, [grasp], object_pos=[(0.0, 0.0, HALF)])
    monkeypatch.setattr(lift, "probe", lambda *args: probes.append(args) or probe(*args))
    rules = replace(PAPER, lift=replace(PAPER.lift, hold=0.5))
    how = Execution(load_margin=True)
    out = validate_grasps(batch, box_solid(), hands, rules, "l", execution=how)
    assert out["load_margin"][0] >= 2
    assert len(probes) == 1


def test_a_grasp_that_is_never_simulated_has_no_margin(hands):
    inside = squeeze(hands, gaps=(-0.03,) * 3)
    for test in ("f", "l"):
        out = validate_grasps(
            *(batch_of(hands, [inside]), box_solid(), hands, PAPER, test),
            execution=Execution(load_margin=True),
        )
        assert out["verdict_status"][0] == Status.START_PENETRATION
        assert out["load_margin"][0] == 0


def test_a_grasp_that_holds_nothing_has_no_margin(hands):
    far = squeeze(hands, gaps=(0.1,) * 3)
    out = validate_grasps(
        batch_of(hands, [far]), box_solid(), hands, PAPER, execution=Execution(load_margin=True)
    )
    assert out["load_margin"][0] == 0
    assert np.isnan(
        validate_grasps(batch_of(hands, [far]), box_solid(), hands, PAPER)["load_margin"]
    )
