"""Turn what `__getitems__` gives into a batch of tensors: rows, cases, and contacts of varying number."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, overload

from bidexdata.errors import BadConfig, UnknownName
from bidexdata.record.fields import columns_of_table

if TYPE_CHECKING:
    import torch

LAYOUTS = ("padded", "packed")
_OF_CONTACT = tuple(n for n in columns_of_table("contacts") if n.startswith("contact_"))


class RowBatch(Sequence[Any]):
    """Rows that were read together: stacked tensors that can also be walked row by row.

    `collate` takes the stacked form as it is. PyTorch's default collate function walks the rows,
    which gives the same batch at the price of a copy per row.
    """

    def __init__(self, stacked: Any, length: int):
        self.stacked = stacked
        self._length = length

    def __len__(self) -> int:
        return self._length

    @overload
    def __getitem__(self, index: int) -> Any: ...
    @overload
    def __getitem__(self, index: slice) -> Sequence[Any]: ...
    def __getitem__(self, index: int | slice) -> Any:
        if isinstance(index, slice):
            return [self[i] for i in range(*index.indices(self._length))]
        if not -self._length <= index < self._length:
            raise IndexError(index)
        if not isinstance(self.stacked, dict):
            return self.stacked[index]
        index %= self._length
        cloud = self.stacked.get("point_index")
        return {
            name: values[index if cloud is None or not name.startswith("cloud_") else cloud[index]]
            for name, values in self.stacked.items()
            if name != "point_index"
        }

    def __iter__(self) -> Iterator[Any]:
        return (self[i] for i in range(self._length))


def collate(rows: Sequence[Any], contacts: str = "padded") -> Any:
    """Give the stacked batch: pass this as `collate_fn` of a DataLoader.

    Args:
        rows: What a data set's `__getitems__` gave, or items.
        contacts: `padded` as stored, or `packed`: see `pack_contacts`. For a DataLoader:
            `collate_fn=functools.partial(collate, contacts="packed")`.

    Raises:
        UnknownName: No such layout of contacts.
        BadConfig: Contacts cannot be packed: there is no `contact_index`.
    """
    if contacts not in LAYOUTS:
        raise UnknownName("layout of contacts", contacts, LAYOUTS)
    if isinstance(rows, RowBatch):
        batch = rows.stacked
    else:
        from torch.utils.data import default_collate

        batch = default_collate(list(rows))
    return pack_contacts(batch) if contacts == "packed" else batch


def pack_contacts(batch: Mapping[str, Any]) -> dict[str, Any]:
    """Put the contacts of all grasps behind each other, without padding.

    Args:
        batch: With `contact_index`, (B, H, C), and any other columns per contact.

    Returns:
        The batch; columns per contact have leading axis K = contacts of all grasps, and besides:
        `contact_offsets`, (B + 1), those of grasp b are [offsets[b], offsets[b + 1]);
        `contact_hand`, (K), their place on the H axis.

    Raises:
        BadConfig: There is no `contact_index`.
    """
    import torch

    if "contact_index" not in batch:
        raise BadConfig("packing contacts needs the field 'contact_index'; add it to fields")
    there = batch["contact_index"] >= 0
    counts = there.flatten(1).sum(1)
    offsets = torch.zeros(len(counts) + 1, dtype=torch.int64, device=counts.device)
    offsets[1:] = counts.cumsum(0)
    packed = {n: v[there] if n in _OF_CONTACT else v for n, v in batch.items()}
    hand = there.nonzero()[:, 1]
    return {**packed, "contact_offsets": offsets, "contact_hand": hand}


def collate_cases(cases: Sequence[Mapping[str, Any]], grasps: str = "packed") -> dict[str, Any]:
    """Make a batch of scenes that hold different numbers of grasps (items of `BiDexCases`).

    Args:
        cases: B items.
        grasps: `packed`: columns have leading axis G = grasps of all scenes, and `case_offsets`,
            (B + 1), says which are whose; `case_index`, (G), the same per grasp. `padded`: columns
            are (B, largest number, ...), filled with NaN, -1, False or "", and `grasp_mask` is True
            where there is a grasp.

    Returns:
        The batch; what there is once per scene (cloud, `object_index`, `scene_id`, `size`, ...) has
        leading axis B.

    Raises:
        UnknownName: No such layout.
    """
    import torch

    if grasps not in LAYOUTS:
        raise UnknownName("layout of grasps", grasps, LAYOUTS)
    counts = torch.tensor([int(case["grasps"]) for case in cases])
    per_grasp = cases[0]["per_grasp"] if cases else ()
    out: dict[str, Any] = {}
    for name in [n for n in cases[0] if n not in ("per_grasp", "grasps")] if cases else []:
        values = [case[name] for case in cases]
        text = not isinstance(values[0], torch.Tensor)
        if name not in per_grasp:
            out[name] = values if text else torch.stack(values)
        elif grasps == "packed":
            out[name] = [v for part in values for v in part] if text else torch.cat(values)
        else:
            out[name] = _padded(values, int(counts.max()), text=text)
    if grasps == "padded":
        out["grasp_mask"] = torch.arange(int(counts.max()) if cases else 0) < counts[:, None]
        return out
    out["case_offsets"] = torch.cat([counts.new_zeros(1), counts.cumsum(0)])
    out["case_index"] = torch.repeat_interleave(torch.arange(len(cases)), counts)
    return out


def as_tensordict(batch: Mapping[str, Any], count: int) -> Any:
    """Give a batch as a `tensordict.TensorDict`; text becomes non-tensor data."""
    from tensordict import NonTensorStack, TensorDict  # pyright: ignore[reportMissingImports]

    plain = {n: NonTensorStack(*v) if isinstance(v, list) else v for n, v in batch.items()}
    return TensorDict(plain, batch_size=[count])


def _padded(values: list[Any], width: int, *, text: bool) -> Any:
    if text:
        return [list(part) + [""] * (width - len(part)) for part in values]
    fill: Any = float("nan")
    if not values[0].is_floating_point():
        fill = -1 if values[0].dtype != _bool() else False
    out = values[0].new_full((len(values), width, *values[0].shape[1:]), fill)
    for row, part in zip(out, values, strict=True):
        row[: len(part)] = part
    return out


def _bool() -> torch.dtype:
    import torch

    return torch.bool
