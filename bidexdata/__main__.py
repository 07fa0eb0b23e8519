"""`python -m bidexdata`: the command line, also where the script `bidexdata` is not on the path."""

from bidexdata.cli.main import main

if __name__ == "__main__":
    main()
