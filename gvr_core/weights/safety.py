"""Whether a fetched file can be read as weights without running code that it holds."""

from __future__ import annotations

import pickle
import warnings
from pathlib import Path, PurePosixPath

from gvr_core.errors import ModelError
from gvr_core.untrusted import parse_json, read_regular
from gvr_core.weights.pickles import AsksForMore, check_pickles

_PICKLES = {".pth", ".pt", ".bin", ".ckpt"}


def check_harmless(path: Path, name: str) -> None:
    """Read a file as what its name says it is, without running anything.

    ``.pth``, ``.pt``, ``.ckpt`` and ``.bin`` through ``torch.load(weights_only=True)``, whose
    tensors stay on disk where the format allows it; ``.safetensors`` by its header; ``.json`` as
    text. Files of other kinds are left alone, as nothing here would run them.

    Args:
        path: The file, under whatever name it has at present.
        name: The name that it is to have.

    Raises:
        ModelError: for a file that wants to run code, or that is not of its kind. What it would
            run has not run.
    """
    suffix = PurePosixPath(name).suffix
    if suffix in _PICKLES:
        _check_torch(path, name)
    elif suffix == ".safetensors":
        _check_safetensors(path, name)
    elif suffix == ".json":
        _check_json(path, name)


def _check_torch(path: Path, name: str) -> None:
    import torch

    try:
        with path.open("rb") as file:
            check_pickles(file)
            is_archive = file.read(2) == b"PK"
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            # Tensors of an archive are mapped, not read; files from before torch 1.6 are read.
            torch.load(path, map_location="cpu", weights_only=True, mmap=is_archive)
    except (pickle.UnpicklingError, AsksForMore) as error:
        reason = next((line for line in str(error).splitlines() if "GLOBAL" in line), str(error))
        raise ModelError(
            "refused, as reading it might run code that it holds: "
            + (reason.strip().splitlines() or ["no plain tensors"])[0],
            path=name,
            accepted="tensors that torch.load(weights_only=True) reads, or .safetensors",
        ) from error
    except Exception as error:  # a damaged file makes the reader fail in any way
        if "TorchScript" in str(error):
            raise ModelError(
                "refused, as it is a TorchScript archive, which is a program",
                path=name,
                accepted="a state dict, or .safetensors",
            ) from error
        reason = (str(error).splitlines() or [type(error).__name__])[0]
        raise ModelError(f"is no file of torch.save: {reason}", path=name) from error


def _check_safetensors(path: Path, name: str) -> None:
    from safetensors import SafetensorError, safe_open

    try:
        with safe_open(path, framework="pt") as file:
            file.keys()
    except (SafetensorError, OSError) as error:
        raise ModelError(f"is not safetensors: {error}", path=name) from error


def _check_json(path: Path, name: str) -> None:
    try:
        parse_json(read_regular(path))
    except (OSError, ValueError) as error:
        raise ModelError(f"is not JSON: {error}", path=name) from error
