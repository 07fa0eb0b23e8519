"""Peers' methods on our kernels, so that all can be compared on the same scenes."""
