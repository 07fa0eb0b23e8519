"""A reader of releases written from docs/format.md alone: json, numpy and pyarrow, no bidexdata."""

import hashlib
import json
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq

MAJOR = "1"


class PlainRelease:
    def __init__(self, root):
        self.root = Path(root)
        text = (self.root / "manifest.json").read_bytes()
        line = (self.root / "manifest.sha256").read_text()
        assert line == f"{hashlib.sha256(text).hexdigest()}  manifest.json\n"
        self.manifest = json.loads(text)
        assert self.manifest["format"] == "bidexdata-release"
        if self.manifest["schema_version"].split(".")[0] != MAJOR:
            raise ValueError("another major version of the schema")
        header = json.loads(self.manifest["header"])
        self.hands, self.arms = header["hands"], header.get("arms", [])

    def damaged(self):
        """Files whose bytes are not those of the manifest."""
        return [
            name
            for name, said in self.manifest["files"].items()
            if hashlib.sha256((self.root / name).read_bytes()).hexdigest() != said["sha256"]
        ]

    @property
    def axes(self):
        sizes = {"H": len(self.hands), "S": 3}
        sizes["J"] = max([1, *(len(h["joint_names"]) for h in self.hands)])
        sizes["C"] = max([1, *(len(h["contact_names"]) for h in self.hands)])
        sizes["K"], sizes["W"] = 6, 1 + sum(self.arms[0]["knots"]) if self.arms else 1
        sizes["A"] = max([1, *(len(a["joint_names"]) for a in self.arms)])
        return sizes

    def table(self, name, configuration="selected"):
        """All rows of a row table, column by column: arrays, and lists where there may be null."""
        head, _, rest = name.partition("/")
        suffix = "" if configuration == "selected" else f"_{configuration}"
        found = {}
        for split, _ in self.manifest["splits"]:
            for path in sorted((self.root / f"{head}{suffix}" / rest).glob(f"{split}-*.parquet")):
                file = pq.ParquetFile(path, page_checksum_verification=True)
                for field, column in zip(file.schema_arrow, file.read().itercolumns(), strict=True):
                    found.setdefault(field.name, []).append(self._values(field, column))
        return {name: self._joined(parts) for name, parts in found.items()}

    @staticmethod
    def _joined(parts):
        if parts[0].dtype == object:
            return [value for part in parts for value in part]
        return np.concatenate(parts)

    def _values(self, field, column):
        array = column.combine_chunks()
        if field.nullable or str(field.type) == "string":
            return np.array([*array.to_pylist(), None], object)[:-1]
        if not hasattr(field.type, "list_size"):
            return array.to_numpy(zero_copy_only=False)
        letters = field.metadata[b"shape"].decode().split()
        shape = [self.axes[x] if x in self.axes else int(x) for x in letters]
        return array.flatten().to_numpy().reshape(-1, *shape)

    def tree(self, h):
        hand = self.hands[h]
        path = self.root / "hands" / hand["name"] / hand["side"] / "tree.json"
        return json.loads(path.read_text())

    def rig(self):
        path = self.root / "rigs" / self.arms[0]["rig"] / "rig.json"
        return json.loads(path.read_text())

    def key_frames(self, arm_path):
        """Angles of both arms at the key frames of one motion, (H, K, A)."""
        return arm_path[:, np.cumsum([0, *self.arms[0]["knots"]])]

    def hand_on_arm(self, chain, q):
        """Where the angles of one arm put the frame `hand` in the world: (3,), (3, 3)."""
        R, p = np.eye(3), np.zeros(3)
        for k in range(len(chain["joint_names"])):
            p = p + R @ np.array(chain["before_pos"][k])
            half = float(q[k]) / 2
            turn = rotation([np.cos(half), *(np.sin(half) * np.array(chain["axis"][k]))])
            R = R @ np.array(chain["before_rot"][k]) @ turn
        return p + R @ np.array(chain["end_pos"]), R @ np.array(chain["end_rot"])

    def points_in_world(self, tree, body_points, joints, pos, quat):
        """Points of bodies, a list of (body, p), in the world: (len(body_points), 3)."""
        R, p = [np.eye(3)], [np.zeros(3)]
        for b in range(1, len(tree["body_names"])):
            parent = tree["body_parent"][b]
            p.append(p[parent] + R[parent] @ np.array(tree["body_pos"][b]))
            turned = R[parent] @ rotation(tree["body_quat_wxyz"][b])
            joint = tree["body_joint"][b]
            if joint >= 0:
                half = joints[joint] / 2
                axis = np.sin(half) * np.array(tree["joint_axis"][joint])
                turned = turned @ rotation([np.cos(half), *axis])
            R.append(turned)
        return np.array(
            [rotation(quat) @ (p[b] + R[b] @ np.array(x)) + pos for b, x in body_points]
        )


def rotation(quat):
    w, x, y, z = np.asarray(quat, float)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
