"""MuJoCo ships compiled modules without stubs: every name is Any for pyright."""

from typing import Any

def __getattr__(name: str) -> Any: ...
