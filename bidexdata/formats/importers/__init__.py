"""Importers: one small adapter per foreign format; everything else about a record is shared.

An adapter is a `Format` (format.py): which files it reads, what one file holds, where its objects
are. To add a format, write such a module and name it in `FORMATS`. Conversion to our frames, sizes
and ids is `rows.py`; what joins it all to the disk is `runs/import_.py`.
"""

from __future__ import annotations

from importlib import import_module

from bidexdata.errors import UnknownName
from bidexdata.formats.importers.format import Format

_NAMES = ("dexgraspbench", "bodex", "dexgraspnet", "bimangrasp", "bimandexgraspbench")
FORMATS = {name: f"{__name__}.{name}" for name in _NAMES}
"""Name on the command line -> module with `FORMAT`."""


def load_format(name: str) -> Format:
    """Load an adapter.

    Raises:
        UnknownName: No format is called so.
    """
    if name not in FORMATS:
        raise UnknownName("import format", name, FORMATS)
    return import_module(FORMATS[name]).FORMAT
