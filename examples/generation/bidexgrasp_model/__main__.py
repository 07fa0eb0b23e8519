"""`python -m bidexgrasp_model` is `bidexgrasp-model`."""

from bidexgrasp_model.cli import main

main()
