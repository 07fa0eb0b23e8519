"""PrepareConfig: every number that decides how a mesh file becomes a prepared object.

Lengths without another unit are fractions of the bounding-box diagonal of the mesh.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields
from typing import Any

from bidexdata.errors import BadConfig


@dataclass(frozen=True, slots=True, kw_only=True)
class LoadConfig:
    """Reading a file."""

    max_faces: int = 4_000_000
    """Faces above which a file is refused as too complex (a bound on memory)."""
    max_bytes: int = 1 << 29
    """Size above which a file is not read [bytes]."""
    max_unpacked_bytes: int = 1 << 29
    """Bytes that an archive (3MF) may unpack to."""
    max_instances: int = 100_000
    """Nodes that a scene may place, however often each is used."""
    broken_faces: float = 0.1
    """Share of the faces that may have vertices that are no numbers: those are dropped, and the
    holes are for the repair. Above it the file is refused."""

    def __post_init__(self):
        _check(self, "max_faces", "max_bytes", "max_unpacked_bytes", "max_instances")


@dataclass(frozen=True, slots=True, kw_only=True)
class RepairConfig:
    """From triangles to a closed solid (docs/measurements.md, 10)."""

    weld: float = 1e-6
    """Vertices closer than this are one vertex; UV and normal seams lie at exactly 0."""
    loose_weld: float = 1e-4
    """Second try for cracked seams; below the thinnest plates seen (3e-4)."""
    remesh_cells: int = 80
    """Grid cells per diagonal of what has to be remeshed from its winding number."""
    fine_cells: int = 160
    """The same where walls are lost at `remesh_cells` and kept at this resolution."""
    shell_cells: float = 0.75
    """Half the thickness given to sheets that enclose no volume, in cells."""
    lost_cells: float = 1.0
    """A part of the surface is lost when the inside behind it is not so deep, in cells: a wall
    thinner than that becomes lace."""
    lost_share: float = 0.005
    """Share of the area that may be lost before sheets are thickened."""
    lid_share: float = 0.3
    """Share of the area of a component, or of a remeshed surface, that may be lids over holes. Above
    it the mesh is taken for an open shell and made thick instead of filled. Measured: 51 of 53 real
    open meshes have none, two have 3 %, a cap without a lining has 35 %, a box scanned without its
    bottom has 24 %."""
    simplify_cells: float = 0.15
    """Tolerance of the simplification after a remesh, in cells."""
    min_part: float = 1e-5
    """Specks: closed components below this share of the total volume that are also smaller than
    `debris` are dropped."""
    debris: float = 0.03
    """Box diagonal below which a component may be debris, as a share of the largest component's."""
    detached: float = 0.01
    """Distance from everything else above which it is, as a share of the same."""
    max_components: int = 3000
    """Closed components above which they are not united but remeshed."""
    display_faces: int = 20_000
    """Faces of the stored mesh above which it is simplified."""
    thin: float = 0.002
    """Mean thickness of walls below which a mesh is made thicker: half a millimetre of cardboard at
    0.3 m is no solid for a simulator."""
    plate: float = 0.005
    """Thickness that convex plates and needles below `thin` get: the finest cell of the signed
    distances is 0.0042, and what has no node inside has no depth."""
    near: float = 0.02
    """A repair whose Hausdorff distance to the input is not larger is accepted without a look at
    dearer ones."""
    near_lids: float = 0.05
    """The same for one whose only deviation are lids: the middle of a lid is as far from the input as
    its hole is wide. A wider one may close an opening that is meant."""
    hausdorff_samples: int = 20_000
    """Samples per direction of `hausdorff` and `solid_hausdorff`, besides all vertices."""

    def __post_init__(self):
        _check(
            self,
            *("weld", "loose_weld", "remesh_cells", "shell_cells", "lost_cells"),
            *("display_faces", "hausdorff_samples"),
        )
        if self.fine_cells < self.remesh_cells:
            raise BadConfig("repair.fine_cells must not be smaller than repair.remesh_cells")
        if self.plate < self.thin:
            raise BadConfig("repair.plate must not be smaller than repair.thin")
        if self.weld > self.loose_weld:
            raise BadConfig("repair.loose_weld must not be smaller than repair.weld")


