from baggie.learning.train import train
from baggie.options.training import KeypointTraining, RegressionTraining, TrainOptions, TransporterTraining

__all__ = ["KeypointTraining", "RegressionTraining", "TrainOptions", "TransporterTraining", "train"]
