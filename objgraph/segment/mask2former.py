"""Mask2Former's weights from a folder or the local cache, and what it sees in an image."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self

import cv2
import numpy as np
import torch
from jaxtyping import Bool, UInt8
from safetensors import SafetensorError
from torch import Tensor

from objgraph.checked import check_fields, parse_json
from objgraph.errors import SegmentationError
from objgraph.priors.categories import LABELS
from objgraph.priors.registry import available_priors

CATEGORIES = {
    name: category for category in available_priors() for name in (category, *LABELS.get(category, ()))
}
"""From the names of things that a shipped prior serves to ours; what is not named is left out."""
_MEAN, _STD = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)
"""Of the images that backbones are trained on; a checkpoint may say otherwise."""
_INSTALL = "install it with: pip install 'objgraph[segment]'"


@dataclass(frozen=True)
class SegmentConfig:
    """What is taken for an object."""

    threshold: float = 0.5
    """Score, the class's probability times the mask's mean, below which a mask is dropped."""
    min_pixels: int = 60
    """Masks with fewer pixels are dropped."""
    shortest: int = 800
    """Pixels of the image's shorter side as the network sees it, unless the checkpoint says otherwise."""
    longest: int = 1333
    """Pixels that its longer side has at most."""
    categories: dict[str, str] = field(default_factory=lambda: dict(CATEGORIES))


@dataclass(frozen=True)
class Segment:
    """One object in one image."""

    category: str
    score: float
    mask: Bool[np.ndarray, "h w"]


_PREPROCESSOR = {
    "size": dict[str, int] | None,
    "image_mean": list[float] | None,
    "image_std": list[float] | None,
}
"""What is read of a checkpoint's preprocessor_config.json."""


