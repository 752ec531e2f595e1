"""Frames without end as an iterable PyTorch dataset: each scene is made when it is asked for.

from torch.utils.data import DataLoader
from scenec.torch import Stream, collate

frames = Stream("cfg.json", passes=("rgb", "label"), backend="pyrender")
for batch in DataLoader(frames, batch_size=8, num_workers=2, collate_fn=collate):
batch["rgb"]           # float32 [8, 3, h, w], sRGB in [0, 1]
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

from torch import distributed
from torch.utils.data import IterableDataset, get_worker_info

from scenec.api.steps import AnyCfg
from scenec.api.stream import StreamFrame, StreamOptions, numbered, stream
from scenec.datasets.torch_dataset import Sample, make_sample


class Stream(IterableDataset):
    """Frames of new scenes, for ``torch.utils.data.DataLoader``.

    Samples are those of a ``FrameDataset``, with ``index`` and ``seed`` of their scene, and with
    ``rgb`` float32 [3, h, w], sRGB in [0, 1], unless ``color`` asks for ``srgb8`` (uint8) or
    ``radiance`` (linear). Without ``passes`` they have those of the cfg.

    Workers of the loader, and processes of ``torch.distributed``, share the scenes out: of n, each
    makes every n-th. All of them see every scene once, and none sees one that another has. Where
    seeds end, some may have one scene more than others.

    Args:
        cfg: As of ``scenec.stream``.
        rank, world: Of this process among how many; None: as ``torch.distributed`` says where it
            is initialized, else 0 of 1.
        options: Of ``scenec.stream``. By default each scene is made in the process that asks for it
            (``workers=0``), as workers of the loader are processes already.

    Raises:
        ScenecError: An option has a value that it cannot have.
    """

    def __init__(
        self, cfg: AnyCfg, *, rank: int | None = None, world: int | None = None, **options: Any
    ) -> None:
        self.cfg, self.rank, self.world = cfg, rank, world
        self.options: dict[str, Any] = {"workers": 0, "color": "srgb", **options}
        # Refused here, not in a worker of the loader.
        StreamOptions(**self.options)

    def __iter__(self) -> Iterator[Sample]:
        """Yields samples of the scenes that are this process's share.

        Raises:
            ScenecError: As of ``scenec.stream``.
        """
        asked = StreamOptions(**self.options)
        mine = self._share(numbered(asked.seeds, asked.start))
        for frame in stream(self.cfg, **{**self.options, "seeds": mine}):
            yield sample_of(frame)

    def _share(self, scenes: Iterable[tuple[int, int]]) -> Iterator[tuple[int, int]]:
        rank, world, loader = self.rank, self.world, get_worker_info()
        if rank is None or world is None:
            there = distributed.is_available() and distributed.is_initialized()
            rank, world = (
                (distributed.get_rank(), distributed.get_world_size()) if there else (0, 1)
            )
        if loader is not None:
            rank, world = rank * loader.num_workers + loader.id, world * loader.num_workers
        # By index: who goes on in the middle has the same share.
        return ((index, seed) for index, seed in scenes if index % world == rank)


def sample_of(frame: StreamFrame) -> Sample:
    """Makes a sample of tensors from a frame."""
    arrays = {**frame.passes} if frame.rgb is None else {**frame.passes, "rgb": frame.rgb}
    return make_sample(frame.loaded, arrays) | {"index": frame.index, "seed": frame.seed}
