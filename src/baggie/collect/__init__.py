"""The autonomous collector: a state machine that makes demonstrations by itself."""

from baggie.collect.collect import CollectOptions, collect

__all__ = ["CollectOptions", "collect"]