class Segmenter:
    """A loaded network; masks do not overlap, the better one has a pixel that two want."""

    def __init__(
        self, model: Any, config: SegmentConfig | None = None, preprocessor: dict[str, Any] | None = None
    ) -> None:
        """`model` is a `Mask2FormerForUniversalSegmentation`, `preprocessor` what its preprocessor_config.json says."""
        self.config = config or SegmentConfig()
        self._model = model.eval()
        names = {int(i): str(name) for i, name in model.config.id2label.items()}
        self._categories = {
            i: self.config.categories[n] for i, n in names.items() if n in self.config.categories
        }
        if not self._categories:
            raise SegmentationError(
                f"the checkpoint's classes ({', '.join(list(names.values())[:8])}, ...) are none of "
                f"{', '.join(self.config.categories)}: use one that was trained on COCO, or give `categories`"
            )
        self._preprocessor = preprocessor or {}

    @classmethod
    def load(cls, weights: str | Path, config: SegmentConfig | None = None, device: str = "cpu") -> Self:
        """Weights from a folder (`config.json`, `model.safetensors`), or by name from the local cache.

        Nothing is downloaded, and nothing but safetensors is read: a checkpoint runs no code.

        Raises:
            SegmentationError: transformers is not installed, the weights are not here, or they are none of Mask2Former.
        """
        try:
            from transformers import Mask2FormerForUniversalSegmentation
        except ImportError as error:
            raise SegmentationError(
                f"segmentation needs transformers, which is not here; {_INSTALL}"
            ) from error
        try:
            # a mistake about which weights these are must not end in random ones
            loaded: Any = Mask2FormerForUniversalSegmentation.from_pretrained(
                str(weights), local_files_only=True, use_safetensors=True, output_loading_info=True
            )
            model, report = loaded
        except (OSError, ValueError, KeyError, RuntimeError, SafetensorError) as error:
            raise SegmentationError(
                f"{weights}: no Mask2Former weights here ({str(error).splitlines()[0]}); name a folder that holds "
                "config.json and model.safetensors, or fetch them once with: hf download "
                "facebook/mask2former-swin-small-coco-instance"
            ) from error
        if missing := sorted(report["missing_keys"]):
            raise SegmentationError(
                f"{weights}: is no Mask2Former checkpoint, it lacks {missing[0]} and {len(missing) - 1} more"
            )
        return cls(model.to(device), config, _preprocessor(Path(weights)))

    def segment(self, color: UInt8[np.ndarray, "h w 3"]) -> list[Segment]:
        """Objects of known categories in an RGB image, the surest first.

        Raises:
            SegmentationError: the image is none of 8-bit RGB.
        """
        if color.ndim != 3 or color.shape[2] != 3 or color.dtype != np.uint8:
            raise SegmentationError(f"an image of 8-bit RGB is due, not {color.dtype} of shape {color.shape}")
        pixels, inner = self._prepared(color)
        with torch.inference_mode():
            answer = self._model(pixel_values=pixels)
        probabilities = answer.class_queries_logits[0].softmax(dim=-1)[:, :-1]  # the last class is none
        logits = torch.nn.functional.interpolate(
            answer.masks_queries_logits, size=pixels.shape[-2:], mode="bilinear", align_corners=False
        )[:, :, : inner[0], : inner[1]]
        logits = torch.nn.functional.interpolate(
            logits, size=color.shape[:2], mode="bilinear", align_corners=False
        )[0]
        return self._apart(self._candidates(probabilities.float(), logits.float()))

    def _candidates(self, probabilities: Tensor, logits: Tensor) -> list[Segment]:
        """One mask a query and class that is likely enough, the surest first."""
        found = []
        for query, label in (probabilities > self.config.threshold).nonzero().tolist():
            if label in self._categories:
                mask = logits[query] > 0
                if mask.any():
                    score = float(probabilities[query, label] * logits[query][mask].sigmoid().mean())
                    found.append(Segment(self._categories[label], score, mask.cpu().numpy()))
        return sorted(found, key=lambda each: -each.score)

    def _apart(self, candidates: Sequence[Segment]) -> list[Segment]:
        kept, taken = [], None
        for each in candidates:
            mask = each.mask if taken is None else each.mask & ~taken
            # what is mostly another's is the same object once more
            if each.score < self.config.threshold or mask.sum() < max(
                self.config.min_pixels, 0.5 * each.mask.sum()
            ):
                continue
            kept.append(Segment(each.category, each.score, mask))
            taken = mask if taken is None else taken | mask
        return kept

    def _prepared(self, color: UInt8[np.ndarray, "h w 3"]) -> tuple[Tensor, tuple[int, int]]:
        """The network's input, padded to a multiple of 32, and the height and width that the image fills of it."""
        size = self._preprocessor.get("size", {})
        shortest, longest = (
            size.get("shortest_edge", self.config.shortest),
            size.get("longest_edge", self.config.longest),
        )
        height, width = color.shape[:2]
        factor = min(shortest / min(height, width), longest / max(height, width))
        inner = max(round(height * factor), 1), max(round(width * factor), 1)
        image = cv2.resize(color, inner[::-1], interpolation=cv2.INTER_LINEAR).astype(np.float32) / 255
        mean = np.array(self._preprocessor.get("image_mean", _MEAN), np.float32)
        std = np.array(self._preprocessor.get("image_std", _STD), np.float32)
        padded = np.zeros((*(-(-side // 32) * 32 for side in inner), 3), np.float32)
        padded[: inner[0], : inner[1]] = (image - mean) / std
        like = next(self._model.parameters())
        return torch.as_tensor(padded.transpose(2, 0, 1)[None]).to(like), inner


def _preprocessor(folder: Path) -> dict[str, Any]:
    """What a checkpoint's folder says of its images; nothing for one from the cache."""
    path = folder / "preprocessor_config.json"
    if not path.is_file():
        return {}
    try:
        content = parse_json(path.read_bytes())
        check_fields(content, _PREPROCESSOR)
    except (OSError, TypeError, ValueError) as error:
        raise SegmentationError(f"{path}: cannot be read ({error}); get the weights anew") from error
    return {name: value for name, value in content.items() if value is not None}
