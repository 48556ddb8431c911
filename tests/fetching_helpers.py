"""What the tests of fetching share: files on the server, and short ways to ask for them."""

from __future__ import annotations

import io
from pathlib import Path

import torch
from weights_server import Served, WeightsServer

from gvr_core.weights.fetching import Fetched, fetch_file
from gvr_core.weights.manifest import WeightsFile
from gvr_core.weights.transfer import Patience

HASTY = Patience(tries=3, pause=0.01)
SIZE = 300_000


def noise(seed: int = 0, size: int = SIZE) -> bytes:
    return (
        torch.randint(
            0, 256, (size,), dtype=torch.uint8, generator=torch.Generator().manual_seed(seed)
        )
        .numpy()
        .tobytes()
    )


def checkpoint_bytes(content: object, zipped: bool = True) -> bytes:
    stream = io.BytesIO()
    torch.save(content, stream, _use_new_zipfile_serialization=zipped)
    return stream.getvalue()


def offer(server: WeightsServer, content: bytes, name: str = "w.dat", **how: object) -> Served:
    server.files[name] = Served(content, **how)  # type: ignore[arg-type]
    return server.files[name]


def file_of(server: WeightsServer, name: str = "w.dat", **fields: object) -> WeightsFile:
    return WeightsFile.model_validate({"path": f"sub/{name}", "url": server.url(name), **fields})


def pinned(server: WeightsServer, name: str = "w.dat") -> WeightsFile:
    served = server.files[name]
    return file_of(server, name, size=len(served.content), sha256=served.sha256)


def get(file: WeightsFile, folder: Path, **more: object) -> Fetched:
    return fetch_file(file, folder, patience=HASTY, **more)  # type: ignore[arg-type]


def names(folder: Path) -> list[str]:
    """All files in the models folder; what was half-fetched would be among them."""
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file())
