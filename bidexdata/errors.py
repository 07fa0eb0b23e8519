"""The errors a caller can act on; each writes its own message and knows its exit code.

An expected failure of one grasp or one object is a `Status` in its row, not an exception. The
classes here stop a whole command: a named thing that does not exist, files that contradict
themselves, a run made with another configuration.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import Any


def _restored(
    kind: type[BidexError], args: tuple[Any, ...], state: Mapping[str, Any]
) -> BidexError:
    error = kind.__new__(kind)
    error.args = args
    vars(error).update(state)
    return error


class BidexError(Exception):
    """Base of all errors of this package: one sentence that says what, where and what to do."""

    exit_code = 3

    def __reduce__(self) -> tuple[Any, ...]:
        # Errors come back from worker processes; by default they would be made again from the
        # sentence alone, which their classes do not take.
        return _restored, (type(self), self.args, vars(self))


class NotUsable(BidexError):
    """A named path, hand, rig, protocol or preset does not exist or cannot be used."""

    exit_code = 3


class PathNotFound(NotUsable):
    """A path that the caller named does not exist."""

    def __init__(self, path: str | Path, wanted: str):
        self.path = Path(path)
        what = "nothing usable there" if self.path.is_dir() else "no such file or folder"
        super().__init__(f"{path}: {what}; expected {wanted}")


class UnknownName(NotUsable):
    """A name is not among the known ones (hands, protocols, presets ...)."""

    def __init__(self, kind: str, name: str, known: Iterable[str], hint: str = ""):
        self.kind, self.name, self.known = kind, name, tuple(known)
        close = get_close_matches(name, self.known, n=1)
        meant = f" (did you mean {close[0]!r}?)" if close else ""
        listed = ", ".join(self.known) or "none"
        tail = f"; {hint}" if hint else ""
        super().__init__(f"no {kind} is called {name!r}{meant}; known: {listed}{tail}")


class BadConfig(NotUsable):
    """A configuration, spec or expression is impossible."""

    line: int | None = None
    """Line of the YAML file that the refused value stands in, where one was read."""


class BadValue(BadConfig):
    """A value given on the command line is no number, is malformed, or lies outside its range."""

    exit_code = 2


class UnknownChoice(BadConfig):
    """A configuration key is set to none of the words that it takes."""

    def __init__(self, where: str, value: object, known: Iterable[object]):
        self.where, self.value, self.known = where, value, tuple(known)
        listed = ", ".join(map(str, self.known))
        super().__init__(f"{where} must be one of {listed}, not {value!r}")


class UnknownKey(BadConfig):
    """A configuration names a key that does not exist."""

    def __init__(self, key: str, known: Sequence[str], where: str, deeper: Sequence[str] = ()):
        self.key, self.known = key, tuple(known)
        # A whole key that ends in this one is likelier than one that is only spelled alike.
        close = list(deeper) or get_close_matches(key, self.known, n=1)
        meant = f"did you mean {close[0]!r}?" if close else f"known keys: {', '.join(self.known)}"
        super().__init__(f"{where} has no key {key!r}; {meant}")


class MissingExtra(NotUsable):
    """A package that the core does not bring is not installed.

    Args:
        package: Its name.
        extra: The extra that brings it; empty where the package alone is what is missing.
    """

    def __init__(self, package: str, extra: str = ""):
        self.package, self.extra = package, extra
        wanted = f"'bidexdata[{extra}]'" if extra else package
        super().__init__(
            f"this needs the package {package!r}; install it with: pip install {wanted}"
        )


class Contradiction(BidexError):
    """A release, run or library contradicts its manifest or header (damage or tampering)."""

    exit_code = 4


class ConfigConflict(BidexError):
    """A folder was made with another configuration than the one asked for."""

    exit_code = 5

    def __init__(
        self,
        folder: str | Path,
        differing: Sequence[str],
        advice: str = "Use another --out, or the same settings as before",
    ):
        self.folder, self.differing = Path(folder), tuple(differing)
        super().__init__(
            f"{folder} was made with another configuration; these keys differ: "
            f"{'; '.join(self.differing)}. {advice}"
        )


class LimitDropsObjects(ConfigConflict):
    """A limit on the inputs leaves out objects that a library has of an earlier call."""

    def __init__(self, folder: str | Path, limit: int, dropped: Sequence[str]):
        self.dropped = tuple(dropped)
        super().__init__(folder, [f"--limit {limit}"])
        number = "1 object" if len(dropped) == 1 else f"{len(dropped)} objects"
        self.args = (
            f"--limit {limit} would drop {number} of an earlier call from {folder} (first: "
            f"{dropped[0]}), and runs made from it need them: leave out --limit, or use another --out",
        )


class SourceChanged(ConfigConflict):
    """The library (or release) that a run was made from has other contents now."""

    def __init__(self, folder: str | Path, source: str | Path, change: str, kind: str = "library"):
        super().__init__(folder, [f"{kind}.fingerprint: {change}"])
        again = {
            "library": "prepare it again from all of its inputs with the same settings, or make "
            "another run of it",
            "release": "test it anew with another --out",
        }
        self.args = (
            f"the {kind} {source} has changed since {folder} was made from it ({change}): "
            f"{again[kind]}",
        )


class NothingSucceeded(BidexError):
    """The command finished, but not one object or grasp succeeded."""

    exit_code = 6
