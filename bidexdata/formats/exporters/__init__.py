"""Exporters: rows of a release in the format of another project, one module each.

A module gives `grasp_files(batch)`, what it writes of each row, and `write_object(folder, solid)`;
what joins them to the disk is `runs/export.py`.
"""

from __future__ import annotations

EXPORTS = {"dexgraspbench": "bidexdata.formats.exporters.dexgraspbench"}
"""Name on the command line -> module."""
