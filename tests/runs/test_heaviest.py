"""The heaviest object of a run: by its own volumes, and at the density that its hands squeeze for."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from made_armed import made_run, write_rig
from made_release import made_object, made_release

from bidexdata.arms.payload import TooHeavy, require_payload
from bidexdata.arms.registry import load_rig
from bidexdata.arms.robot import mount_robot
from bidexdata.cli.main import run as bidexdata
from bidexdata.hands import load_hands
from bidexdata.runs.arms import arms_run, heaviest_object
from bidexdata.runs.retest import start_retest
from bidexdata.runs.run import Run
from bidexdata.runs.stage import TaskExecution

BOX = "box-aaaaaaaa"
INLINE = TaskExecution(executor="inline", quiet=True)


@pytest.fixture(scope="module", params=["library", "release"])
def run(request, tmp_path_factory: pytest.TempPathFactory) -> Run:
    """Rows of boxes, from a library or from a release."""
    folder = tmp_path_factory.mktemp(request.param)
    if request.param == "release":
        options = {"setting": "tabletop", "hands": load_hands("capsule"), "sizes": (300, 500)}
        release = made_release(folder / "release", (BOX,), form="parquet", **options)
        return start_retest(release, folder / "run")
    words = ["prepare", "shapes:box", "--out", str(folder / "library"), "--quiet"]
    assert bidexdata([*words, "--executor", "inline"]) == 0
    return made_run(folder / "library", folder / "run", sizes=(300, 500))


def squeezed_for(run: Run, **weight: float) -> Run:
    staging = {"mass": 0.0, "density": 0.0, **weight}
    return replace(run, spec=replace(run.spec, config={**run.spec.config, "staging": staging}))


def volume(run: Run) -> float:
    if run.spec.of_release:
        return made_object(BOX).volume
    return run.library.row(run.tasks[0].object_id)["volume"]


@pytest.mark.parametrize("density", [2.5, 25.0, 250.0])
def test_it_is_the_largest_size_at_the_density_of_the_run(run: Run, density):
    found = heaviest_object(squeezed_for(run, density=density))
    assert found == pytest.approx(density * volume(run) * 0.5**3, rel=1e-5)


def test_a_mass_is_that_mass(run: Run):
    assert heaviest_object(squeezed_for(run, mass=0.5)) == 0.5


def test_arms_that_carry_the_boxes_of_paper_1_refuse_those_a_hundred_times_as_heavy(
    run: Run, tmp_path: Path
):
    # A capsule hand of half a kilogram, and half of a box of 0.03 kg at most, or of 3 kg.
    rig = write_rig(tmp_path / "rig")
    rig.write_text(rig.read_text().replace("payload: 8.0", "payload: 1.0"), encoding="utf-8")
    heavy = squeezed_for(run, density=250.0)
    with pytest.raises(TooHeavy, match=r"carries 1 kg, and hand capsule with half of the object"):
        arms_run(heavy, rig, execution=INLINE)
    robot = mount_robot(load_rig(rig), run.hands())
    require_payload(robot, heaviest_object(squeezed_for(run, density=2.5)))
