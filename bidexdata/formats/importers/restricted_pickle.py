"""Read pickled dictionaries of arrays, and lists of them, without letting the file run anything.

A pickle is a program. Here its opcodes are checked first (few, known, no length beyond the file),
and every global that numpy's own pickles name is replaced by a function of this file that builds
plain arrays of numbers and text; any other global is refused. Nothing that a file says reaches
numpy's own constructors, and no result is larger than the file.
"""

from __future__ import annotations

import io
import math
import pickle
import pickletools
import re
import tokenize
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np

from bidexdata.formats.importers.format import BadFile

MAX_BYTES = 64 * 2**20
"""Largest file that is read. Source: ours; 64 MiB are 180,000 grasps of one Shadow hand."""
MAX_OPCODES = 10_000
"""Operations that every pickle may have; a dictionary of ten arrays has about 300."""
BYTES_PER_OPCODE = 4
"""Beyond them an operation may stand for this many bytes, no fewer. Measured: DexGraspNet's files of
numbers by name have 8.3 bytes for each, BimanGrasp's 5.2; empty lists in a row have 1."""
MAX_DEPTH = 8
"""How deep containers may be nested."""
_OPCODES = frozenset(
    {
        *("PROTO", "FRAME", "STOP", "MARK", "POP", "POP_MARK"),
        *("NONE", "NEWTRUE", "NEWFALSE", "BININT", "BININT1", "BININT2", "LONG1", "BINFLOAT"),
        *("SHORT_BINUNICODE", "BINUNICODE", "BINUNICODE8"),
        *("SHORT_BINBYTES", "BINBYTES", "BINBYTES8", "BYTEARRAY8"),
        *("EMPTY_DICT", "SETITEM", "SETITEMS", "EMPTY_LIST", "APPEND", "APPENDS"),
        *("EMPTY_TUPLE", "TUPLE", "TUPLE1", "TUPLE2", "TUPLE3"),
        *("GLOBAL", "STACK_GLOBAL", "REDUCE", "BUILD"),
        *("BINPUT", "LONG_BINPUT", "BINGET", "LONG_BINGET", "MEMOIZE"),
    }
)
"""What pickles of protocol 2 to 5 need for dictionaries of arrays."""
_DTYPE = re.compile(r"[<>|=]?([bifuUS])([1-9][0-9]{0,5})")
_ERRORS = (
    *(pickle.UnpicklingError, EOFError, MemoryError, RecursionError, OverflowError),
    *(ValueError, TypeError, KeyError, IndexError, AttributeError, UnicodeError),
)


def read_npy_dict(data: bytes) -> dict[str, Any]:
    """Read what `numpy.save(file, dictionary)` wrote: numbers, text and arrays of them by name.

    Raises:
        BadFile: It is something else, damaged, too large, or asks for anything but data.
    """
    held = _held_objects(data, 0, "a dictionary of a grasp")
    if not isinstance(held, dict):
        raise BadFile("it holds an object that is not a dictionary of a grasp")
    return _plain(held, {}, MAX_DEPTH)


def read_npy_dicts(data: bytes) -> list[dict[str, Any]]:
    """Read what `numpy.save(file, list of dictionaries)` wrote: an object array with one axis.

    Raises:
        BadFile: It is something else, damaged, too large, or asks for anything but data.
    """
    held = _held_objects(data, 1, "a list of grasps")
    if not isinstance(held, _Objects) or not all(isinstance(part, dict) for part in held.parts):
        raise BadFile("it holds a list of other things than dictionaries of grasps")
    done: dict[int, Any] = {}
    return [_plain(part, done, MAX_DEPTH) for part in held.parts]


def _held_objects(data: bytes, axes: int, wanted: str) -> Any:
    """The one object of a .npy file of Python objects (no axes), or its `_Objects` (one axis)."""
    if len(data) > MAX_BYTES:
        raise BadFile(f"{len(data)} bytes are more than the {MAX_BYTES} that are read of a file")
    stream = io.BytesIO(data)
    shape, dtype = _npy_header(stream)
    if dtype != np.dtype(object) or len(shape) != axes:
        what = _shown(f"{shape} of {dtype}")
        raise BadFile(f"it holds an array {what}, not {wanted}")
    holder = restricted_loads(data[stream.tell() :])
    if not isinstance(holder, _Held):
        raise BadFile(f"it holds an object that is not {wanted}")
    held = holder.value
    found = (len(held.parts),) if isinstance(held, _Objects) else ()
    if found != shape:
        raise BadFile(f"it announces an array {shape} and holds {found}")
    return held


