"""Releases on disk: written by `writer`, read by `release`, checked by `verify`."""
