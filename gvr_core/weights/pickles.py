"""What is asked of a checkpoint's pickle before ``torch.load(weights_only=True)`` sees it.

That reader runs no code of the file, but does what the file says with the few functions that it
trusts: in two hundred bytes it can be told to fill the memory (``bytearray(2**40)``, or a text
encoded to twice its length forty times over), to unpack an archive a thousand times its size, or
to hash a tuple of two tuples of two tuples for as long as the universe. A file of tensors does
none of these.
"""

from __future__ import annotations

import io
import pickletools
import zipfile
from typing import Any, BinaryIO

_TRUSTED = {
    ("collections", "OrderedDict"),
    ("builtins", "set"),
    ("__builtin__", "set"),
    ("builtins", "complex"),
    ("__builtin__", "complex"),
}
"""Names outside of torch that a pickle of tensors may mention."""

_LEGACY_PICKLES = 5
"""Pickles at the start of a file from before torch 1.6: magic, version, system, state, keys."""

_MAX_WEIGHT = 1_000_000
"""Parts of the largest tuple, counted as often as it is reached. A shape has 5."""


class AsksForMore(ValueError):
    """A pickle that is whole, and no pickle of tensors alone."""


def check_pickles(file: BinaryIO) -> None:
    """Refuse a checkpoint that asks for more than tensors; the file ends where it began.

    Args:
        file: What ``torch.save`` wrote: an archive, or the older form.

    Raises:
        AsksForMore: saying what it asks for.
        ValueError: if it is damaged.
    """
    start = file.tell()
    try:
        if file.read(4) == b"PK\x03\x04":
            file.seek(start)
            _check_archive(file)
        else:
            file.seek(start)
            for _ in range(_LEGACY_PICKLES):
                _check_pickle(file)
    except AsksForMore:
        raise
    except Exception as error:  # what is damaged fails in many ways
        raise ValueError(str(error) or type(error).__name__) from error
    finally:
        file.seek(start)


def _check_archive(file: BinaryIO) -> None:
    """``torch.save`` stores without compressing; whatever is packed tighter is no work of it."""
    size = file.seek(0, io.SEEK_END)
    with zipfile.ZipFile(file) as archive:
        entries = archive.infolist()
        if any(entry.filename.partition("/")[2] == "constants.pkl" for entry in entries):
            return  # TorchScript, which torch refuses by that name
        if any(entry.compress_type != zipfile.ZIP_STORED for entry in entries):
            raise AsksForMore("the archive is compressed")
        # Entries that lie over each other promise more than the file holds.
        if sum(entry.file_size for entry in entries) > size:
            raise AsksForMore("the archive's entries are larger than the archive")
        for entry in entries:
            if entry.filename.endswith(".pkl"):
                _check_pickle(io.BytesIO(archive.read(entry)))


def _check_pickle(stream: Any) -> None:
    """Read the next pickle of a stream as a list of operations, none of which is done.

    Of each value on the stack only its weight is known: the leaves that are met on a walk
    through it, which is what hashing a tuple costs.
    """
    stack: list[int] = []
    marks: list[int] = []
    memo: dict[Any, int] = {}
    for operation, argument, _ in pickletools.genops(stream):
        name = operation.name
        if name in ("GLOBAL", "INST"):
            module, _, attribute = str(argument).partition(" ")
            if module.split(".")[0] != "torch" and (module, attribute) not in _TRUSTED:
                raise AsksForMore(f"it mentions {module}.{attribute}, which is no tensor")
        elif name == "STACK_GLOBAL":
            raise AsksForMore("it takes names from its own texts")
        if name == "MARK":
            marks.append(len(stack))
        elif name in ("BINGET", "LONG_BINGET", "GET"):
            stack.append(memo.get(argument, 1))
        elif name in ("BINPUT", "LONG_BINPUT", "PUT"):
            memo[argument] = stack[-1] if stack else 1
        elif name == "MEMOIZE":
            memo[len(memo)] = stack[-1] if stack else 1
        elif name == "DUP":
            stack.append(stack[-1] if stack else 1)
        else:
            takes = operation.stack_before
            if pickletools.markobject in takes or pickletools.stackslice in takes:
                first = marks.pop() if marks else 0
                first -= takes.index(pickletools.markobject)
            else:
                first = len(stack) - len(takes)
            taken = stack[max(0, first) :]
            del stack[max(0, first) :]
            weight = sum(taken) if "TUPLE" in name else 1
            if weight > _MAX_WEIGHT:
                raise AsksForMore("it holds a tuple of tuples without end")
            stack.extend(weight or 1 for _ in operation.stack_after)
