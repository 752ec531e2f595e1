"""Segmentation networks of torchvision: trained on made pictures, asked about others.

No weights are fetched: a network begins from random ones. One thread and PyTorch's deterministic
algorithms make a training repeatable on a machine; another processor may round otherwise.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from PIL import Image
from torch import nn
from torchvision.models import mobilenet_v3_large, mobilenet_v3_small
from torchvision.models.feature_extraction import create_feature_extractor
from torchvision.models.segmentation import LRASPP

from scenec.datasets.torch_dataset import FrameDataset
from scenec.lab.experiments.renders import Frames
from scenec.lab.experiments.terrains import CLASSES, LEVEL

#: Name -> MobileNetV3, its features of stride 4 and 16, and how many channels they have.
_BACKBONES = {
    "small": (mobilenet_v3_small, ("features.1", 16), ("features.12", 576)),
    "large": (mobilenet_v3_large, ("features.3", 24), ("features.16", 960)),
}


@dataclass(frozen=True)
class Recipe:
    """How a network is trained.

    Attributes:
        backbone: ``small`` or ``large`` MobileNetV3.
        steps: Of AdamW, its rate rising and falling once (one cycle).
        pictures: In a step.
        rate: The highest learning rate.
    """

    backbone: str
    steps: int
    pictures: int = 8
    rate: float = 3e-3


def network(backbone: str) -> nn.Module:
    """LR-ASPP on MobileNetV3 with random weights.

    Its low level is taken at stride 4, not 8: the pictures are small.
    """
    make, (low, low_channels), (high, high_channels) = _BACKBONES[backbone]
    features = create_feature_extractor(
        make(weights=None, dilated=True), {low: "low", high: "high"}
    )
    return LRASPP(features, low_channels, high_channels, len(CLASSES))


def judged_by(
    train: Frames, tests: Mapping[str, Frames], recipe: Recipe, seed: int, folder: Path
) -> float:
    """Trains a network, and writes its answers as ``scenec evaluate`` reads them.

    Args:
        train: What it learns from.
        tests: Name -> what it is asked about.
        recipe: How it is trained.
        seed: Of its weights, and of the order and turning of pictures.
        folder: Where each test's answers go, in a folder of its name.

    Returns:
        CPU seconds of this process.
    """
    start = time.process_time()
    net = trained(train, recipe, seed)
    for name, frames in tests.items():
        _write(net, frames, folder / name)
    return time.process_time() - start


def trained(train: Frames, recipe: Recipe, seed: int) -> nn.Module:
    """A network that has learned."""
    device = prepare(seed)
    pictures, labels = _loaded(train)
    pictures, labels = pictures.to(device), labels.to(device)
    net = network(recipe.backbone).to(device, memory_format=torch.channels_last).train()
    # Rare classes count for more, or nothing would be called a rock.
    shares = labels[labels >= 0].bincount(minlength=len(CLASSES)) / labels.numel()
    loss = nn.CrossEntropyLoss(1.0 / shares.clamp_min(1e-3).sqrt(), ignore_index=-1)

    def lost(chosen: list[int], mirrored: bool) -> torch.Tensor:
        x, y = pictures[chosen], labels[chosen]
        if mirrored:
            x, y = x.flip(-1), y.flip(-1)
        # Other colors of the light: each terrain has its own, and there are few terrains.
        gains = 0.8 + 0.45 * torch.rand(len(x), 3, 1, 1)
        return loss(net(_centered(x * gains.to(device)))["out"], y)

    descend(net, recipe, len(pictures), lost)
    _measure_means(net, pictures, recipe.pictures)
    return net


def descend(
    net: nn.Module, recipe: Recipe, count: int, lost: Callable[[list[int], bool], torch.Tensor],
    longest: float = math.inf,
) -> None:  # fmt: skip
    """Trains a network by AdamW.

    Args:
        net: It.
        recipe: How.
        count: Of pictures there are.
        lost: Its loss on some of them, which are mirrored or not.
        longest: Of a gradient; a longer one is cut to this.
    """
    optimizer = torch.optim.AdamW(net.parameters(), recipe.rate, weight_decay=0.01)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, recipe.rate, recipe.steps)
    order: list[int] = []
    for _ in range(recipe.steps):
        if len(order) < recipe.pictures:
            order = torch.randperm(count).tolist()
        chosen, order = order[: recipe.pictures], order[recipe.pictures :]
        mirrored = bool(torch.rand(()) < 0.5)
        optimizer.zero_grad()
        lost(chosen, mirrored).backward()
        if longest < math.inf:
            nn.utils.clip_grad_norm_(net.parameters(), longest)
        optimizer.step()
        schedule.step()


def _measure_means(net: nn.Module, pictures: torch.Tensor, at_once: int) -> None:
    """Sets the means and variances of batch normalization to those of the pictures.

    The running ones of MobileNetV3 forget a hundredth a step: few steps leave them where they were.
    """
    for module in net.modules():
        if isinstance(module, nn.BatchNorm2d):
            module.reset_running_stats()
            module.momentum = None
    with torch.no_grad():
        for some in pictures.split(at_once):
            net(_centered(some))


def prepare(seed: int) -> torch.device:
    """Seeds PyTorch and makes it repeatable, as far as its device can be; returns this."""
    torch.manual_seed(seed)
    torch.set_num_threads(1)
    if torch.cuda.is_available():
        # Its bilinear interpolation has no deterministic gradient.
        return torch.device("cuda")
    torch.use_deterministic_algorithms(mode=True)
    return torch.device("cpu")


def device_name() -> str:
    """Where networks are trained."""
    return torch.cuda.get_device_name() if torch.cuda.is_available() else "one thread of a CPU"


def _loaded(frames: Frames) -> tuple[torch.Tensor, torch.Tensor]:
    """Pictures, float32 [n, 3, h, w], and classes, int64 [n, h, w], -1 for none."""
    samples = _samples(frames, ("rgb", f"label.{LEVEL}"))
    ids = samples.labels[LEVEL]
    classes = torch.full((max(ids) + 1,), -1)
    for number, name in ids.items():
        classes[number] = CLASSES.index(name)
    read = [samples[i] for i in range(len(samples))]
    labels = torch.stack([classes[one[f"label.{LEVEL}"]] for one in read])
    return torch.stack([one["rgb"] for one in read]), labels


def _samples(frames: Frames, passes: tuple[str, ...]) -> FrameDataset:
    return FrameDataset(
        frames.out, passes=passes, backend=frames.backend, batches=frames.batches, rgb="srgb"
    )


def _centered(pictures: torch.Tensor) -> torch.Tensor:
    return ((pictures - 0.4) / 0.25).contiguous(memory_format=torch.channels_last)


def _write(net: nn.Module, frames: Frames, folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    device = next(net.parameters()).device
    net.eval()
    samples = _samples(frames, ("rgb",))
    for ref, sample in zip(samples.frames, samples, strict=True):
        x = _centered(sample["rgb"][None].to(device))
        with torch.no_grad():
            answer: NDArray[Any] = net(x)["out"][0].argmax(0).cpu().numpy()
        Image.fromarray(answer.astype(np.uint8)).save(folder / f"{ref.key}.png")
