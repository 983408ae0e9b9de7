"""Attempts on disk: none is lost, read as fast as pictures decode, and LeRobot's own tools work on them."""

from baggie.data.dataset import Dataset, open_dataset
from baggie.data.summary import contact_sheet, inspect_dataset
from baggie.data.writer import DatasetWriter

__all__ = ["Dataset", "DatasetWriter", "contact_sheet", "inspect_dataset", "open_dataset"]
