from __future__ import annotations

from dataclasses import replace

import pytest

from bidexdata.objects.closed import as_mesh
from bidexdata.objects.config import PrepareConfig, SdfConfig, SurfaceConfig
from bidexdata.objects.prepare import prepare_object
from bidexdata.objects.prepared import PreparedObject, TriangleMesh


@pytest.fixture(scope="session")
def small() -> PrepareConfig:
    """The default configuration with a coarse grid and few points: quick, same code."""
    return replace(PrepareConfig(), sdf=SdfConfig(cells=40), surface=SurfaceConfig(points=600))


@pytest.fixture(scope="session")
def prepared(small: PrepareConfig) -> dict[str, PreparedObject]:
    """One piece, two pieces, many pieces."""
    names = ("box", "bracket", "mug")
    return {name: prepare_object(f"shapes:{name}", small) for name in names}


@pytest.fixture(scope="session")
def box() -> TriangleMesh:
    """A box of 0.6 x 0.5 x 0.3 about the origin."""
    import manifold3d

    return as_mesh(manifold3d.Manifold.cube((0.6, 0.5, 0.3), True))


@pytest.fixture(scope="session")
def ball() -> TriangleMesh:
    """A finely tessellated ball of radius 0.3 about the origin."""
    import manifold3d

    return as_mesh(manifold3d.Manifold.sphere(0.3, 96))
