"""`python -m bidexdata.cli`."""

from bidexdata.cli.main import main

main()
