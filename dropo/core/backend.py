"""NumPy or torch, by what is handed in: the same code gives the same numbers, with gradients by autograd where a tensor came in.

A function of arrays asks `namespace` for its functions (the array API standard, through array-api-compat), and wraps its
own constants in `constant`. torch is never imported here: where no tensor can have come in, it need not be installed.
"""

import sys
from typing import Any

import array_api_compat
import numpy as np
from scipy import special

from dropo.core.checks import Array


def is_tensor(x: Any) -> bool:
    """Whether x is a torch tensor."""
    torch = sys.modules.get("torch")
    return torch is not None and isinstance(x, torch.Tensor)


def namespace(*arrays: Any) -> Any:
    """The array API namespace of the arrays: torch's where one of them is a tensor, else NumPy's; `einsum` is in both."""
    tensors = [x for x in arrays if is_tensor(x)]
    return array_api_compat.array_namespace(tensors[0] if tensors else np.empty(0))


def constant(x: Any, like: Any) -> Any:
    """The array as float64 in the namespace of `like`, on its device; no copy where none is needed."""
    if not is_tensor(like):
        return np.asarray(x, dtype=float)
    torch = sys.modules["torch"]
    return torch.as_tensor(x, dtype=torch.float64, device=like.device)


def plain(x: Any) -> Array:
    """The values as a NumPy array, without their history."""
    return np.asarray(x.detach().cpu().numpy() if is_tensor(x) else x, dtype=float)


def ndtri(x: Any) -> Any:
    """The standard normal quantile."""
    return sys.modules["torch"].special.ndtri(x) if is_tensor(x) else special.ndtri(x)
