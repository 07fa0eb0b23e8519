"""Hostile files are refused by every importer: nothing in them runs, nothing large is allocated."""

from __future__ import annotations

import io
import os
import pickle
import struct
import tracemalloc

import numpy as np
import pytest
from made_dexgraspbench import made_grasp
from made_named_qpos import as_list, bodex_grasps, one_hand, two_hands

from bidexdata.formats.importers import FORMATS, load_format
from bidexdata.formats.importers.format import BadFile

RNG = np.random.default_rng(0)
GOOD = {
    "dexgraspbench": lambda: made_grasp(RNG, "a", 0.1),
    "bimandexgraspbench": lambda: made_grasp(RNG, "a", 0.1),
    "bodex": lambda: bodex_grasps(RNG, 2),
    "dexgraspnet": lambda: [one_hand(RNG, 0.1), one_hand(RNG, 0.1)],
    "bimangrasp": lambda: [two_hands(RNG, 0.1), two_hands(RNG, 0.1)],
}
"""What a file of each format holds; those with one axis are lists."""
LISTS = {"dexgraspnet", "bimangrasp"}


class Payload:
    def __init__(self, function, *args):
        self.call = function, args

    def __reduce__(self):
        return self.call


def holder(form: str, extra) -> np.ndarray:
    """The object array of a good file with one more entry."""
    content = GOOD[form]()
    if form in LISTS:
        content[0]["extra"] = extra
        return as_list(content)
    array = np.empty((), object)
    array[()] = {**content, "extra": extra}
    return array


def file_of(form: str, content: bytes) -> bytes:
    """A .npy file of an object array whose pickle is `content`."""
    out = io.BytesIO()
    shape = (2,) if form in LISTS else ()
    described = {"descr": "|O", "fortran_order": False, "shape": shape}
    np.lib.format.write_array_header_1_0(out, described)
    return out.getvalue() + content


def refused(form: str, data: bytes) -> str:
    with pytest.raises(BadFile) as caught:
        load_format(form).read(data, "a/b_grasp.npy")
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_every_format_is_attacked_here():
    assert set(GOOD) == set(FORMATS)


@pytest.mark.parametrize("protocol", [2, 3, 4, 5])
@pytest.mark.parametrize("form", FORMATS)
def test_a_command_is_named_and_does_not_run(form, protocol, tmp_path):
    mark = tmp_path / "ran"
    content = pickle.dumps(holder(form, Payload(os.system, f"touch {mark}")), protocol)
    assert "system, which no data needs" in refused(form, file_of(form, content))
    assert not mark.exists()
    pickle.loads(content)  # noqa: S301  (our own: the file does what the test says)
    assert mark.exists()


@pytest.mark.parametrize("form", FORMATS)
def test_a_tensor_s_nested_load_is_refused(form):
    content = pickle.dumps(holder(form, Payload(os.system, "true")), 2)
    named = f"c{os.system.__module__}\nsystem\n".encode()
    assert named in content
    content = content.replace(named, b"ctorch.storage\n_load_from_bytes\n")
    assert "torch.storage._load_from_bytes" in refused(form, file_of(form, content))


@pytest.mark.parametrize("form", FORMATS)
def test_a_claim_of_a_terabyte_allocates_nothing(form):
    whole = pickle.dumps(holder(form, b"abc" * 100), 4)
    at = whole.index(b"B" + struct.pack("<I", 300))  # BINBYTES of 300 bytes
    claims = [
        # BINBYTES8, BINUNICODE8 and BYTEARRAY8 of 2^40 bytes in the place of the 300.
        *(
            whole[:at] + op + struct.pack("<Q", 2**40) + whole[at + 5 :]
            for op in (b"\x8e", b"\x8d")
        ),
        b"\x80\x05\x96" + struct.pack("<Q", 2**40) + whole[2:],
        # A frame, and a place in the memo, beyond all memory.
        b"\x80\x04\x95" + struct.pack("<Q", 2**40) + whole[11:],
        b"\x80\x04]r\xff\xff\xff\x7f" + whole[2:],
    ]
    for content in claims:
        tracemalloc.start()
        refused(form, file_of(form, content))
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert peak < 2**24


@pytest.mark.parametrize("form", FORMATS)
def test_an_array_that_says_it_is_a_terabyte_is_refused(form):
    content = pickle.dumps(holder(form, np.zeros(3, np.float32)), 3)
    at = content.index(b"K\x03\x85", content.index(b"extra"))  # (3,)
    huge = pickle.dumps(2**40, 3)[2:-1]
    claim = content[:at] + huge + b"\x85" + content[at + 3 :]
    assert "is given 12 bytes" in refused(form, file_of(form, claim))


@pytest.mark.parametrize("form", FORMATS)
def test_no_damage_of_a_good_file_raises_anything_else(form):
    array = np.empty((), object)
    array[()] = GOOD[form]()
    whole = file_of(form, pickle.dumps(as_list(array[()]) if form in LISTS else array, 4))
    rng, reasons = np.random.default_rng(1), 0
    for _ in range(400):
        data = bytearray(whole)
        for at in rng.integers(0, len(data), rng.integers(1, 4)):
            data[at] = rng.integers(256)
        try:
            load_format(form).read(bytes(data), "a/b_grasp.npy")
        except BadFile:
            reasons += 1
    assert reasons > 0
