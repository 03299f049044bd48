"""A device that is not the CPU, where there is none: its tensors refuse the CPU's, as a GPU's do."""

from typing import Any

import torch
from torch import Tensor
from torch.overrides import TorchFunctionMode
from torch.utils._pytree import tree_leaves, tree_map

from factors.sdf_decoder import SdfDecoder, SdfJet

ELSEWHERE = torch.device("meta")
"""Its name; the numbers are kept on the CPU."""


class Far(Tensor):
    """A tensor of that device."""


class OtherDevice(TorchFunctionMode):
    """Within it tensors can be made and moved there, and none there is computed with one of the CPU."""

    def __torch_function__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        kwargs = dict(kwargs or {})
        tensors = [leaf for leaf in tree_leaves((args, kwargs)) if isinstance(leaf, Tensor)]
        far = [isinstance(tensor, Far) for tensor in tensors]
        if func == Tensor.device.__get__:  # type: ignore[attr-defined]
            return ELSEWHERE if far[0] else func(*args)
        if func is Tensor.cpu:
            return _near(args[0])
        if func is Tensor.numpy and far[0]:
            raise TypeError("a tensor of another device has no numpy array")
        if func is Tensor.to:
            target = kwargs.get("device", args[1] if len(args) > 1 else None)
            goes = _goes(target, far[0])
            others = [_near(arg) if isinstance(arg, Tensor) else arg for arg in args]
            others = [torch.device("cpu") if other == ELSEWHERE else other for other in others]
            kwargs.pop("device", None)
            found = func(*others, **kwargs)
            return found.as_subclass(Far) if goes else found
        goes = any(far) or _is_elsewhere(kwargs.get("device"))
        if _is_elsewhere(kwargs.get("device")):
            kwargs.pop("device")
        mixed = any(far) and any(
            not there and tensor.ndim > 0 for there, tensor in zip(far, tensors, strict=True)
        )
        if mixed and func is not Tensor.__getitem__:  # a CPU's indices are taken
            raise RuntimeError(f"{func.__name__}: tensors of two devices")
        args, kwargs = tree_map(_near, args), tree_map(_near, kwargs)
        found = func(*args, **kwargs)
        if not goes:
            return found
        return tree_map(lambda leaf: leaf.as_subclass(Far) if isinstance(leaf, Tensor) else leaf, found)


class FarDecoder(SdfDecoder):
    """A decoder that was moved there."""

    def __init__(self, own: SdfDecoder) -> None:
        super().__init__()
        self.own = own
        self._like = own.like.detach().as_subclass(Far)

    @property
    def code_length(self) -> int:
        return self.own.code_length

    @property
    def like(self) -> Tensor:
        return self._like

    def forward(self, points: Tensor, codes: Tensor, owner: Tensor | None = None) -> Tensor:
        near = self._asked(points, codes, owner)
        with torch._C.DisableTorchFunction():
            return self.own(*near).as_subclass(Far)

    def linearize(self, points: Tensor, codes: Tensor, owner: Tensor | None = None) -> SdfJet:
        near = self._asked(points, codes, owner)
        with torch._C.DisableTorchFunction():
            return SdfJet(*(part.as_subclass(Far) for part in self.own.linearize(*near)))

    def gradient(self, points: Tensor, code: Tensor) -> Tensor:
        near = self._asked(points, code)
        with torch._C.DisableTorchFunction():
            return self.own.gradient(*near).as_subclass(Far)

    def _asked(self, *given: Tensor | None) -> list[Any]:
        if any(part is not None and not isinstance(part, Far) for part in given):
            raise RuntimeError("the decoder is elsewhere, and what it is asked is on the CPU")
        return [_near(part) for part in given]

    def _enter(self, codes):
        raise NotImplementedError

    def _d_enter(self, codes):
        raise NotImplementedError

    def _network(self, points, injected):
        raise NotImplementedError


def _near(leaf: Any) -> Any:
    with torch._C.DisableTorchFunction():
        return leaf.as_subclass(Tensor) if isinstance(leaf, Far) else leaf


def _is_elsewhere(device: Any) -> bool:
    return device is not None and torch.device(device) == ELSEWHERE


def _goes(target: Any, far: bool) -> bool:
    """Whether what is moved to a device, a precision or another tensor's place ends up elsewhere."""
    if isinstance(target, Tensor):
        return isinstance(target, Far)
    return _is_elsewhere(target) if isinstance(target, (str, torch.device)) else far
