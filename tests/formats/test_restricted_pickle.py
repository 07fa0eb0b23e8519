"""Foreign pickles give arrays or one sentence; nothing in them runs."""

import io
import os
import pickle
import pickletools
import struct
from collections import OrderedDict

import numpy as np
import pytest

from bidexdata.formats.importers import restricted_pickle
from bidexdata.formats.importers.format import BadFile
from bidexdata.formats.importers.restricted_pickle import (
    BYTES_PER_OPCODE,
    MAX_OPCODES,
    read_npy_dict,
    read_npy_dicts,
)

GOOD = {
    "f4": np.arange(6, dtype=np.float32).reshape(2, 3),
    "f8 fortran": np.asfortranarray(np.arange(6.0).reshape(2, 3)),
    "big endian": np.arange(3, dtype=">i4"),
    "scalar": np.float64(0.06),
    "bools": np.array([True, False]),
    "words": np.array(["rh_FFJ4", "é"]),
    "nothing": np.zeros((0, 29), np.float32),
    "text": "assets/object",
    "number": 7,
    "list": [1, 2.5, None, True, ("a", b"b")],
    "inner": OrderedDict(a=np.ones(2)),
}


def npy(content: bytes) -> bytes:
    """A .npy file of an object whose pickle is `content`."""
    head = io.BytesIO()
    description = {"descr": "|O", "fortran_order": False, "shape": ()}
    np.lib.format.write_array_header_1_0(head, description)
    return head.getvalue() + content


def held(value, protocol: int = 3) -> bytes:
    """The pickle that numpy writes of a 0-d object array with `value`."""
    array = np.empty((), object)
    array[()] = value
    return pickle.dumps(array, protocol=protocol)


def same(a, b) -> bool:
    if isinstance(a, np.ndarray | np.generic):
        return a.dtype == np.asarray(b).dtype.newbyteorder("=") and np.array_equal(a, b)
    if isinstance(a, dict):
        return a.keys() == b.keys() and all(same(a[k], b[k]) for k in a)
    if isinstance(a, list):
        return len(a) == len(b) and all(same(x, y) for x, y in zip(a, b, strict=True))
    return a == b


@pytest.mark.parametrize("protocol", [2, 3, 4, 5])
def test_what_numpy_writes_is_read_to_the_bit(protocol):
    found = read_npy_dict(npy(held(GOOD, protocol)))
    assert list(found) == list(GOOD)
    for name, value in GOOD.items():
        assert same(found[name], value), name
    assert found["f4"].dtype == np.float32


def test_what_numpy_save_writes_is_read(tmp_path):
    np.save(tmp_path / "a.npy", {"x": np.ones(3)}, allow_pickle=True)
    assert read_npy_dict((tmp_path / "a.npy").read_bytes())["x"].tolist() == [1, 1, 1]


def test_files_of_numpy_1_name_its_modules_otherwise():
    content = held({"x": np.ones(3), "y": np.float64(2)}, 3)
    assert b"numpy._core.multiarray" in content
    found = read_npy_dict(npy(content.replace(b"numpy._core.", b"numpy.core.")))
    assert found["x"].tolist() == [1, 1, 1]
    assert found["y"] == 2


def listed(parts) -> bytes:
    """A .npy file as `numpy.save(file, list of dictionaries)` writes it."""
    out = io.BytesIO()
    np.save(out, np.array([*parts, None], object)[:-1], allow_pickle=True)
    return out.getvalue()


def test_a_list_of_dictionaries_is_read_to_the_bit():
    rows = [{"qpos": {"a": 0.1 * k, "b": -0.0}, "scale": np.float64(k)} for k in range(5)]
    found = read_npy_dicts(listed(rows))
    assert len(found) == 5
    assert all(same(a, b) for a, b in zip(found, rows, strict=True))
    assert read_npy_dicts(listed([])) == []
    assert same(read_npy_dicts(listed([GOOD]))[0], GOOD)


