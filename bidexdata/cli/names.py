"""`bidexdata hands`, `protocols`, `presets`: what there is, one line each."""

from __future__ import annotations

from bidexdata.cli import options
from bidexdata.cli.report import finish, table


def hands(
    as_json: options.Json = False, quiet: options.Quiet = False, debug: options.Debug = False
) -> None:
    """List the hands that come with the package.

    --json keys: hands (a list of name, description, licence).
    """
    from bidexdata.hands import hand_names
    from bidexdata.hands.registry import hand_spec

    specs = {name: hand_spec(name) for name in hand_names()}
    found = [
        {"name": name, "description": s.description, "licence": s.licence}
        for name, s in specs.items()
    ]
    lines = table([[f["name"], f["licence"], f["description"]] for f in found])
    finish({"hands": found}, lines, as_json=as_json, quiet=quiet)


def protocols(
    as_json: options.Json = False, quiet: options.Quiet = False, debug: options.Debug = False
) -> None:
    """List the validation protocols.

    --json keys: protocols (a list of name, tests, description, settings).
    """
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
    finish({"protocols": found}, lines, as_json=as_json, quiet=quiet)


def presets(
    as_json: options.Json = False, quiet: options.Quiet = False, debug: options.Debug = False
) -> None:
    """List the presets of synth, and what each changes.

    --json keys: presets (a list of name, description, changes: key, value, reason).
    """
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
    finish({"presets": found}, lines, as_json=as_json, quiet=quiet)
