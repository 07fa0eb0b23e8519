"""Back ends: verdicts of another engine have a name and a fingerprint of their own."""

from __future__ import annotations

import importlib.util
import sys
from dataclasses import replace

import pytest
from box_solids import box_solid
from grasps import batch_of, squeeze

from bidexdata.config import fingerprint, from_plain, to_plain
from bidexdata.errors import BadConfig, MissingExtra, NotUsable, UnknownName
from bidexdata.record.settings import settings_of_test
from bidexdata.validation import (
    Execution,
    Protocol,
    backends,
    load_protocol,
    on_backend,
    protocol_names,
    validate_grasps,
)
from bidexdata.validation.protocols import Engine, require_own_name, without_arms

PAPER = load_protocol("paper-1")
HERE = Engine(device="cuda", mujoco_warp="4.0.0", warp="1.19.0")
OTHERS = (
    replace(HERE, device="cpu"),
    replace(HERE, mujoco_warp="4.0.1"),
    replace(HERE, warp="1.20.0"),
)
needs_engine = pytest.mark.skipif(
    importlib.util.find_spec("mujoco_warp") is None,
    reason="needs mujoco-warp: pip install 'bidexdata[gpu]'",
)


@pytest.fixture
def on_gpu(monkeypatch):
    """The engine of a machine with a GPU, without one."""
    monkeypatch.setattr(backends, "engine_identity", lambda _device: HERE)


# Of what tests of floating hands depend on, before protocols said anything of arms.
PRINTS = {
    "paper-1": "5b363e09f793258c",
    "paper-1-density25": "d3c69fab9b1aec01",
    "paper-1-density250": "e2247085f40e1246",
    "paper-1-mass500g": "9619f7547cdf5784",
    "dexgraspbench-1": "2a71131ccde44cc8",
    "bimandexgraspbench-1": "86d2b2ffa9f08172",
}


@pytest.mark.parametrize("name", protocol_names())
def test_the_settings_of_a_published_protocol_and_their_hash_are_what_they_were(name):
    protocol = load_protocol(name)
    assert protocol.engine is None
    assert "engine" not in to_plain(protocol)
    for test in ("f", "l"):
        assert fingerprint(settings_of_test(to_plain(protocol), test)) == PRINTS[name]
    assert fingerprint(without_arms(protocol)) == PRINTS[name]
    assert on_backend(protocol, "mujoco") is protocol


def test_verdicts_of_another_engine_have_another_name_and_fingerprint(on_gpu):
    other = on_backend(PAPER, "mujoco_warp", "cuda:0")
    assert other.name == "paper-1-warp"
    assert other.engine == HERE
    assert other.backend == "mujoco_warp"
    assert replace(
        other, name=PAPER.name, description=PAPER.description, engine=None
    ) == without_arms(PAPER)
    assert from_plain(Protocol, to_plain(other)) == other
    assert on_backend(other, "mujoco_warp", "cuda:0") is other
    prints = {fingerprint(replace(other, engine=e)) for e in (HERE, *OTHERS)}
    assert len(prints | {fingerprint(PAPER)}) == 2 + len(OTHERS)


@pytest.mark.parametrize("engine", OTHERS)
def test_verdicts_of_two_versions_of_an_engine_do_not_go_on_in_one_place(on_gpu, engine):
    stored = replace(on_backend(PAPER, "mujoco_warp"), engine=engine)
    with pytest.raises(NotUsable, match="'paper-1-warp' are those of MuJoCo Warp"):
        on_backend(stored, "mujoco_warp")


def test_the_name_of_a_known_protocol_keeps_its_settings_on_any_engine(on_gpu):
    other = on_backend(PAPER, "mujoco_warp", "cuda:0")
    for kept in (PAPER, other, replace(other, engine=OTHERS[0]), replace(PAPER, name="mine-1")):
        require_own_name(kept)
    for changed in (PAPER, other):
        with pytest.raises(NotUsable, match=f"'{changed.name}' is the name of a protocol"):
            require_own_name(replace(changed, hold=1.0))


