"""The autonomous collector: a state machine that makes demonstrations by itself."""

from baggie.collect.collect import collect
from baggie.options.collecting import CollectOptions

__all__ = ["CollectOptions", "collect"]