def test_one_and_several_are_not_taken_for_each_other():
    with pytest.raises(BadFile, match=r"array \(2,\) of object, not a dictionary"):
        read_npy_dict(listed([{}, {}]))
    with pytest.raises(BadFile, match=r"array \(\) of object, not a list of grasps"):
        read_npy_dicts(npy(held({})))
    with pytest.raises(BadFile, match="other things than dictionaries"):
        read_npy_dicts(listed([{}, 1]))
    whole = listed([{"a": 1}, {"b": 2}])
    with pytest.raises(BadFile, match=r"announces an array \(9,\) and holds \(2,\)"):
        read_npy_dicts(whole.replace(b"(2,)", b"(9,)"))
    square = np.empty((1, 1), object)
    square[0, 0] = {}
    out = io.BytesIO()
    np.save(out, square, allow_pickle=True)
    with pytest.raises(BadFile, match=r"array \(1, 1\) of object"):
        read_npy_dicts(out.getvalue())


def test_operations_may_grow_with_the_file_and_no_faster():
    many = [{"qpos": {f"joint {j}": 0.1 * j for j in range(28)}} for _ in range(800)]
    data = listed(many)
    count = sum(1 for _ in pickletools.genops(data[128:]))
    assert MAX_OPCODES < count < len(data) / BYTES_PER_OPCODE
    assert len(read_npy_dicts(data)) == 800
    flood = b"\x80\x04" + b"]" * (BYTES_PER_OPCODE * MAX_OPCODES) + b"."
    with pytest.raises(BadFile, match="more than 10000 operations"):
        read_npy_dict(npy(flood))


class Payload:
    def __init__(self, function, *args):
        self.call = function, args

    def __reduce__(self):
        return self.call


@pytest.mark.parametrize("protocol", [2, 3, 4, 5])
def test_a_payload_is_named_and_does_not_run(tmp_path, protocol):
    mark = tmp_path / "ran"
    content = held({"x": Payload(os.system, f"touch {mark}")}, protocol)
    with pytest.raises(BadFile, match=r"asks for \w+\.system, which no data needs") as caught:
        read_npy_dict(npy(content))
    assert not mark.exists()
    assert "\n" not in str(caught.value)
    pickle.loads(content)  # noqa: S301  (our own: the file does what the test says)
    assert mark.exists()


@pytest.mark.parametrize(
    ("value", "said"),
    [
        (Payload(eval, "1"), "builtins.eval"),
        (Payload(getattr, "", "join"), "builtins.getattr"),
        (Payload(np.load, "x"), "asks for numpy"),
        (Payload(np.zeros, 5), "asks for numpy"),
        (np.array([{}, 1], object), "Python objects"),
        (np.array({}, object), "Python objects within"),
        (np.array([(1, 2.0)], [("a", "i4"), ("b", "f8")]), "neither of numbers nor of text"),
        (np.array(["2020"], "datetime64[D]"), "neither of numbers nor of text"),
        (np.ones(2, np.complex64), "neither of numbers nor of text"),
        ({(1, 2): 3}, "neither text nor a number"),
        (3 + 4j, "asks for builtins.complex"),
    ],
)
def test_anything_but_numbers_and_text_is_refused_in_one_sentence(value, said):
    with pytest.raises(BadFile) as caught:
        read_npy_dict(npy(held({"x": value})))
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


def array_pickle(shape: tuple, raw: bytes, code: str = "f4") -> bytes:
    """What numpy writes of an array, with any shape and bytes."""
    content = held({"x": np.zeros(3, np.float32)}, 3)
    old_shape, old_raw = pickle.dumps((3,), 3)[2:-1], pickle.dumps(b"\0" * 12, 3)[2:-3]
    content = content.replace(old_raw, pickle.dumps(raw, 3)[2:-3], 1)
    assert old_shape[:3] in content
    made = pickletools.genops(content)
    assert made is not None
    at = content.index(b"K\x03\x85", content.index(b"ndarray"))
    return (
        content[:at]
        + b"".join(pickle.dumps(n, 3)[2:-1] for n in shape)
        + b"\x85"
        + content[at + 3 :].replace(b"f4", code.encode(), 1)
    )


