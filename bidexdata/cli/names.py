"""`bidexdata protocols`, `presets`: what there is, one line each."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from bidexdata.cli import options
from bidexdata.cli.report import command, finish, table
from bidexdata.synthesis.method_names import METHODS

if TYPE_CHECKING:
    from bidexdata.cli.config_keys import ConfigGroup

PREPARE = "prepare"
"""Stands for the configuration of `bidexdata prepare` where a preset is named."""
ARMS = "arms"
"""Likewise for that of `bidexdata arms`."""


def protocols(
    name: Annotated[
        str | None,
        typer.Argument(
            metavar="[NAME]", help="A protocol or a YAML file: list every key that --set takes."
        ),
    ] = None,
    as_json: options.Json = False,
    quiet: options.Quiet = False,
    debug: options.Debug = False,
) -> None:
    """List the validation protocols, or every setting of one.

    With NAME: key, value, unit and meaning of everything that `bidexdata validate` takes with --set
    and --config.

    --json keys: protocols (a list of name, tests, description, settings); with NAME: name,
    description, groups (a list of name, meaning, keys: key, value, unit, meaning, source).
    """
    if name is None:
        _list_protocols(as_json=as_json, quiet=quiet)
    else:
        description, groups = _protocol_keys(name)
        _list_keys(name, description, groups, as_json=as_json, quiet=quiet)


def _list_protocols(*, as_json: bool, quiet: bool) -> None:
    from bidexdata.config import to_plain
    from bidexdata.validation.protocols import load_protocol, protocol_names

    known = [load_protocol(name) for name in protocol_names()]
    found = [
        {
            "name": p.name,
            "tests": list(p.tests),
            "description": p.description,
            "settings": to_plain(p),
        }
        for p in known
    ]
    lines = table([[p.name, ",".join(p.tests), p.description] for p in known])
    lines.append(f"every key of a protocol: {command('protocols', 'NAME')}")
    finish({"protocols": found}, lines, as_json=as_json, quiet=quiet)


def presets(
    name: Annotated[
        str | None,
        typer.Argument(
            metavar="[NAME]",
            help="A preset, a peer's method (bodex, bimangrasp), `prepare` or `arms`: list every key "
            "that --set and --config take.",
        ),
    ] = None,
    as_json: options.Json = False,
    quiet: options.Quiet = False,
    debug: options.Debug = False,
) -> None:
    """List the presets of synth and what each changes, or every key of one.

    With NAME: key, value, unit and meaning, and in brackets where the value is from. The names
    `prepare` and `arms` stand for the configurations of `bidexdata prepare` and `bidexdata arms`,
    which have no presets; nor have the peers' methods of `synth --method`, which stand for
    themselves.

    --json keys: presets (a list of name, description, changes: key, value, reason); with NAME:
    name, description, groups (a list of name, meaning, keys: key, value, unit, meaning, source).
    """
    if name is None:
        _list_presets(as_json=as_json, quiet=quiet)
    else:
        description, groups = _keys_of(name)
        _list_keys(name, description, groups, as_json=as_json, quiet=quiet)


def _list_presets(*, as_json: bool, quiet: bool) -> None:
    from bidexdata.synthesis.presets import describe_preset, preset_names

    known = {name: describe_preset(name) for name in preset_names()}
    found = [
        {
            "name": name,
            "description": p.sentence,
            "changes": [c._asdict() for c in p.changes],
        }
        for name, p in known.items()
    ]
    lines = []
    for name, preset in known.items():
        lines.append(f"{name}: {preset.sentence}")
        rows = [[f"  {c.key}", str(c.value), c.reason] for c in preset.changes]
        lines += table(rows) if rows else []
    lines.append(f"every key of a preset: {command('presets', 'NAME')}")
    lines.append(f"every key of a peer's method: {command('presets', METHODS[-1])}")
    lines.append(f"every key of prepare: {command('presets', PREPARE)}")
    lines.append(f"every key of arms: {command('presets', ARMS)}")
    finish({"presets": found}, lines, as_json=as_json, quiet=quiet)


def _list_keys(
    name: str, description: str, groups: list[ConfigGroup], *, as_json: bool, quiet: bool
) -> None:
    data = {
        "name": name,
        "description": description,
        "groups": [
            {"name": g.name, "meaning": g.meaning, "keys": [k._asdict() for k in g.keys]}
            for g in groups
        ],
    }
    lines = [f"{name}: {description}"]
    rows = table([key.cells() for group in groups for key in group.keys])
    for group in groups:
        lines += ["", f"{group.name}: {group.meaning}" if group.name else group.meaning]
        lines += ["  " + row for row in rows[: len(group.keys)]]
        rows = rows[len(group.keys) :]
    finish(data, lines, as_json=as_json, quiet=quiet)


def _protocol_keys(name: str) -> tuple[str, list[ConfigGroup]]:
    from bidexdata.cli.config_keys import config_groups
    from bidexdata.validation.protocols import load_protocol

    protocol = load_protocol(name)
    return protocol.description, list(config_groups(protocol, meaning="the test"))


def _keys_of(name: str) -> tuple[str, list[ConfigGroup]]:
    if name == PREPARE:
        return _prepare_keys()
    if name == ARMS:
        return _arms_keys()
    return _method_keys(name) if name in METHODS else _preset_keys(name)


def _method_keys(name: str) -> tuple[str, list[ConfigGroup]]:
    from bidexdata.cli.config_keys import config_groups
    from bidexdata.synthesis.methods import load_method

    method = load_method(name)
    return method.sentence, list(config_groups(method.config()))


def _prepare_keys() -> tuple[str, list[ConfigGroup]]:
    from bidexdata.cli.config_keys import config_groups
    from bidexdata.objects.config import PrepareConfig

    description = (
        "the configuration of `bidexdata prepare`; lengths without a unit are fractions of the "
        "mesh's bounding-box diagonal"
    )
    return description, list(config_groups(PrepareConfig()))


def _arms_keys() -> tuple[str, list[ConfigGroup]]:
    from bidexdata.arms.config import ArmConfig
    from bidexdata.cli.config_keys import config_groups

    return "the configuration of `bidexdata arms`", list(config_groups(ArmConfig()))


def _preset_keys(name: str) -> tuple[str, list[ConfigGroup]]:
    from bidexdata.cli.config_keys import config_groups
    from bidexdata.synthesis.presets import describe_preset, load_preset, source_of

    preset, config = describe_preset(name), load_preset(name)
    reasons = {change.key: f"{name}: {change.reason}" for change in preset.changes}
    groups = []
    for group in config_groups(config):
        keys = (
            k._replace(source=reasons.get(k.key, k.source) or source_of(k.key)) for k in group.keys
        )
        groups.append(group._replace(keys=tuple(keys)))
    return preset.sentence, groups