def test_another_engine_runs_no_test_with_arms(on_gpu):
    other = on_backend(PAPER, "mujoco_warp", "cuda:0")
    assert (other.tests, other.arm) == (("f", "l"), None)
    assert fingerprint(["0" * 16, to_plain(replace(other, engine=PUBLISHED)), "l"]) == WARP_MARK
    only = replace(PAPER, name="mine-1", tests=("a",))
    with pytest.raises(NotUsable, match="'mine-1' has no test without arms"):
        on_backend(only, "mujoco_warp", "cuda:0")


PUBLISHED = Engine(device="cpu", mujoco_warp="3.9.0", warp="1.19.0")
# The same expression before protocols said anything of arms.
WARP_MARK = "0a1b1aa94fb80e09"


def test_what_was_stored_before_there_were_arms_keeps_its_name(on_gpu):
    old = from_plain(Protocol, to_plain(without_arms(PAPER)))
    require_own_name(old)
    assert "arm" not in to_plain(old)
    with pytest.raises(NotUsable, match="'paper-1' is the name of a protocol"):
        require_own_name(replace(PAPER, arm=replace(PAPER.arm, wait=2.0)))


def test_the_ending_of_a_name_says_which_engine_judged():
    with pytest.raises(BadConfig, match="'-warp' ends the names"):
        replace(PAPER, name="mine-warp")
    with pytest.raises(BadConfig, match="'-warp' ends the names"):
        replace(PAPER, engine=HERE)
    with pytest.raises(NotUsable, match="--protocol paper-1 --backend mujoco_warp"):
        load_protocol("paper-1-warp")


def test_the_c_engine_gives_no_verdicts_of_another_one_and_has_no_device(hands, on_gpu):
    batch = batch_of(hands, [squeeze(hands)])
    other = on_backend(PAPER, "mujoco_warp")
    with pytest.raises(NotUsable, match=r"MuJoCo Warp 4\.0\.0 .*--backend mujoco_warp"):
        validate_grasps(batch, box_solid(), hands, other)
    with pytest.raises(NotUsable, match="'cuda:0'"):
        validate_grasps(batch, box_solid(), hands, PAPER, device="cuda:0")


def test_what_the_engine_does_not_do_is_refused_before_anything_is_judged(hands, on_gpu):
    batch = batch_of(hands, [squeeze(hands)])

    def judge(protocol, execution=None):
        validate_grasps(
            batch, box_solid(), hands, protocol, execution=execution, backend="mujoco_warp"
        )

    with pytest.raises(UnknownName, match="known: mujoco, mujoco_warp"):
        on_backend(PAPER, "bullet")
    with pytest.raises(NotUsable, match="load margin"):
        judge(PAPER, Execution(load_margin=True))
    with pytest.raises(NotUsable, match="'dexgraspbench-1' sets load"):
        judge(load_protocol("dexgraspbench-1"))


def test_a_missing_package_or_device_is_one_sentence(monkeypatch):
    if importlib.util.find_spec("mujoco_warp") is not None:
        with pytest.raises(NotUsable, match="no device is called 'cuda:99'"):
            on_backend(PAPER, "mujoco_warp", "cuda:99")
    monkeypatch.setitem(sys.modules, "mujoco_warp", None)
    with pytest.raises(MissingExtra, match=r"pip install 'bidexdata\[gpu\]'"):
        on_backend(PAPER, "mujoco_warp", "cpu")


@needs_engine
def test_the_engine_states_its_versions_and_the_kind_of_device():
    import mujoco_warp
    import warp

    found = on_backend(PAPER, "mujoco_warp", "cpu").engine
    assert found == Engine(device="cpu", mujoco_warp=mujoco_warp.__version__, warp=warp.__version__)
