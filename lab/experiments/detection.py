"""Mask R-CNN of torchvision, small: trained on rocks of made pictures, answers as COCO has them.

No weights are fetched: a network begins from random ones.
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np
import torch
from pycocotools import mask as run_lengths
from torch import nn
from torchvision.models import mobilenet_v3_small
from torchvision.models.detection import MaskRCNN
from torchvision.models.detection.anchor_utils import AnchorGenerator
from torchvision.models.detection.backbone_utils import BackboneWithFPN
from torchvision.models.detection.faster_rcnn import FastRCNNPredictor, TwoMLPHead
from torchvision.models.detection.mask_rcnn import MaskRCNNHeads, MaskRCNNPredictor

from scenec.datasets.torch_dataset import FrameDataset
from scenec.lab.experiments.networks import Recipe, descend, prepare
from scenec.lab.experiments.renders import Frames
from scenec.lab.experiments.terrains import CLASSES

#: Features of MobileNetV3-small of stride 4, 8 and 16, and how many channels they have.
_STAGES = {"1": "0", "3": "1", "8": "2"}
_STAGE_CHANNELS = [16, 24, 48]
_CHANNELS = 64
#: Rocks of fewer pixels are not asked for.
LEAST_PIXELS = 12
_ROCK = CLASSES.index("rock") + 1


def recipe(steps: int) -> Recipe:
    """Says how a network is trained."""
    return Recipe("small", steps, pictures=4, rate=1e-3)


def network(size: tuple[int, int]) -> nn.Module:
    """Mask R-CNN on MobileNetV3-small: a feature pyramid and heads of few channels.

    Group normalization, since few pictures at once make no mean that batches could share.

    Args:
        size: Of pictures: they are not scaled.
    """
    backbone = mobilenet_v3_small(weights=None, norm_layer=lambda n: nn.GroupNorm(8, n)).features
    pyramid = BackboneWithFPN(backbone, _STAGES, _STAGE_CHANNELS, _CHANNELS)
    anchors = AnchorGenerator(tuple((6 << i,) for i in range(4)), ((0.5, 1.0, 2.0),) * 4)
    return MaskRCNN(
        pyramid,
        min_size=min(size),
        max_size=max(size),
        image_mean=[0.4] * 3,
        image_std=[0.25] * 3,
        rpn_anchor_generator=anchors,
        rpn_pre_nms_top_n_train=400,
        rpn_pre_nms_top_n_test=400,
        rpn_post_nms_top_n_train=120,
        rpn_post_nms_top_n_test=120,
        rpn_batch_size_per_image=64,
        box_head=TwoMLPHead(_CHANNELS * 7 * 7, 256),
        box_predictor=FastRCNNPredictor(256, 2),
        box_batch_size_per_image=48,
        mask_head=MaskRCNNHeads(_CHANNELS, (_CHANNELS, _CHANNELS), 1),
        mask_predictor=MaskRCNNPredictor(_CHANNELS, _CHANNELS, 2),
    )


def detected_by(
    train: Frames, test: Frames, size: tuple[int, int], how: Recipe, seed: int
) -> tuple[list[dict[str, Any]], float]:
    """Trains a network, and asks it about other pictures.

    Args:
        train: What it learns from.
        test: What it is asked about.
        size: Of pictures.
        how: It is trained.
        seed: Of its weights, and of the order and turning of pictures.

    Returns:
        COCO's results, pictures numbered from 1; CPU seconds of this process.
    """
    start = time.process_time()
    net = trained(train, size, how, seed)
    return _results(net, test), time.process_time() - start


def trained(train: Frames, size: tuple[int, int], how: Recipe, seed: int) -> nn.Module:
    """A network that has learned."""
    device = prepare(seed)
    # Its loss scatters gradients in an order of its own; on one thread that is the same each time.
    torch.use_deterministic_algorithms(mode=False)
    samples = FrameDataset(
        train.out, ("rgb",), train.backend, batches=train.batches, rgb="srgb",
        target=("boxes", "labels", "masks"), keep=(f"area>={LEAST_PIXELS}",),
    )  # fmt: skip
    read = [_learned(samples[i], device) for i in range(len(samples))]
    net = network(size).to(device).train()

    def lost(chosen: list[int], mirrored: bool) -> torch.Tensor:
        some = [_mirrored(*read[i]) if mirrored else read[i] for i in chosen]
        return sum(net([one[0] for one in some], [one[1] for one in some]).values())

    descend(net, how, len(read), lost, longest=5.0)
    return net


def _learned(sample: dict[str, Any], device: torch.device) -> tuple[torch.Tensor, dict[str, Any]]:
    target = sample["target"]
    rocks = target["labels"] == _ROCK
    kept = {name: target[name][rocks].to(device) for name in ("boxes", "masks")}
    kept["labels"] = torch.ones(int(rocks.sum()), dtype=torch.int64, device=device)
    return sample["rgb"].to(device), kept


def _mirrored(picture: torch.Tensor, target: dict[str, Any]) -> tuple[torch.Tensor, dict[str, Any]]:
    width = picture.shape[-1]
    boxes = target["boxes"].clone()
    boxes[:, [0, 2]] = width - boxes[:, [2, 0]]
    return picture.flip(-1), {**target, "boxes": boxes, "masks": target["masks"].flip(-1)}


def _results(net: nn.Module, test: Frames) -> list[dict[str, Any]]:
    device = next(net.parameters()).device
    net.eval()
    samples = FrameDataset(test.out, ("rgb",), test.backend, batches=test.batches, rgb="srgb")
    found = []
    for number, sample in enumerate(samples, 1):
        with torch.no_grad():
            answer = net([sample["rgb"].to(device)])[0]
        boxes, scores, masks = (answer[n].cpu().numpy() for n in ("boxes", "scores", "masks"))
        for box, score, mask in zip(boxes, scores, masks[:, 0] >= 0.5, strict=True):
            if not mask.any():
                continue
            coded = run_lengths.encode(np.asfortranarray(mask.astype(np.uint8)))
            found.append({
                "image_id": number, "category_id": _ROCK, "score": float(score),
                "bbox": [*map(float, box[:2]), *map(float, box[2:] - box[:2])],
                "segmentation": {**coded, "counts": coded["counts"].decode()},
            })  # fmt: skip
    return found