def test_a_shape_that_is_not_its_bytes_is_refused():
    assert read_npy_dict(npy(array_pickle((3,), b"\0" * 12)))["x"].tolist() == [0, 0, 0]
    for shape in ((2**31,), (2**40,), (4,), (0,)):
        with pytest.raises(BadFile, match="is given 12 bytes"):
            read_npy_dict(npy(array_pickle(shape, b"\0" * 12)))


@pytest.mark.parametrize("opcode", [b"\x8e", b"\x8d", b"\x96"])  # bytes, text, bytearray
def test_a_huge_length_prefix_allocates_nothing(opcode):
    content = b"\x80\x05" + opcode + struct.pack("<Q", 2**40) + b"abc."
    with pytest.raises(BadFile, match="damaged"):
        read_npy_dict(npy(content))


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"\x80\x04]r\xff\xff\xff\x7f.", "beyond their count"),
        (b"\x80\x04\x95" + struct.pack("<Q", 2**62) + b"N.", "more bytes than the file has"),
        (b"\x80\x04" + b"]" * 20_000 + b".", "more than 10000 operations"),
        (b"\x80\x04N2.", "uses DUP"),
        (b"cos\nsystem\n(S'true'\ntR.", "uses STRING"),
        (b"\x80\x04Px\n.", "uses PERSID"),
        (b"\x80\x04N.", "not a dictionary"),
        (b"", "damaged"),
        (b"\x80\x04h\x05.", "damaged"),
    ],
)
def test_programs_that_are_no_data_are_refused(content, said):
    with pytest.raises(BadFile) as caught:
        read_npy_dict(npy(content))
    assert said in str(caught.value)


def test_lists_in_lists_and_lists_of_themselves_end():
    deep: list = []
    for _ in range(20):
        deep = [deep]
    loop: list = []
    loop.append(loop)
    for value in (deep, loop):
        with pytest.raises(BadFile, match="nested more than"):
            read_npy_dict(npy(held({"x": value})))
    many: list = [1]
    for _ in range(7):
        many = [many] * 200  # 200^7 parts, if each were visited as often as it is named
    with pytest.raises(BadFile, match="nested more than"):
        read_npy_dict(npy(held({"x": [many]})))


def test_a_pickle_cannot_change_the_functions_it_is_given():
    # BUILD with a slot state would set any attribute of the global under it.
    change = b"\x80\x04cnumpy\ndtype\nN}\x8c\x04call\x8c\x01xs\x86b."
    with pytest.raises(BadFile, match="changes a function"):
        read_npy_dict(npy(change))


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (b"", "no .npy file"),
        (b"not numpy at all", "no .npy file"),
        (b"\x93NUMPY\x01\x00\xff\xff{", "no .npy file"),
    ],
)
def test_other_files_are_named(data, said):
    with pytest.raises(BadFile, match=said):
        read_npy_dict(data)


def test_plain_arrays_and_large_files_are_refused(monkeypatch):
    out = io.BytesIO()
    np.save(out, np.ones((4, 29)))
    with pytest.raises(BadFile, match=r"array \(4, 29\) of float64, not a dictionary"):
        read_npy_dict(out.getvalue())
    monkeypatch.setattr(restricted_pickle, "MAX_BYTES", 10)
    with pytest.raises(BadFile, match="more than the 10 that are read"):
        read_npy_dict(out.getvalue())


def test_no_damage_raises_anything_else():
    whole = npy(held({"x": np.arange(5, dtype=np.float32), "y": "text", "z": [1, 2]}, 4))
    rng = np.random.default_rng(0)
    damaged = [whole[:n] for n in range(len(whole))]
    for _ in range(3000):
        data = bytearray(whole)
        for at in rng.integers(0, len(data), rng.integers(1, 4)):
            data[at] = rng.integers(256)
        damaged.append(bytes(data))
    reasons = []
    for data in damaged:
        try:
            read_npy_dict(data)
        except BadFile as bad:
            reasons.append(str(bad))
    assert len(reasons) > len(damaged) / 2
    assert not any("\n" in text or len(text) > 400 for text in reasons)
