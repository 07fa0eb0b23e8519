"""Speed of every stage with the quality beside it; `make bench` runs all of them.

Each script has `measure() -> dict` with a fixed seed and built-in objects, so anyone can run it
without other files. Times are medians of several repeats after a warm-up that compiles the
kernels; compile time is never part of a figure.
"""
