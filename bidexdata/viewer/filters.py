"""The widgets that say which grasps a page goes through, and what they mean."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from bidexdata.record.status import Status
from bidexdata.runs.release_rows import KEPT, OUTCOMES, RowFilter

if TYPE_CHECKING:
    import viser

    from bidexdata.viewer.catalog import Catalog

ALL_SIZES = "all sizes"
ALL_CATEGORIES = "all categories"
ANY_REASON = "any"


class FilterWidgets:
    """Widgets of one page in the folder `Filter`.

    Args:
        gui: Where they go.
        catalog: What there is to choose from.
    """

    def __init__(self, gui: viser.GuiApi, catalog: Catalog):
        source, grasps = catalog.source, catalog.source.kind != "library"
        categories, tests = catalog.category_names, source.tests or ("f",)
        self._reasons = {_reason_words(status): status for status in catalog.reasons}
        with gui.add_folder("Filter"):
            self.text = gui.add_text("object has", "", hint="part of an object's id or category")
            self.category = gui.add_dropdown(
                "category", (ALL_CATEGORIES, *categories), visible=bool(categories)
            )
            self.size = gui.add_dropdown("size", (ALL_SIZES,), visible=grasps)
            self.test = gui.add_dropdown(
                "test",
                tests,
                visible=grasps and len(tests) > 1,
                hint=f"test of {source.protocol} that outcome and reason are of",
            )
            self.outcome = gui.add_dropdown(
                "outcome",
                OUTCOMES,
                visible=grasps,
                hint=f"of {source.protocol}" if source.test else "not validated",
            )
            self.reason = gui.add_dropdown(
                "reason",
                (ANY_REASON, *self._reasons),
                visible=grasps and bool(self._reasons),
                hint="why the attempt or the test failed",
            )
            self.kept = gui.add_dropdown(
                "rows", KEPT, visible=grasps, hint="selected: best; audit: drawn by seed"
            )
            self.clear = gui.add_button("clear filters")
            self.found = gui.add_markdown("")

    @property
    def all(self) -> tuple[Any, ...]:
        """Those that change what is found."""
        return (
            self.text,
            self.category,
            self.size,
            self.test,
            self.outcome,
            self.reason,
            self.kept,
        )

    def wanted(self) -> RowFilter:
        """What the widgets say."""
        size, category = str(self.size.value), str(self.category.value)
        return RowFilter(
            text=str(self.text.value),
            category=None if category == ALL_CATEGORIES else category,
            size_mm=None if size == ALL_SIZES else int(size.split(maxsplit=1)[0]),
            test=str(self.test.value),
            outcome=self.outcome.value,
            reason=self._reasons.get(str(self.reason.value)),
            kept=self.kept.value,
        )

    def offer_sizes(self, sizes_mm: tuple[int, ...], put: Callable[..., None]) -> None:
        """Offer sizes [mm]; one that is chosen stays where it is among them."""
        options = (ALL_SIZES, *(f"{s} mm" for s in sizes_mm))
        if tuple(self.size.options) != options:
            put(self.size, options=options)

    def reset(self, put: Callable[..., None]) -> None:
        """Put all but the test to what lets everything through."""
        put(self.text, value="")
        for widget in (self.category, self.size, self.outcome, self.reason, self.kept):
            put(widget, value=widget.options[0])


def _reason_words(status: Status) -> str:
    return status.label.replace("_", " ")
