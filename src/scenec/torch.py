"""Gives frames to PyTorch: those of an output folder, and those of a stream of new scenes."""

from scenec.api.torch_stream import Stream
from scenec.datasets.torch_dataset import FrameDataset, collate

__all__ = ["FrameDataset", "Stream", "collate"]
