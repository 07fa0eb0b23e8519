"""Every key of a configuration for a person: value, unit, meaning and source.

The texts are the docstrings below the fields of the configuration's dataclasses, so a key cannot be
listed without one and the list cannot be out of date.
"""

from __future__ import annotations

import ast
import dataclasses
import inspect
import json
import re
import textwrap
from collections.abc import Iterator
from typing import Any, NamedTuple

_SOURCES = (
    "BODex|BimanGrasp|DexGraspBench|Measured|Measurements|Not in|Ours|Paper|Protocol|The fork"
)
"""How a sentence begins that says where a value is from."""


class ConfigKey(NamedTuple):
    """One key of `--set`."""

    key: str
    value: Any
    unit: str
    """`-` for a ratio or a count that says so, empty where the text states none."""
    meaning: str
    source: str
    """Where the value is from; empty where the text does not say."""

    def cells(self) -> list[str]:
        """Cells for `report.table`; the value is spelled as `--set` reads it."""
        unit = "" if self.unit in ("", "-") else self.unit
        text = f"{self.meaning} ({self.source})" if self.source else self.meaning
        return [self.key, json.dumps(self.value), unit, text]


class ConfigGroup(NamedTuple):
    """A part of a configuration: one dataclass."""

    name: str
    """Dotted, as before the last dot of its keys."""
    meaning: str
    keys: tuple[ConfigKey, ...]
    """Its own, without those of the groups in it."""


def config_groups(config: Any, name: str = "", meaning: str = "") -> Iterator[ConfigGroup]:
    """Yield the groups of a nested configuration, each before those in it, and their keys.

    A value that is not its class's default has the source that the group's own text states.
    """
    from bidexdata.config import to_plain

    texts, plain = _field_texts(type(config)), to_plain(config)
    of_group = _parts_of(meaning)[2]
    keys, inner = [], []
    for field in dataclasses.fields(config):
        if field.name not in plain:  # left out where it is None: no key of `--set`
            continue
        value, text = getattr(config, field.name), texts.get(field.name, "")
        key = f"{name}.{field.name}" if name else field.name
        if dataclasses.is_dataclass(value):
            inner.append((value, key, text or _first_line(value)))
        else:
            unit, says, source = _parts_of(text)
            if of_group and value != _default(field):
                source = of_group
            keys.append(ConfigKey(key, plain[field.name], unit, says, source))
    if keys:
        yield ConfigGroup(name, meaning, tuple(keys))
    for value, key, text in inner:
        yield from config_groups(value, key, text)


def _default(field: dataclasses.Field) -> Any:
    made = field.default_factory
    return field.default if made is dataclasses.MISSING else made()


def _first_line(config: Any) -> str:
    return (inspect.getdoc(type(config)) or "").partition("\n")[0]


def _field_texts(cls: type) -> dict[str, str]:
    """The string below each field of a class, in one line."""
    tree = ast.parse(textwrap.dedent(inspect.getsource(cls)))
    (definition,) = tree.body
    assert isinstance(definition, ast.ClassDef)
    found, last = {}, ""
    for node in definition.body:
        if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            last = node.target.id
        elif isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and last:
            found[last] = " ".join(str(node.value.value).split())
            last = ""
        else:
            last = ""
    return found


def _parts_of(text: str) -> tuple[str, str, str]:
    """Cut a field's text into unit, meaning and source.

    >>> _parts_of("Weight of E [1/m2]. Measurements, 4; paper 5.2 has 100.")
    ('1/m2', 'Weight of E', 'Measurements, 4; paper 5.2 has 100')
    """
    found = re.search(rf"(?:^|(?<=[.;:)] ))(?:{_SOURCES})\b", text)
    meaning, source = (text[: found.start()], text[found.start() :]) if found else (text, "")
    units = re.findall(r" \[([^\]]+)\]", meaning)
    if len(units) == 1:
        meaning = meaning.replace(f" [{units[0]}]", "")
    clean = [part.strip().rstrip(".;:") for part in (meaning, source)]
    return units[0] if len(units) == 1 else "", clean[0], clean[1]