def restricted_loads(data: bytes) -> Any:
    """Load a pickle whose arrays are still the stand-ins of this file.

    Raises:
        BadFile: It is damaged or asks for anything but data.
    """
    _check_opcodes(data)
    try:
        return _Unpickler(io.BytesIO(data)).load()
    except BadFile:
        raise
    except _ERRORS as err:
        raise BadFile(f"its pickle is damaged ({type(err).__name__}: {_line(err)})") from err


def _npy_header(stream: io.BytesIO) -> tuple[tuple[int, ...], np.dtype]:
    from numpy.lib import format as npy

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of the text that numpy takes for Python
            version = npy.read_magic(stream)
            read = npy.read_array_header_1_0 if version == (1, 0) else npy.read_array_header_2_0
            shape, _, dtype = read(stream)
    except (*_ERRORS, SyntaxError, tokenize.TokenError) as err:
        raise BadFile(f"it is no .npy file ({_line(err)})") from err
    return shape, dtype


def _check_opcodes(data: bytes) -> None:
    # genops never allocates what a length prefix promises: it reads what is there and complains.
    most = max(MAX_OPCODES, len(data) // BYTES_PER_OPCODE)
    try:
        for count, (opcode, argument, _) in enumerate(pickletools.genops(data)):
            if opcode.name not in _OPCODES:
                raise BadFile(f"its pickle uses {opcode.name}, which no data needs")
            if count >= most:
                raise BadFile(f"its pickle has more than {most} operations")
            if opcode.name == "LONG_BINPUT" and (argument or 0) > most:
                raise BadFile("its pickle numbers its parts beyond their count")
            if opcode.name == "FRAME" and (argument or 0) > len(data):
                raise BadFile("its pickle announces more bytes than the file has")
    except BadFile:
        raise
    except _ERRORS as err:
        raise BadFile(f"its pickle is damaged ({_line(err)})") from err


class _Unpickler(pickle.Unpickler):
    """Knows the globals of numpy's pickles, under the names of numpy 1 and 2, and no other."""

    def find_class(self, module: str, name: str) -> Any:
        known = _GLOBALS.get((module.replace("numpy.core.", "numpy._core."), name))
        if known is None:
            raise BadFile(
                f"its pickle asks for {_shown(module)}.{_shown(name)}, which no data needs: "
                "it would run code and was not read"
            )
        return known


class _Global:
    """A function under the name of a global; a pickle can call it and do nothing else to it."""

    __slots__ = ("_function",)

    def __init__(self, function: Callable[..., Any]):
        object.__setattr__(self, "_function", function)

    def __call__(self, *args: Any) -> Any:
        return self._function(*args)

    def __setattr__(self, name: str, value: Any) -> None:
        raise BadFile("its pickle changes a function")

    def __setstate__(self, state: Any) -> None:
        raise BadFile("its pickle changes a function")


class _Dtype:
    """A dtype in the making: a code, then the byte order."""

    __slots__ = ("_code", "_order")

    def __init__(self, code: str):
        if not isinstance(code, str) or not _DTYPE.fullmatch(code):
            code = "O" if code in ("O", "O8", "|O") else code
            if code != "O":
                raise BadFile(f"an array of {_shown(str(code))} is neither of numbers nor of text")
        self._code, self._order = code.lstrip("<>|="), "="

    def __setstate__(self, state: Any) -> None:
        if not isinstance(state, tuple) or len(state) < 8 or any(s is not None for s in state[2:5]):
            raise BadFile("an array has a dtype with fields")
        if state[1] not in ("<", ">", "|", "="):
            raise BadFile("an array has a dtype of unknown byte order")
        self._order = state[1]

    @property
    def is_object(self) -> bool:
        return self._code == "O"

    def numpy(self) -> np.dtype:
        if self.is_object:
            raise BadFile("it holds an array of Python objects within its dictionary")
        order = "" if self._order in "|=" else self._order
        return np.dtype(order + self._code)


class _Objects:
    """The parts of an object array with one axis."""

    __slots__ = ("parts",)

    def __init__(self, parts: list[Any]):
        self.parts = parts


class _Held:
    """An array in the making; in the end the array, or the contents of an object array."""

    __slots__ = ("value",)

    def __init__(self) -> None:
        self.value: Any = None

    def __setstate__(self, state: Any) -> None:
        if not isinstance(state, tuple) or len(state) != 5 or not isinstance(state[2], _Dtype):
            raise BadFile("an array has a state that numpy does not write")
        _, shape, dtype, fortran, raw = state
        if dtype.is_object:
            if not isinstance(raw, list) or shape not in ((), (len(raw),)):
                raise BadFile("it holds an array of Python objects")
            if shape == () and len(raw) != 1:
                raise BadFile("it holds an array of Python objects")
            self.value = raw[0] if shape == () else _Objects(raw)
        else:
            self.value = _array(raw, dtype, shape, "F" if fortran else "C")


def _reconstruct(kind: Any, shape: Any, code: Any) -> _Held:
    if kind is not _NDARRAY or shape != (0,):
        raise BadFile("an array begins as numpy's do not")
    return _Held()


def _frombuffer(raw: Any, dtype: Any, shape: Any, order: Any) -> _Held:
    held = _Held()
    held.value = _array(raw, dtype, shape, order)
    return held


def _scalar(dtype: Any, raw: Any = b"") -> _Held:
    held = _Held()
    held.value = _array(raw, dtype, (), "C")[()]
    return held


def _array(raw: Any, dtype: Any, shape: Any, order: Any) -> np.ndarray:
    if not isinstance(dtype, _Dtype) or not isinstance(raw, bytes | bytearray):
        raise BadFile("an array is not made of bytes")
    if not isinstance(shape, tuple) or not all(type(n) is int and n >= 0 for n in shape):
        raise BadFile("an array has no shape")
    kind = dtype.numpy()
    if len(shape) > MAX_DEPTH or math.prod(shape) * kind.itemsize != len(raw):
        raise BadFile(f"an array {shape} of {kind} is given {len(raw)} bytes")
    values = np.frombuffer(bytes(raw), kind).reshape(shape, order="F" if order == "F" else "C")
    return values.astype(kind.newbyteorder("="))  # native, and owned


def _encode(text: Any, codec: Any) -> bytes:
    if not isinstance(text, str) or codec != "latin1":
        raise BadFile("its pickle encodes something else than bytes")
    return text.encode("latin1")


def _dictionary(items: Any = ()) -> dict:
    return dict(items)


_NDARRAY = _Global(lambda *_: _refuse_call())
_GLOBALS = {
    ("numpy._core.multiarray", "_reconstruct"): _Global(_reconstruct),
    ("numpy._core.multiarray", "scalar"): _Global(_scalar),
    ("numpy._core.numeric", "_frombuffer"): _Global(_frombuffer),
    ("numpy", "ndarray"): _NDARRAY,
    ("numpy", "dtype"): _Global(lambda code, *_: _Dtype(code)),
    ("collections", "OrderedDict"): _Global(_dictionary),
    ("_codecs", "encode"): _Global(_encode),
    # Protocol 2 has no bytes of its own: numpy's become latin-1 text, and empty ones this call.
    ("__builtin__", "bytes"): _Global(lambda: b""),
}


def _refuse_call() -> None:
    raise BadFile("an array begins as numpy's do not")


def _plain(value: Any, done: dict[int, Any], depth: int) -> Any:
    """Put arrays in the place of stand-ins; each part is converted once, however often named."""
    if depth < 0:
        raise BadFile(f"its contents are nested more than {MAX_DEPTH} deep")
    if id(value) in done:
        return done[id(value)]
    if isinstance(value, dict):
        if not all(isinstance(k, str | int) for k in value):
            raise BadFile("a key of a dictionary is neither text nor a number")
        made: Any = {k: _plain(v, done, depth - 1) for k, v in value.items()}
    elif isinstance(value, list | tuple):
        made = [_plain(v, done, depth - 1) for v in value]
    elif isinstance(value, _Held):
        if not isinstance(value.value, np.ndarray | np.generic):
            raise BadFile("it holds an array of Python objects within its dictionary")
        made = value.value
    elif value is None or isinstance(value, bool | int | float | str | bytes | bytearray):
        made = value
    else:
        raise BadFile("it holds something that is neither a number nor text")
    done[id(value)] = made
    return made


def _line(err: BaseException) -> str:
    return _shown(str(err).strip() or type(err).__name__, 120)


def _shown(text: str, most: int = 60) -> str:
    """Text of the file in a form that stays on one line."""
    return ascii(text)[1:-1][:most]
