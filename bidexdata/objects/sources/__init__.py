"""Where objects come from: files, folders, globs, lists, trees of other projects, shapes."""

from bidexdata.objects.sources.item import SourceItem as SourceItem
from bidexdata.objects.sources.objaverse import fetched as fetched
from bidexdata.objects.sources.resolve import resolve_sources as resolve_sources
