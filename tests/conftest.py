"""Fixtures and the run-time check of array annotations.

Every module of the package but the kernels is imported under jaxtyping and beartype, so a wrong
shape or dtype anywhere in a test fails there. Material beside the checkout (`../shared`) is
optional: tests that need it skip and say so.
"""

from __future__ import annotations

import gc
import os
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import settings
from jaxtyping import install_import_hook

ROOT = Path(__file__).resolve().parents[1]


def _checked_modules() -> list[str]:
    files = (ROOT / "bidexdata").rglob("*.py")
    named = (f.relative_to(ROOT).with_suffix("").as_posix().replace("/", ".") for f in files)
    # beartype refuses Warp's kernel annotations at import.
    return sorted(n for n in named if not n.endswith(("_kernels", "__init__")))


install_import_hook(_checked_modules(), "beartype.beartype")

# A shell that starts the tests in the background hands down an ignored Ctrl-C, which the
# processes that tests interrupt would inherit.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# What modules and the list of tests are made of stays to the end: it is looked through for garbage
# neither while it is made nor ever after.
gc.disable()


def pytest_collection_finish() -> None:
    gc.freeze()
    gc.enable()


# Time limits belong to no test: a busy machine breaks no law.
settings.register_profile("untimed", deadline=None)
settings.load_profile("untimed")

SHARED = ROOT.parent / "shared"
if (SHARED / "menagerie").is_dir():
    os.environ.setdefault("MENAGERIE_ROOT", str(SHARED / "menagerie"))


@pytest.fixture(scope="session", autouse=True)
def shown_on_cards() -> Iterator[int]:
    """How many grasps a card shows; in tests it is one, as drawing is most of a small pack."""
    from bidexdata.runs import release_pictures

    with pytest.MonkeyPatch.context() as patch:
        shown = release_pictures.SHOWN
        patch.setattr(release_pictures, "SHOWN", 1)
        yield shown


@pytest.fixture(scope="session")
def shared() -> Path:
    """The folder with real meshes and peers' grasps."""
    if not SHARED.is_dir():
        pytest.skip(
            "needs ../shared (real meshes, peers' grasps), which is not part of the project"
        )
    return SHARED


@pytest.fixture(scope="session")
def menagerie() -> Path:
    """A local copy of MuJoCo Menagerie, named by MENAGERIE_ROOT."""
    root = os.environ.get("MENAGERIE_ROOT")
    if not root or not Path(root, "shadow_hand").is_dir():
        pytest.skip("needs MENAGERIE_ROOT with shadow_hand (a local copy of MuJoCo Menagerie)")
    return Path(root)
