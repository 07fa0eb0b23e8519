"""Laws of the synthesis configuration and its presets."""

import dataclasses
import itertools
import re

import numpy as np
import pytest
from made_objects import box_object

from bidexdata.config import fingerprint, from_plain, to_plain, with_overrides
from bidexdata.errors import BadConfig, UnknownKey, UnknownName
from bidexdata.hands import load_hands
from bidexdata.record import Scene
from bidexdata.synthesis.attempts import draw_attempts
from bidexdata.synthesis.config import SynthConfig
from bidexdata.synthesis.methods import load_method
from bidexdata.synthesis.optimise_config import ClosureConfig
from bidexdata.synthesis.presets import (
    PAPER_GIVEN,
    PAPER_IDLE,
    PAPER_OPEN,
    describe_preset,
    load_preset,
    preset_names,
)
from bidexdata.synthesis.regions_build import accessible_anchors, build_regions
from bidexdata.wrench.qp import QPConfig


def value_at(config, key):
    for part in key.split("."):
        config = getattr(config, part)
    return config


@pytest.mark.parametrize("name", preset_names())
def test_a_preset_survives_the_round_trip_through_plain_data(name):
    config = load_preset(name)
    assert from_plain(SynthConfig, to_plain(config)) == config
    assert fingerprint(from_plain(SynthConfig, to_plain(config))) == fingerprint(config)


def test_the_default_preset_is_the_default():
    assert load_preset("default") == SynthConfig()


def test_every_change_of_a_preset_changes_the_default_and_says_why():
    for name in preset_names():
        for change in describe_preset(name).changes:
            assert change.reason
            assert value_at(load_preset(name), change.key) == change.value
            default = value_at(SynthConfig(), change.key)
            assert type(default) is type(change.value)
            assert default != change.value, change.key


def test_the_paper_preset_has_the_papers_numbers():
    config = load_preset("paper")
    assert config.regions.anchors == 200
    assert config.regions.points == 256
    assert config.regions.radius == 0.08
    assert config.regions.gap == 0.05
    assert config.regions.contacts == 5
    assert config.regions.kept == 40
    assert config.regions.score == "force"
    assert config.optimise.closure.groups == "decoupled"
    assert config.optimise.closure.weight_decoupled == 1000
    assert config.optimise.energy.distance == 100
    assert config.optimise.energy.region == 50
    assert config.optimise.pregrasp.distance == 0.01
    assert config.staging.extrapolate == 1
    assert config.staging.force_floor == config.staging.force_per_weight == 0


@pytest.mark.parametrize("method", ["bodex", "bimangrasp"])
def test_the_baselines_filter_and_squeeze_as_the_paper_does(method):
    theirs, papers = load_method(method).config(), load_preset("paper")
    assert theirs.selection == papers.selection
    assert theirs.staging == papers.staging


def leaves(config, prefix=""):
    """Dotted name and value of every field that is not a part with fields of its own."""
    for field in dataclasses.fields(config):
        value, key = getattr(config, field.name), prefix + field.name
        if dataclasses.is_dataclass(value):
            yield from leaves(value, key + ".")
        else:
            yield key, value


def test_the_paper_preset_accounts_for_every_field_once():
    stated = [c.key for c in describe_preset("paper").changes]
    kept = [c.key for part in (PAPER_GIVEN, PAPER_OPEN, PAPER_IDLE) for c in part]
    for key in leaves(SynthConfig()):
        named = [k for k in stated + kept if f"{key[0]}.".startswith(f"{k}.")]
        assert len(named) == 1, f"{key[0]}: {named}"


def test_the_paper_preset_differs_from_the_default_only_where_it_says():
    ours, papers = dict(leaves(SynthConfig())), dict(leaves(load_preset("paper")))
    stated = {c.key for c in describe_preset("paper").changes}
    assert {k for k in ours if ours[k] != papers[k]} <= stated


def test_every_field_that_the_paper_preset_keeps_exists_and_says_why():
    for constant in (*PAPER_GIVEN, *PAPER_OPEN, *PAPER_IDLE):
        assert constant.source
        value_at(SynthConfig(), constant.key)


