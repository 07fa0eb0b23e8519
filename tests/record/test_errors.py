"""Errors keep their kind, sentence and fields on their way out of a worker process."""

import pickle

import pytest

from bidexdata import errors

RAISED = [
    errors.BidexError("a sentence"),
    errors.NotUsable("a sentence"),
    errors.PathNotFound("nowhere", "a library"),
    errors.UnknownName("hand", "shadw", ["shadow", "capsule"], hint="look there"),
    errors.UnknownKey("regions.anchorz", ["anchors", "radius"], "the configuration"),
    errors.ConfigConflict("run", ["sizes: 0.3 -> 0.5"]),
    errors.SourceChanged("run", "library", "aa -> bb"),
    errors.MissingExtra("viser", "view"),
    errors.Contradiction("a sentence"),
    errors.NothingSucceeded("a sentence"),
]


@pytest.mark.parametrize("error", RAISED, ids=lambda e: type(e).__name__)
def test_errors_survive_pickling(error):
    back = pickle.loads(pickle.dumps(error))  # noqa: S301
    assert type(back) is type(error)
    assert str(back) == str(error)
    assert vars(back) == vars(error)
    assert back.exit_code == error.exit_code
