"""A generation model for two-handed grasps, trained and judged from a release of `bidexdata`.

It is an example of a consumer: it imports public names of `bidexdata` and nothing else of it.
"""

__version__ = "0.1.0"
