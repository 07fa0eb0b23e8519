"""Where objects come from: files, folders, globs, lists, trees of other projects, shapes."""

from .item import SourceItem as SourceItem
from .objaverse import fetched as fetched
from .resolve import resolve_sources as resolve_sources
