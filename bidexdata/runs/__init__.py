"""Runs: what joins the libraries to the disk (plans, shards, executors) and each stage's driver."""
