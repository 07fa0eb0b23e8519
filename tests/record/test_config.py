from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bidexdata import config
from bidexdata.errors import BadConfig, PathNotFound, UnknownKey


@dataclass(frozen=True, kw_only=True)
class Inner:
    weight: float = 1.0
    names: tuple[str, ...] = ("a",)
    corner: tuple[int, int] = (0, 0)
    mode: Literal["slow", "fast"] = "slow"

    def __post_init__(self):
        if self.weight < 0:
            raise BadConfig(f"Inner.weight must be >= 0, not {self.weight}")


@dataclass(frozen=True, kw_only=True)
class Outer:
    steps: int = 5
    flag: bool = False
    label: str | None = None
    inner: Inner = field(default_factory=Inner)


inners = st.builds(
    Inner,
    weight=st.floats(0, 1e300),
    names=st.lists(st.text()).map(tuple),
    corner=st.tuples(st.integers(), st.integers()),
    mode=st.sampled_from(["slow", "fast"]),
)
outers = st.builds(
    Outer, steps=st.integers(), flag=st.booleans(), label=st.none() | st.text(), inner=inners
)


@given(outers)
def test_plain_data_gives_the_configuration_back(value):
    assert config.from_plain(Outer, config.to_plain(value)) == value


@given(outers)
def test_json_gives_the_configuration_back_and_one_spelling(value):
    import json

    text = config.canonical_json(value)
    again = config.from_plain(Outer, json.loads(text))
    assert again == value
    assert config.canonical_json(again) == text


@given(outers, outers)
def test_fingerprints_agree_exactly_when_configurations_do(a, b):
    assert (config.fingerprint(a) == config.fingerprint(b)) == (
        config.canonical_json(a) == config.canonical_json(b)
    )
    differing = config.differing_keys(config.to_plain(a), config.to_plain(b))
    assert (not differing) == (config.canonical_json(a) == config.canonical_json(b))


def test_an_unknown_key_names_the_nearest_one():
    with pytest.raises(
        UnknownKey, match=r"Outer\.inner has no key 'wieght'; did you mean 'weight'"
    ):
        config.from_plain(Outer, {"inner": {"wieght": 2}})


@pytest.mark.parametrize(
    ("data", "said"),
    [
        ({"steps": 1.5}, "steps must be a whole number"),
        ({"steps": True}, "steps must be a whole number"),
        ({"flag": 1}, "flag must be true or false"),
        ({"inner": {"corner": [1]}}, "needs 2 values"),
        ({"inner": {"mode": "medium"}}, "slow, fast"),
        ({"inner": {"weight": "heavy"}}, "must be a number"),
        ({"inner": {"names": "abc"}}, "must be a list"),
        ({"inner": 3}, "must be a mapping"),
        ({"inner": {"weight": -1}}, "weight must be >= 0"),
    ],
)
def test_a_wrong_value_is_one_sentence(data, said):
    with pytest.raises(BadConfig, match=said):
        config.from_plain(Outer, data)


@pytest.mark.parametrize(
    ("where", "said"),
    [
        (None, "Outer.inner.weight must"),
        ("", "inner.weight must"),
        ("run", "run.inner.weight must"),
        ("my.yaml:", "my.yaml: inner.weight must"),
    ],
)
@pytest.mark.parametrize("value", [-1, "heavy"])  # refused by the class, and by its type
def test_a_refusal_names_the_key_where_it_stands(where, said, value):
    with pytest.raises(BadConfig) as caught:
        config.from_plain(Outer, {"inner": {"weight": value}}, where)
    assert str(caught.value).startswith(said)


@pytest.mark.parametrize("value", ["-1", "heavy"])
def test_an_override_is_named_as_it_was_typed(value):
    with pytest.raises(BadConfig) as caught:
        config.with_overrides(Outer(), [f"inner.weight={value}"])
    assert str(caught.value).startswith("inner.weight must")


@pytest.mark.parametrize(
    ("assignment", "value"),
    [
        ("inner.weight=1e-3", Outer(inner=Inner(weight=1e-3))),
        ("inner.names=[x, y]", Outer(inner=Inner(names=("x", "y")))),
        ("flag=true", Outer(flag=True)),
        ("label=", Outer(label=None)),
    ],
)
def test_overrides_mean_what_they_look_like(assignment, value):
    assert config.with_overrides(Outer(), [assignment]) == value


@pytest.mark.parametrize("assignment", ["steps", "inner=3", "steps=[", "inner.weight=-1"])
def test_bad_overrides_are_refused(assignment):
    with pytest.raises(BadConfig):
        config.with_overrides(Outer(), [assignment])


@pytest.mark.parametrize("assignment", ["stepz=1", "inner.weihgt=1", "steps.deep=1", "no.where=1"])
def test_overrides_of_unknown_keys_are_refused(assignment):
    with pytest.raises(UnknownKey):
        config.with_overrides(Outer(), [assignment])


def test_yaml_files_are_read_or_named(tmp_path: Path):
    good, bad, listed, binary = (tmp_path / n for n in ("g.yaml", "b.yaml", "l.yaml", "x.yaml"))
    good.write_text("steps: 3\n")
    bad.write_text("steps: [\n")
    listed.write_text("- 1\n")
    binary.write_bytes(b"\xff\xfe\x00")
    assert config.load_yaml(good) == {"steps": 3}
    for path in (bad, listed, binary):
        with pytest.raises(BadConfig, match=path.name):
            config.load_yaml(path)
    with pytest.raises(PathNotFound, match="missing"):
        config.load_yaml(tmp_path / "missing.yaml")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("# mine\nsteps: 3\nstepz: 4\n", "has no key 'stepz'; did you mean 'steps'? (line 3)"),
        (
            "steps: 3\ninner:\n  names: [a]\n  weight: heavy\n",
            "inner.weight must be a number, not 'heavy' (line 4)",
        ),
        ("inner:\n\n  weight: -1\n", "weight must be >= 0, not -1.0 (line 3)"),
        ("inner: {mode: medium}\n", "slow, fast, not 'medium' (line 1)"),
        ("steps: 3\ninner: [1]\n", "(line 2)"),
    ],
)
@pytest.mark.parametrize("over_a_base", [False, True])
def test_a_refusal_of_a_file_names_the_line(text, said, over_a_base, tmp_path):
    (tmp_path / "f.yaml").write_text(text)
    data = config.load_yaml(tmp_path / "f.yaml")
    if over_a_base:
        data = config.merge(config.to_plain(Outer()), data)
    with pytest.raises(BadConfig) as caught:
        config.from_plain(Outer, data, "f.yaml:")
    assert str(caught.value).startswith("f.yaml")
    assert str(caught.value).endswith(said)


def test_a_file_that_is_no_yaml_names_the_line(tmp_path):
    (tmp_path / "f.yaml").write_text("steps: 3\nlabel: a: b\n")
    with pytest.raises(BadConfig, match=r"f\.yaml, line 2: not valid YAML \(mapping values"):
        config.load_yaml(tmp_path / "f.yaml")


def test_merge_overlays_nested_mappings_only():
    base = {"a": {"x": 1, "y": 2}, "b": [1, 2]}
    assert config.merge(base, {"a": {"y": 3}, "b": [9]}) == {"a": {"x": 1, "y": 3}, "b": [9]}
    assert base == {"a": {"x": 1, "y": 2}, "b": [1, 2]}


def test_a_key_without_its_group_is_named_with_it():
    with pytest.raises(UnknownKey, match=r"no key 'weight'; did you mean 'inner\.weight'"):
        config.with_overrides(Outer(), ["weight=2"])
