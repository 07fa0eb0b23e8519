"""Readers of mesh files, one file per format or group of formats.

A reader turns the bytes of a file into triangles in world coordinates of the file, and says how
its axes turn to z up and how long its unit is. It reads geometry only: never a material, never an
image, never a file outside the folder of the one it reads. What a file claims is checked against
what it holds before anything of that size is made.
"""

from __future__ import annotations

from .content import Content as Content
from .read import SUFFIXES as SUFFIXES
from .read import read_content as read_content
