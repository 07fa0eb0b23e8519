"""PrepareFailure: why one input did not become an object."""

from __future__ import annotations

from bidexdata.errors import BidexError
from bidexdata.record.status import Status
from bidexdata.wording import storable


class PrepareFailure(BidexError):
    """One input cannot be prepared; `prepare` turns it into a report row."""

    def __init__(self, status: Status, reason: str):
        self.status, self.reason = status, storable(reason)  # names and texts of any file are in it
        super().__init__(f"{status.sentence}: {self.reason}")

    def __reduce__(self):
        # Crosses process boundaries; the default would call the class with the message alone.
        return type(self), (self.status, self.reason)
