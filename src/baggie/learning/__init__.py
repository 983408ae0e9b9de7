from baggie.learning.options import TrainOptions
from baggie.learning.train import train

__all__ = ["TrainOptions", "train"]
