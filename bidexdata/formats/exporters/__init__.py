"""Exporters: rows in the format of another program, one module each.

A module of `EXPORTS` gives `grasp_files(batch)`, what it writes of each row, and `write_object(folder,
solid)`; what joins them to the disk is `runs/export.py`. Motions of arms are written by `trajectories`
and `runs/trajectories.py`.
"""

from __future__ import annotations

EXPORTS = {"dexgraspbench": "bidexdata.formats.exporters.dexgraspbench"}
"""Name on the command line -> module."""
