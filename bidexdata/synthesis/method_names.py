"""Names of the methods, apart from their code, which loads what computes."""

DEFAULT_METHOD = "bidexgrasp"
"""Region pairs and decoupled bilevel optimisation."""
METHODS = (DEFAULT_METHOD, "bodex", "bimangrasp")
