"""Where ``open_clip`` says that its pretrained models lie: that library's table, as entries."""

from __future__ import annotations

from difflib import get_close_matches
from pathlib import PurePosixPath
from typing import Any
from urllib.parse import quote

from gvr_core.errors import ModelError

PREFIX = "open_clip:"
"""What names of ``open_clip`` models begin with; then ``MODEL/TAG``."""

HUB = "https://huggingface.co"
HUB_SAFETENSORS = "open_clip_model.safetensors"
HUB_PICKLE = "open_clip_pytorch_model.bin"
"""The files of a repository on the hub that names none, in the order the library tries them."""


def canonical(name: str) -> str:
    """A name as the library itself writes it: tags in lower case, with underscores.

    Args:
        name: ``open_clip:MODEL/TAG``.

    Raises:
        ModelError: for a name of another form.
    """
    model, separator, tag = name.removeprefix(PREFIX).rpartition("/")
    if not (separator and model and tag):
        raise ModelError(f"{name!r} names no model and tag", accepted=f"{PREFIX}MODEL/TAG")
    return f"{PREFIX}{model}/{tag.lower().replace('-', '_')}"


def entry_fields(name: str) -> dict[str, Any]:
    """The fields of an :class:`~gvr_core.weights.manifest.Entry` for a model of the library.

    The file is the one that the library's own loader would take: safetensors from the hub where
    there are some, else the pickle there, else what the table gives a URL for. OpenAI's URLs
    state the sha256 of their files.

    Args:
        name: ``open_clip:MODEL/TAG``, in the library's own writing.

    Raises:
        ModelError: for a model or a tag that the installed library does not list.
    """
    import open_clip

    model, _, tag = name.removeprefix(PREFIX).rpartition("/")
    config = open_clip.get_pretrained_cfg(model, tag)
    if not config:
        raise _unknown(model, tag, open_clip.list_pretrained())
    folder = f"open_clip/{model}/{tag}"
    files = _hub_files(config.get("hf_hub") or "", folder)
    if config.get("url"):
        files.append(_url_file(config["url"], folder))
    if not files:
        raise ModelError(f"open_clip {open_clip.__version__} does not say where {name} lies")
    chain: dict[str, Any] | None = None
    for file in reversed(files):
        chain = {**file, "otherwise": chain}
    repository = (config.get("hf_hub") or "").rpartition("/")[0]
    return {
        "name": name,
        "role": "encoder",
        "licence": "see source",
        "source": f"{HUB}/{repository}" if repository else files[0]["url"],
        "files": [chain],
    }


def _hub_files(hub: str, folder: str) -> list[dict[str, Any]]:
    repository, _, file = hub.rpartition("/")
    if not repository:
        return []
    names = [HUB_SAFETENSORS, HUB_PICKLE]
    if file:
        names = list(dict.fromkeys([str(PurePosixPath(file).with_suffix(".safetensors")), file]))
    return [
        {
            "path": f"{folder}/{name}",
            "url": f"{HUB}/{quote(repository)}/resolve/main/{quote(name)}",
        }
        for name in names
    ]


def _url_file(url: str, folder: str) -> dict[str, Any]:
    parts = url.split("/")
    stated = parts[-2] if "openaipublic" in url else None
    return {"path": f"{folder}/{parts[-1]}", "url": url, "sha256": stated}


def _unknown(model: str, tag: str, listed: list[tuple[str, str]]) -> ModelError:
    tags = [known for name, known in listed if name == model]
    if tags:
        return ModelError(f"open_clip has no tag {tag!r} of {model}", accepted=", ".join(tags))
    models = list(dict.fromkeys(name for name, _ in listed))
    close = get_close_matches(model, models, n=6, cutoff=0.3) or models[:6]
    return ModelError(
        f"open_clip has no pretrained weights of a model {model!r}",
        accepted=f"{', '.join(close)}, or another of its {len(models)} models",
    )
