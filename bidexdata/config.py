"""Configuration as frozen dataclasses: to and from plain data, overrides, fingerprints.

One dataclass per stage lives beside its stage; this file knows none of them. An unknown key is an
error that names the nearest known one. The canonical JSON of a configuration gives its
fingerprint, which every file made with it carries.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import types
import typing
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

from bidexdata.errors import BadConfig, PathNotFound, UnknownChoice, UnknownKey, UnknownName
from bidexdata.yaml_lines import Located, parse_yaml, say_line

T = TypeVar("T")

OMIT_NONE = {"omit_none": True}
"""Metadata of a field that plain data leaves out where it is None: a key added to a published
configuration, whose fingerprint stays what it was."""


def to_plain(config: Any, *, whole: bool = False) -> Any:
    """Turn a (nested) dataclass into dicts, lists and scalars that JSON can hold.

    Args:
        config: A dataclass, or what its fields hold.
        whole: Give the keys too that plain data leaves out.
    """
    if dataclasses.is_dataclass(config) and not isinstance(config, type):
        values = ((f, getattr(config, f.name)) for f in dataclasses.fields(config))
        return {
            f.name: to_plain(value, whole=whole)
            for f, value in values
            if whole or value is not None or not f.metadata.get("omit_none", False)
        }
    if isinstance(config, Mapping):
        return {str(k): to_plain(v, whole=whole) for k, v in config.items()}
    if isinstance(config, (list, tuple)):
        return [to_plain(v, whole=whole) for v in config]
    if isinstance(config, Path):
        return config.as_posix()
    return config


def from_plain(cls: type[T], data: Any, where: str | None = None) -> T:
    """Build dataclass `cls` from plain data.

    Args:
        cls: A frozen dataclass; nested dataclasses and tuples are rebuilt too.
        data: Keys are field names; missing keys take the field's default.
        where: How messages name this level; the class name when omitted. Empty: keys stand alone,
            as a person types them. With a colon at its end (a file's name) they follow it.

    Raises:
        UnknownKey: A key of `data` is no field of `cls`.
        BadConfig: A value has the wrong type, or `cls` itself refuses it. Of data from a YAML file
            the message names the line too.
    """
    where = cls.__name__ if where is None else where
    if not isinstance(data, Mapping):
        raise BadConfig(f"{_level(where)} must be a mapping of keys to values, not {data!r}")
    fields = {f.name: f for f in dataclasses.fields(cls)}  # type: ignore[arg-type]
    hints = typing.get_type_hints(cls)
    kwargs = {}
    for key, value in data.items():
        try:
            if key not in fields:
                raise UnknownKey(key, sorted(fields), _level(where))
            kwargs[key] = _convert(hints[key], value, _key(where, key))
        except BadConfig as err:
            say_line(err, data, key)
            raise
    try:
        return cls(**kwargs)
    except BadConfig as err:
        # A class says Class.field: under which key it stands only this level knows.
        said, own = str(err), f"{cls.__name__}."
        named = next((key for key in data if said.startswith(f"{own}{key} ")), "")
        err.args = (said.replace(own, _key(where, ""), 1),)
        say_line(err, data, named)
        raise


def canonical_json(data: Any) -> str:
    """Write plain data or a dataclass as JSON with one spelling: sorted keys, no spaces."""
    return json.dumps(to_plain(data), sort_keys=True, separators=(",", ":"), allow_nan=False)


def fingerprint(data: Any, length: int = 16) -> str:
    """Hash the canonical JSON of `data`: hex digits, the first `length` of its sha256."""
    return hashlib.sha256(canonical_json(data).encode()).hexdigest()[:length]


def differing_keys(old: Mapping[str, Any], new: Mapping[str, Any], prefix: str = "") -> list[str]:
    """Name the dotted keys whose values differ, with both values: `a.b: 1 -> 2`."""
    found: list[str] = []
    for key in sorted(set(old) | set(new)):
        a, b = old.get(key), new.get(key)
        if isinstance(a, Mapping) and isinstance(b, Mapping):
            found += differing_keys(a, b, f"{prefix}{key}.")
        elif a != b:
            found.append(f"{prefix}{key}: {a!r} -> {b!r}")
    return found


def with_overrides(config: T, assignments: Sequence[str]) -> T:
    """Apply `--set` assignments such as `regions.anchors=100` to a dataclass.

    Values are read as YAML, so `true`, `0.5` and `[1, 2]` mean what they look like.

    Raises:
        BadConfig: An assignment has no `=` or a value does not fit.
        UnknownKey: A key does not exist.
        UnknownChoice: A value is none of the words that its key takes.
    """
    plain = to_plain(config, whole=True)
    for assignment in assignments:
        key, sep, text = assignment.partition("=")
        if not (sep and key.strip()):
            raise BadConfig(
                f"--set {assignment!r}: write KEY=VALUE, for example regions.anchors=100"
            )
        _assign(plain, key.strip().split("."), parse_yaml(text, f"--set {key}"), key)
    return from_plain(type(config), plain, "")


def load_yaml(path: str | Path) -> dict[str, Any]:
    """Read a YAML file that holds one mapping.

    Raises:
        PathNotFound: The file does not exist.
        BadConfig: It cannot be read, is no text, no YAML, or no mapping.
    """
    path = Path(path)
    if not path.is_file():
        raise PathNotFound(path, "a YAML file")
    try:
        text = path.read_text(encoding="utf-8")
    except UnicodeDecodeError as err:
        raise BadConfig(f"{path}: not a text file ({err.reason})") from err
    except OSError as err:
        raise BadConfig(f"{path}: cannot be read ({err.strerror})") from err
    data = parse_yaml(text, str(path))
    if not isinstance(data, dict):
        raise BadConfig(f"{path}: expected a mapping of keys to values at the top")
    return data


def named_yaml(kind: str, name: str, known: Sequence[str], folder: Path) -> Path:
    """Find the YAML file of something that comes with the package, or that a path names.

    Args:
        kind: What it is, for the message.
        name: One of `known`, or a path.
        known: Files of `folder`, without their ending.
        folder: Of the package.

    Raises:
        UnknownName: Nothing has this name and no file this path.
    """
    if name in known:
        return folder / f"{name}.yaml"
    path = Path(name)
    if path.suffix not in (".yaml", ".yml"):
        raise UnknownName(kind, name, known, hint="the path of a YAML spec works too")
    if not path.is_file():
        raise UnknownName(kind, name, known, hint="and there is no such file")
    return path.resolve()


def merge(base: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """Overlay nested plain data: mappings merge key by key, everything else is replaced.

    Lines are those of the changes.
    """
    merged = Located(base)
    merged.lines = dict(changes.lines) if isinstance(changes, Located) else {}
    for key, value in changes.items():
        old = merged.get(key)
        both = isinstance(old, Mapping) and isinstance(value, Mapping)
        merged[key] = merge(old, value) if both else value  # type: ignore[arg-type]
    return merged


def refuse_outside(owner: object, name: str, low: float | int, high: float | int) -> None:
    """Refuse a field of a configuration that lies outside its range; for `__post_init__`.

    Args:
        owner: The configuration.
        name: Of its field.
        low: Least value that the field may have.
        high: Largest.

    Raises:
        BadConfig: `owner.name` is below `low`, above `high`, or no number.
    """
    value = getattr(owner, name)
    if not low <= value <= high:
        where = type(owner).__name__
        raise BadConfig(f"{where}.{name} must lie between {low:g} and {high:g}, not {value!r}")


def _key(where: str, key: str) -> str:
    """Name a key of a level: `regions.anchors`, `file.yaml: anchors`, or `anchors` at the top."""
    if where.endswith(":"):
        return f"{where} {key}"
    return f"{where}.{key}" if where else key


def _level(where: str) -> str:
    return where.rstrip(":") or "the configuration"


def _assign(plain: dict[str, Any], path: list[str], value: Any, whole: str) -> None:
    top = plain
    for depth, part in enumerate(path[:-1]):
        if not isinstance(plain.get(part), dict):
            raise UnknownKey(part, sorted(plain), _level(".".join(path[:depth])))
        plain = plain[part]
    if path[-1] not in plain:
        deeper = [key for key in _dotted(top) if key.endswith(f".{whole}")]
        raise UnknownKey(path[-1], sorted(plain), _level(".".join(path[:-1])), deeper)
    if isinstance(plain[path[-1]], dict) and not isinstance(value, dict):
        raise BadConfig(f"{whole} is a group; set one of {', '.join(plain[path[-1]])}")
    plain[path[-1]] = value


def _dotted(plain: Mapping[str, Any], prefix: str = "") -> Iterator[str]:
    """Every key below a level, groups left out: `regions.anchors`."""
    for key, value in plain.items():
        if isinstance(value, Mapping):
            yield from _dotted(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}"


def _convert(hint: Any, value: Any, where: str) -> Any:
    origin, args = typing.get_origin(hint), typing.get_args(hint)
    if origin in (typing.Union, types.UnionType):
        if value is None and type(None) in args:
            return None
        return _convert(next(a for a in args if a is not type(None)), value, where)
    if dataclasses.is_dataclass(hint):
        return from_plain(hint, value, where)  # type: ignore[arg-type]
    if origin is tuple:
        return _tuple_of(args, value, where)
    if origin in (dict, Mapping):
        if not isinstance(value, Mapping):
            raise BadConfig(f"{where} must be a mapping of keys to values, not {value!r}")
        return {str(k): _convert(args[1], v, f"{where}.{k}") for k, v in value.items()}
    if origin is typing.Literal:
        if value not in args:
            raise UnknownChoice(where, value, args)
        return value
    return _scalar_of(hint, value, where)


def _tuple_of(kinds: tuple[Any, ...], value: Any, where: str) -> tuple[Any, ...]:
    if not isinstance(value, (list, tuple)):
        raise BadConfig(f"{where} must be a list, not {value!r}")
    kinds = (kinds[0],) * len(value) if kinds[-1] is Ellipsis else kinds
    if len(kinds) != len(value):
        raise BadConfig(f"{where} needs {len(kinds)} values, got {len(value)}")
    return tuple(_convert(k, v, where) for k, v in zip(kinds, value, strict=True))


_KINDS = {int: "a whole number", float: "a number", bool: "true or false", str: "text"}
"""What a value must be, in words for a person."""


def _scalar_of(hint: Any, value: Any, where: str) -> Any:
    if hint is float and isinstance(value, (int, float)) and not isinstance(value, bool):
        return float(value)
    if hint is float and isinstance(value, str):
        return _float_of(value, where)
    if hint in (int, bool, str, float) and type(value) is not hint:
        raise BadConfig(f"{where} must be {_KINDS[hint]}, not {value!r}")
    return value


def _float_of(text: str, where: str) -> float:
    # YAML reads 1e-3 (no dot) as text.
    try:
        return float(text)
    except ValueError as err:
        raise BadConfig(f"{where} must be {_KINDS[float]}, not {text!r}") from err
