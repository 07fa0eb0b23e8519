"""Write a dictionary of numbers, text and arrays of numbers as `numpy.save` does, for any numpy.

numpy 2 names its modules in pickles as numpy 1 does not know them; the old names are known to both.
"""

from __future__ import annotations

import io
import pickle
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

_PROTOCOL = 3
"""Names of globals end with a line feed, so they can be replaced; numpy 1.16 and later read it."""
_NEW, _OLD = b"cnumpy._core.", b"cnumpy.core."


def save_dictionary(path: Path, content: Mapping[str, Any]) -> None:
    """Write a .npy file of one dictionary.

    Args:
        path: The file.
        content: Arrays of numbers, numbers, text, lists of text, by name.
    """
    path.write_bytes(npy_bytes(content))


def npy_bytes(content: Mapping[str, Any]) -> bytes:
    """The bytes of such a file.

    >>> import numpy as np, io
    >>> data = npy_bytes({"x": np.ones(2, np.float32)})
    >>> np.load(io.BytesIO(data), allow_pickle=True).item()["x"].tolist()
    [1.0, 1.0]
    """
    holder = np.empty((), object)
    holder[()] = {name: _plain(value) for name, value in content.items()}
    out = io.BytesIO()
    description = {"descr": "|O", "fortran_order": False, "shape": ()}
    np.lib.format.write_array_header_1_0(out, description)
    return out.getvalue() + pickle.dumps(holder, _PROTOCOL).replace(_NEW, _OLD)


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        assert value.dtype.kind in "fiub", value.dtype
        return value
    if isinstance(value, list | tuple):
        return [_plain(part) for part in value]
    assert isinstance(value, str | float | int), type(value)
    return value
