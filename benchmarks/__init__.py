"""Speed of every stage with the quality beside it, and checks that take too long for a test.

`make bench` runs the scripts that have `measure() -> dict`: built-in objects and fixed seeds, so that
anyone can run them without other files, but for `real`, which needs a folder of meshes and is left
out where there is none. Times are medians of several repeats after a warm-up that compiles the
kernels, where the script does not say otherwise. The other scripts are run by name
(`python -m benchmarks.truth RUN`, ...); each says at its top what it prints.
"""