@dataclass(frozen=True, slots=True, kw_only=True)
class ConvexConfig:
    """Convex decomposition by CoACD (docs/measurements.md, 11)."""

    convex_ratio: float = 0.985
    """A mesh that fills this share of its hull is its hull: one piece, no search."""
    simplify: float = 0.003
    """Tolerance of the simplification before the search: worth more than any parameter below."""
    max_faces: int = 2500
    """Faces above which that tolerance grows."""
    threshold: float = 0.07
    """Concavity at which the search stops, relative to CoACD's normalised mesh."""
    thin_threshold: float = 0.04
    """The same for thin objects, whose gaps hulls would bridge. Measured, union to mesh volume at
    0.07 / 0.05 / 0.035: frying pan 2.7 / 2.2 / 1.8, bicycle frame 1.5 / 1.2 / 1.2, bin 1.5 / 1.4 /
    1.3, shoe rack 1.5 / 1.3 / 1.1, for at most 1.6 CPU s more."""
    thin_ratio: float = 0.012
    """Thin means volume / (area x diagonal) below this: walls under about 2.4 % of the diagonal."""
    max_pieces: int = 32
    """Pieces per object at most."""
    max_vertices: int = 64
    """Vertices per piece at most (a good value for MuJoCo)."""
    mcts_iterations: int = 40
    """Iterations of the tree search."""
    mcts_nodes: int = 10
    """Children per node of the tree search."""
    mcts_max_depth: int = 2
    """Depth of the tree search."""
    resolution: int = 800
    """Samples for the concavity."""
    cpu_seconds: int = 60
    """CPU seconds of the first try; it is ended then and the cheaper second try runs."""
    finer_above: float = 1.15
    """Union of the pieces over the mesh's volume above which a finer search follows [-]."""
    finer_factor: float = 0.6
    """What it multiplies the threshold with, again and again [-]. Measured, union to mesh volume
    before and after: a chair 1.36 / 1.14, a broom 1.46 / 1.12, a tube 1.44 / 1.15, a bin 1.21 / 1.04,
    for 1 to 6 CPU s."""
    finest_threshold: float = 0.014
    """It does not go below this."""
    finer_cpu_seconds: int = 20
    """CPU seconds of each finer search; past them the pieces stay as they are."""
    second_threshold: float = 0.15
    """Concavity of the second try."""
    second_max_pieces: int = 16
    """Pieces of the second try."""
    second_cpu_seconds: int = 30
    """CPU seconds of the second try; after it the hull is the last answer."""
    overlap: float = 0.004
    """How far pieces reach into their neighbours beyond a cut. Measured on a cow in 23 pieces:
    share of surface samples deeper than 0.02 inside is 36 % at 0, 5 % at 0.001, 0.2 % at 0.004,
    for 1 % more volume."""
    min_volume: float = 1e-4
    """Pieces below this share of the total volume are dropped: MuJoCo refuses tiny meshes."""

    def __post_init__(self):
        _check(
            self,
            *("threshold", "max_pieces", "cpu_seconds", "second_cpu_seconds", "finer_above"),
            *("finer_factor", "finest_threshold", "finer_cpu_seconds"),
        )
        if self.finer_factor >= 1:
            raise BadConfig(f"convex.finer_factor must be below 1, not {self.finer_factor}")
        if self.max_vertices < 8:
            raise BadConfig(f"convex.max_vertices must be at least 8, not {self.max_vertices}")


@dataclass(frozen=True, slots=True, kw_only=True)
class SurfaceConfig:
    """Points on the solid's surface."""

    points: int = 6000
    """Number of points (docs/measurements.md, 4)."""
    seed: int = 0
    """Seed of the area-weighted draw; the same points for the same solid."""
    crack: float = 0.01
    """Points that face another wall of the solid nearer than this are left out: they lie in
    the cracks between pieces, where no fingertip can be."""

    def __post_init__(self):
        _check(self, "points")


@dataclass(frozen=True, slots=True, kw_only=True)
class SdfConfig:
    """Signed-distance grid of the solid."""

    cells: int = 240
    """Cells on the diagonal of the bounding box at most (docs/measurements.md, 13)."""
    error: float = 0.0025
    """A grid of half, 5/8, 3/4 or 7/8 as many cells is taken where interpolation is off by at most
    this at 3000 points within 0.03 of the surface: thin walls get the fine grid, stout objects a
    coarse one. The grid of all cells is the last answer, with a warning where it is off by more."""
    margin: float = 0.06
    """Room around the box, as a fraction of its longest side."""

    def __post_init__(self):
        _check(self, "cells", "error", "margin")


