"""YAML whose mappings know the line of each of their keys, so that a refusal can say where to look."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from typing import Any

from bidexdata.errors import BadConfig


class Located(dict[str, Any]):
    """A mapping that was read from YAML text."""

    def __init__(self, *args: Any, **kwargs: Any):
        super().__init__(*args, **kwargs)
        self.lines: dict[str, int] = {}
        """Line of each key, counted from 1."""


def parse_yaml(text: str, where: str) -> Any:
    """Read YAML; mappings are `Located`.

    Args:
        text: What to read.
        where: What messages call it.

    Raises:
        BadConfig: It is no YAML.
    """
    import yaml

    try:
        return yaml.load(text, _loader())
    except yaml.MarkedYAMLError as err:
        mark = err.problem_mark or err.context_mark
        line = f", line {mark.line + 1}" if mark and "\n" in text.strip() else ""
        said = err.problem or err.context or "it cannot be read"
        raise BadConfig(f"{where}{line}: not valid YAML ({said})") from err
    except yaml.YAMLError as err:
        raise BadConfig(f"{where}: not valid YAML ({str(err).splitlines()[0]})") from err


def say_line(err: BadConfig, data: Any, key: str) -> None:
    """Add to an error the line of the key whose value it refuses, unless it has one already.

    Args:
        err: What was raised.
        data: The mapping that holds the key; only one from YAML has lines.
        key: The key.
    """
    line = data.lines.get(str(key)) if isinstance(data, Located) else None
    if line is not None and err.line is None:
        err.line = line
        err.args = (f"{err} (line {line})",)


@cache
def _loader() -> Any:
    import yaml

    class Loader(yaml.SafeLoader):
        """Reads plain data only."""

    def mapping(loader: Any, node: Any) -> Iterator[Located]:
        found = Located()
        yield found
        found.update(loader.construct_mapping(node))
        for key, _ in node.value:
            if isinstance(key, yaml.ScalarNode):
                found.lines[key.value] = key.start_mark.line + 1

    Loader.add_constructor("tag:yaml.org,2002:map", mapping)
    return Loader
