"""Whether batches are equal bit by bit, NaN included."""

import torch

EVERYTHING = ("hand_pos", "hand_quat_wxyz", "joints", "size_mm", "suc_f", "pd", "grasp_id", "contact_point", "contact_index", "attempt")  # fmt: skip


def same_batches(a, b) -> bool:
    return len(a) == len(b) and all(
        x.keys() == y.keys()
        and all(
            torch.equal(torch.nan_to_num(x[k]), torch.nan_to_num(y[k]))
            if isinstance(x[k], torch.Tensor)
            else x[k] == y[k]
            for k in x
        )
        for x, y in zip(a, b, strict=True)
    )
