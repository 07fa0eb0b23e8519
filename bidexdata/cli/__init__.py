"""The command line: one file per command, each options -> one call -> report."""