@dataclass(frozen=True, slots=True, kw_only=True)
class RestConfig:
    """Poses in which the object rests on a table (docs/measurements.md, 12)."""

    coplanar: float = 0.01
    """Hull faces whose normals differ by less [rad] are one facet."""
    steady: float = 0.0087
    """Poses that a tilt this small tips over are none [rad]; half a degree. Measured on 24 objects:
    all that a simulation of the pieces leaves by more than a degree tip over at 0.42 or less."""
    drops: int = 120
    """Drops in simulation; a multiple of 24, the number of quarter turns of an object."""
    seed: int = 0
    """Seed of their orientations."""
    drop_height: float = 0.05
    """Lowest point above the table at the release."""
    seconds: float = 6.0
    """Simulated time at unit diagonal (1 m) after which a drop that still moves is given up [s]."""
    flat: float = 0.017
    """A facet this flat on the table carries the object [rad]; 1 degree. Put down in a pose, the object
    must not turn by more."""
    stand_seconds: float = 3.0
    """For so long, at unit diagonal [s]."""
    prior_drops: float = 12.0
    """Weight of the probabilities that the hull alone gives, in drops."""
    merge: float = 0.1
    """Poses nearer than this [rad] are one, the most probable of them."""
    min_probability: float = 0.01
    """Poses less probable than this are left out."""
    max_poses: int = 16
    """Poses kept, most probable first."""

    def __post_init__(self):
        _check(self, "drops", "drop_height", "seconds", "stand_seconds", "flat", "max_poses")
        if self.drops % 24:
            raise BadConfig(f"rest.drops must be a multiple of 24, not {self.drops}")


@dataclass(frozen=True, slots=True, kw_only=True)
class SelectConfig:
    """Which objects are kept. By default all are; what is left out has its reason in the index."""

    max_aspect: float | None = None
    """Longest over shortest extent along the principal axes, at most [-]."""
    min_thickness: float | None = None
    """Mean thickness of the walls (2 volume / area), at least."""
    max_components: int | None = None
    """Bodies that do not touch, at most."""
    max_genus: int | None = None
    """Handles and through holes, at most."""
    categories: tuple[str, ...] = ()
    """Only these, where any is named."""
    without_categories: tuple[str, ...] = ()
    """None of these."""
    near_duplicates: bool = True
    """Keep shapes that an earlier input has already; `near_duplicate_of` of the index names it."""
    alike: float = 0.005
    """Mean difference of two descriptors below which their shapes are alike: between that of newly
    sampled and turned copies and that of different objects, which `benchmarks/solids.py` prints."""

    def __post_init__(self):
        _check(self, "alike")


@dataclass(frozen=True, slots=True, kw_only=True)
class LimitsConfig:
    """Bounds on the worker of one object; they never change a finished object."""

    memory_gib: float = 3.5
    """Address space of the worker [GiB]: under 4 GB. Measured: 0.9 GiB for ordinary meshes, of which
    0.35 GiB are resident."""
    cpu_seconds: float = 90.0
    """CPU time of the worker per object [s], decomposition not counted, which has its own bound
    (`convex`). Above it the object is `too_complex`. Measured: 2 s for ordinary meshes, 34 s for the
    slowest of 134, 50 s for a scan of 1.3 million faces with holes and chips."""
    wall_seconds: float = 300.0
    """Wall-clock time per object [s]; above it the object is `timed_out`, a re-run tries again."""

    def __post_init__(self):
        _check(self, "memory_gib", "cpu_seconds", "wall_seconds")
        for name, most in (("memory_gib", 2**20), ("cpu_seconds", 1e9), ("wall_seconds", 1e9)):
            if getattr(self, name) > most:
                value = getattr(self, name)
                raise BadConfig(f"LimitsConfig.{name} must be at most {most:g}, not {value!r}")


@dataclass(frozen=True, slots=True, kw_only=True)
class PrepareConfig:
    """Everything `bidexdata prepare` can be told with --config and --set."""

    load: LoadConfig = field(default_factory=LoadConfig)
    repair: RepairConfig = field(default_factory=RepairConfig)
    convex: ConvexConfig = field(default_factory=ConvexConfig)
    surface: SurfaceConfig = field(default_factory=SurfaceConfig)
    sdf: SdfConfig = field(default_factory=SdfConfig)
    rest: RestConfig = field(default_factory=RestConfig)
    select: SelectConfig = field(default_factory=SelectConfig)
    limits: LimitsConfig = field(default_factory=LimitsConfig)


def _check(config: Any, *positive: str) -> None:
    """Refuse numbers that are not finite or negative, and those named that are 0."""
    kind = type(config).__name__
    for name in (f.name for f in fields(config)):
        value = getattr(config, name)
        if not isinstance(value, int | float):
            continue
        if not math.isfinite(value):
            raise BadConfig(f"{kind}.{name} must be finite, not {value!r}")
        if value < 0 or (value == 0 and name in positive):
            wanted = "positive" if name in positive else "0 or more"
            raise BadConfig(f"{kind}.{name} must be {wanted}, not {value!r}")
