"""BERT out of a local folder: its configuration and its tokenizer, and never a look-up."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gvr_core.errors import ModelError
from gvr_core.models.transformers_files import NETWORK_CONFIG, TOKENIZER_OPTIONS, VOCABULARIES
from gvr_core.untrusted import expanded, parse_json, read_regular


@dataclass(frozen=True)
class BertFolder:
    """A folder with a BERT's configuration and tokenizer, and what was in it."""

    path: Path
    sha256: str
    """Digest over the names and contents of all files that are read."""

    @property
    def tag(self) -> str:
        """The digest, as short as model names show it."""
        return self.sha256[:12]

    def tokenizer(self) -> Any:
        """The fast tokenizer.

        Raises:
            ModelError: if the files are damaged, or not those that were looked at.
        """
        from transformers import BertTokenizerFast

        self._unchanged()
        try:
            return BertTokenizerFast.from_pretrained(str(self.path), local_files_only=True)
        except Exception as error:  # parsers of three formats, each with errors of its own
            reason = (str(error).splitlines() or [type(error).__name__])[0]
            raise ModelError(
                f"no tokenizer can be made of it: {reason}",
                path=self.path,
                accepted=", ".join((*VOCABULARIES, *TOKENIZER_OPTIONS)),
            ) from error

    def network(self) -> Any:
        """A ``transformers.BertModel`` of the folder's sizes, its weights random.

        Raises:
            ModelError: if the configuration is damaged, or not the one that was looked at.
        """
        import transformers

        self._unchanged()
        try:
            sizes = transformers.BertConfig.from_pretrained(str(self.path), local_files_only=True)
            build: Any = transformers.BertModel
            return build(sizes)
        except Exception as error:  # a wrong size can fail anywhere in the network's making
            raise ModelError(
                f"no BERT can be made of it: {error}",
                path=self.path / NETWORK_CONFIG,
                accepted="the configuration of a BERT",
            ) from error

    def _unchanged(self) -> None:
        if bert_folder(self.path).sha256 != self.sha256:
            raise ModelError("its files have changed since it was looked at", path=self.path)


def bert_folder(path: Path, fetch: str = "") -> BertFolder:
    """Look at a BERT folder without loading anything.

    Args:
        path: The folder.
        fetch: The command that brings the folder, for the error where a file is missing.

    Raises:
        ModelError: if it lacks its configuration or a vocabulary, or is another network's.
    """
    path = expanded(path).absolute()
    accepted = f"a folder with {NETWORK_CONFIG} and {' or '.join(VOCABULARIES)}"
    accepted += f"; `{fetch}` brings one" if fetch else ""
    if not path.is_dir():
        raise ModelError("no such BERT folder", path=path, accepted=accepted)
    if not any((path / name).is_file() for name in VOCABULARIES):
        raise ModelError(f"lacks {' and '.join(VOCABULARIES)}", path=path, accepted=accepted)
    digest = hashlib.sha256()
    for name in (NETWORK_CONFIG, *VOCABULARIES, *TOKENIZER_OPTIONS):
        try:
            content = read_regular(path / name)
        except FileNotFoundError as error:
            if name == NETWORK_CONFIG:
                raise ModelError(f"lacks {NETWORK_CONFIG}", path=path, accepted=accepted) from error
            continue
        except OSError as error:
            raise ModelError(f"cannot be read: {error.strerror}", path=path / name) from error
        if name == NETWORK_CONFIG:
            _check_kind(path / name, content)
        digest.update(f"{name} {len(content)}\n".encode())
        digest.update(content)
    return BertFolder(path, digest.hexdigest())


def _check_kind(path: Path, content: bytes) -> None:
    """Other networks' configurations have other keys, which would be passed over in silence."""
    try:
        kind = parse_json(content).get("model_type", "bert")
    except (ValueError, AttributeError) as error:
        raise ModelError("no JSON object", path=path, accepted="a BERT's configuration") from error
    if kind != "bert":
        raise ModelError(f"model_type is {kind!r}", path=path, accepted='"bert"')
