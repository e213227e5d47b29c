"""NumPy or torch, by what is handed in: the same code gives the same numbers, with gradients by
autograd where a tensor came in.

A function of arrays asks `namespace` for its functions (the array API standard, through
array-api-compat), and wraps its own constants in `constant`. torch is never imported here: where no
tensor can have come in, it need not be installed.
"""

import sys
from typing import Any

import array_api_compat
import numpy as np
from scipy import special

from dropo.core.services.validation import Array, check_shape, float_array, require


def is_tensor(x: Any) -> bool:
    """Whether x is a torch tensor."""
    torch = sys.modules.get("torch")
    return torch is not None and isinstance(x, torch.Tensor)


def namespace(*arrays: Any) -> Any:
    """The array API namespace of the arrays: torch's where one of them is a tensor, else NumPy's;
    `einsum` is in both.
    """
    tensors = [x for x in arrays if is_tensor(x)]
    return array_api_compat.array_namespace(tensors[0] if tensors else np.empty(0))


def constant(x: Any, like: Any) -> Any:
    """The array as float64 in the namespace of `like`, on its device; no copy where none is needed."""
    if not is_tensor(like):
        return np.asarray(x, dtype=float)
    torch = sys.modules["torch"]
    if not is_tensor(x):
        x = np.require(x, dtype=float, requirements=["C", "W"])  # what torch can share
    return torch.as_tensor(x, dtype=torch.float64, device=like.device)


def checked(name: str, values: Any, shape: tuple[int | None, ...], caller: str) -> Any:
    """`float_array` of numbers; a tensor in float64, with its history, if it is finite and of that
    shape.
    """
    if not is_tensor(values):
        return float_array(name, values, shape, caller)
    check_shape(name, values, shape, caller)
    require(bool(values.isfinite().all()), name, "finite", values.tolist(), caller)
    return values.double()


def together(*arrays: Any) -> list[Any]:
    """The arrays as float64 in one namespace: torch's where one of them is a tensor, else NumPy's."""
    like = next((x for x in arrays if is_tensor(x)), None)
    return [constant(x, like) for x in arrays]


def plain(x: Any) -> Array:
    """The values as a NumPy array, without their history."""
    return np.asarray(x.detach().cpu().numpy() if is_tensor(x) else x, dtype=float)


def ndtri(x: Any) -> Any:
    """The standard normal quantile."""
    return sys.modules["torch"].special.ndtri(x) if is_tensor(x) else special.ndtri(x)


def cholesky(covariance: Any) -> Any:
    """Lower factors (R, p, p) of R symmetric matrices; NaN where one is not positive definite."""
    if is_tensor(covariance):
        torch = sys.modules["torch"]
        factor, bad = torch.linalg.cholesky_ex(covariance)
        return torch.where(bad[:, None, None] > 0, torch.nan, factor)
    try:
        return np.linalg.cholesky(covariance)
    except np.linalg.LinAlgError:
        return np.array([_cholesky_or_nan(row) for row in covariance])


def _cholesky_or_nan(covariance: Array) -> Array:
    try:
        return np.linalg.cholesky(covariance).astype(float, copy=False)
    except np.linalg.LinAlgError:
        return np.full_like(covariance, np.nan)