@pytest.mark.parametrize(
    ("stored", "size", "whole"), [(6000, 0.4, True), (6000, 0.8, False), (24000, 0.8, True)]
)
def test_a_region_has_its_256_points_where_the_library_has_enough(stored, size, whole):
    """A cube has the most surface of all convex objects of one diagonal."""
    cube = box_object(sides=(1.0, 1.0, 1.0), points=stored)
    regions = build_regions(cube, size, load_preset("paper").regions, np.random.default_rng(0))
    different = [len(np.unique(points, axis=0)) for points in regions.points]
    assert (min(different) == 256) == whole


def test_the_paper_preset_drops_pairs_by_the_gap_alone():
    """A thin plate, whose two sheets face each other and whose hull is itself."""
    obj = box_object(sides=(1.0, 0.8, 0.05))
    config = load_preset("paper").regions
    rng = np.random.default_rng(0)
    regions = build_regions(obj, 0.3, config, rng)
    assert accessible_anchors(obj, 0.3, regions, config).all()
    # A region near the middle holds points of both sheets.
    middle = np.argmin(np.linalg.norm(regions.anchor_points, axis=1))
    cosine = regions.normals[middle] @ regions.anchor_normals[middle]
    assert cosine.max() > 0.99
    assert cosine.min() < -0.99


def test_no_constant_of_the_closure_stands_beside_its_qp():
    fields = {f.name for f in dataclasses.fields(ClosureConfig)}
    assert not fields & {"friction", *(f.name for f in dataclasses.fields(QPConfig))}
    assert isinstance(SynthConfig().optimise.closure.qp, QPConfig)


def test_unknown_names_and_impossible_values_are_refused():
    with pytest.raises(UnknownName, match="did you mean 'paper'"):
        load_preset("papr")
    with pytest.raises(UnknownKey, match="step"):
        with_overrides(SynthConfig(), ["optimise.approach.step=3"])
    with pytest.raises(BadConfig, match="mu"):
        with_overrides(SynthConfig(), ["optimise.closure.qp.mu=-1"])
    with pytest.raises(BadConfig, match="one of decoupled, coupled, mix"):
        with_overrides(SynthConfig(), ["optimise.closure.groups=both"])


def test_every_field_has_a_docstring_with_its_source():
    """Read from the source text, because Python keeps no docstrings of fields."""
    import ast
    import inspect

    pending, seen = [SynthConfig], set()
    while pending:
        cls = pending.pop()
        if cls in seen or not cls.__module__.startswith("bidexdata.synthesis"):
            continue
        seen.add(cls)
        body = ast.parse(inspect.getsource(cls)).body[0].body
        texts = {
            a.target.id: b for a, b in itertools.pairwise(body) if isinstance(a, ast.AnnAssign)
        }
        for field in dataclasses.fields(cls):
            default = getattr(SynthConfig(), field.name, None)
            if dataclasses.is_dataclass(default):
                pending.append(type(default))
                continue
            after = texts[field.name]
            documented = isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant)
            if cls is not SynthConfig and not field.type.endswith("Config"):
                assert documented, f"{cls.__name__}.{field.name} has no docstring"


@pytest.mark.parametrize("name", preset_names())
def test_no_attempt_of_a_preset_repeats_another(name):
    """Three region pairs for 24 attempts in two rounds of one run, which draw by other seeds."""
    obj, hands = box_object(), load_hands("capsule")
    scene = Scene(obj.object_id, 500)
    config = with_overrides(load_preset(name), ["placement.pairs=3", "regions.anchors=8"])
    one = draw_attempts(obj, hands, scene, config, 1, 12)
    two = draw_attempts(obj, hands, scene, config, 2, 12, grown=True)
    again = {tuple(r) for r in one.region_id} & {tuple(r) for r in two.region_id}
    assert again, "the rounds must share a pair in this test"
    rows = np.concatenate([a.start.position.reshape(-1, 6) for a in (one, two)])
    turns = np.concatenate([a.start.rotation.reshape(-1, 18) for a in (one, two)])
    assert len(rows) > 12
    assert len(np.unique(np.hstack([rows, turns]).astype(np.float32), axis=0)) == len(rows)


def test_what_the_paper_leaves_open_says_where_its_value_comes_from():
    sources = dict(PAPER_OPEN)
    for key, source in sources.items():
        assert re.search(r"measurements, \d|BODex|\bours\b", source), key
    for weight in ("penetration", "self_penetration"):
        assert sources[f"optimise.energy.{weight}"].startswith("no weight in the paper")
