"""Which extra brings a package that the core does not have, so that its absence names the pip line.

Packages are imported where they are used. Whoever imports one that is not there gets a
`ModuleNotFoundError`; the command line and the public names turn it into `MissingExtra`.
"""

from __future__ import annotations

from importlib.util import find_spec

from bidexdata.errors import MissingExtra

EXTRA_OF: dict[str, tuple[str, str]] = {
    "av": ("av", "synth"),
    "coacd": ("coacd", "synth"),
    "lxml": ("lxml", "synth"),
    "manifold3d": ("manifold3d", "synth"),
    "mujoco": ("mujoco", "synth"),
    "mujoco_menagerie": ("mujoco-menagerie", "synth"),
    "networkx": ("networkx", "synth"),
    "osqp": ("osqp", "synth"),
    "PIL": ("pillow", "synth"),
    "pytorch_kinematics": ("pytorch-kinematics", "synth"),
    "scipy": ("scipy", "synth"),
    "torch": ("torch", "synth"),
    "trimesh": ("trimesh", "synth"),
    "warp": ("warp-lang", "synth"),
    "mujoco_warp": ("mujoco-warp", "gpu"),
    "viser": ("viser", "view"),
    "huggingface_hub": ("huggingface-hub", "publish"),
    "mlcroissant": ("mlcroissant", "publish"),
    "ray": ("ray", "ray"),
    "DracoPy": ("DracoPy", "draco"),
    "objaverse": ("objaverse", "objaverse"),
}
"""Module as it is imported -> the package's name, and the extra that brings it."""


def require(*modules: str) -> None:
    """Refuse to begin what will need modules that are not installed.

    For work that imports them in other processes, where their absence would cost task after task.

    Raises:
        MissingExtra: One of them is not there.
    """
    for name in modules:
        if find_spec(name) is None:
            raise MissingExtra(*EXTRA_OF[name])


def missing_extra(err: BaseException) -> MissingExtra | None:
    """What to tell a person about a failed import; None where no extra would help."""
    name = (err.name or "").partition(".")[0] if isinstance(err, ModuleNotFoundError) else ""
    # Whoever asks for the version of a package that is not there gets its name, not the module's.
    by_package = {package: (package, extra) for package, extra in EXTRA_OF.values()}
    known = EXTRA_OF.get(name) or by_package.get(name)
    return None if known is None else MissingExtra(*known)
