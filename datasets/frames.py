"""Which registered image a label, a mask or a prediction belongs to.

Benchmarks name a frame in two ways: by the picture's file name, or by its index into the sorted
pictures. The second goes wrong silently as soon as one picture is missing, so that names come
first, and an index has to agree with them.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from pathlib import Path, PurePosixPath

from datasets.capture import CaptureImage
from gvr_core.errors import DatasetError, some_of

_DIGITS = re.compile(r"\d+")


def match_frame(
    images: Sequence[CaptureImage],
    stem: str,
    index: int | None = None,
    *,
    unregistered: Sequence[str] = (),
    path: Path | None = None,
    place: str | None = None,
) -> CaptureImage:
    """The registered image that a frame means.

    The stem decides: equal to an image's file name without its ending (or to its whole path
    without it), else to one that differs only in leading zeros of its numbers (``03`` and
    ``0003``). Where no picture is named like it and the layout's rule is an index, the index
    decides. A stem that is numbered like the pictures (``frame_00043`` among ``frame_00001``,
    ``frame_00002``, ...) and is not among them is never taken by index: its picture is not
    registered, and the index would lead to a neighbour.

    Args:
        images: Registered images, in any order.
        stem: The frame's name, without ending.
        index: Index into all pictures in name order, where that is the layout's rule.
        unregistered: Names of pictures that have no camera; they count for the index.
        path: The file or folder that names the frame, for the message.
        place: Where in it, for the message.

    Raises:
        DatasetError: if the frame is not registered, its name means several images, the index
            is beyond the pictures, or stem and index lead to different pictures.
    """
    by_name = {image.name: image for image in images}
    names = sorted({*by_name, *unregistered})
    named = _named(names, stem, path, place)
    if index is None:
        if named is None:
            raise _not_registered(stem, list(by_name), path, place)
        return _registered(by_name, named, stem, path, place)
    counted = names[index] if 0 <= index < len(names) else None
    if named is not None and named != counted:
        raise DatasetError(
            f"the frame {stem!r} is the picture {named!r} by its name, but its index {index} is "
            + (repr(counted) if counted is not None else f"beyond the {len(names)} pictures"),
            path=path,
            place=place,
            accepted="a name and an index that mean one picture; is a picture missing or unsorted?",
        )
    if named is None:
        alike = {_DIGITS.sub("#", _whole_stem(name)) for name in names}
        alike |= {_DIGITS.sub("#", _stem(name)) for name in names}
        if _DIGITS.sub("#", stem) in alike:
            raise _not_registered(stem, list(by_name), path, place)
        if counted is None:
            raise DatasetError(
                f"the frame {stem!r} has the index {index}",
                path=path,
                place=place,
                accepted=f"0 to {len(names) - 1}, an index into the pictures in name order"
                if names
                else "an index into the pictures, of which there is none",
            )
    return _registered(by_name, named or counted or "", stem, path, place)


def _named(names: Sequence[str], stem: str, path: Path | None, place: str | None) -> str | None:
    """The picture with that stem; None where there is none."""
    ways: tuple[Callable[[str], bool], ...] = (
        lambda name: _whole_stem(name) == stem,
        lambda name: _stem(name) == stem,
        lambda name: _without_zeros(_whole_stem(name)) == _without_zeros(stem),
        lambda name: _without_zeros(_stem(name)) == _without_zeros(stem),
    )
    for is_meant in ways:
        found = [name for name in names if is_meant(name)]
        if len(found) > 1:
            raise DatasetError(
                f"the frame {stem!r} may be {some_of(found)}",
                path=path,
                place=place,
                accepted="a frame that one picture is named like",
            )
        if found:
            return found[0]
    return None


def _registered(
    by_name: dict[str, CaptureImage], name: str, stem: str, path: Path | None, place: str | None
) -> CaptureImage:
    """The image of that name, if it has a camera."""
    if name in by_name:
        return by_name[name]
    raise DatasetError(
        f"the frame {stem!r} is the picture {name!r}, which has no camera",
        path=path,
        place=place,
        accepted="a frame that is registered; its cameras leave this picture out",
    )


def _not_registered(
    stem: str, names: Sequence[str], path: Path | None, place: str | None
) -> DatasetError:
    listed = f": {some_of(sorted(names))}" if names else ""
    return DatasetError(
        f"the frame {stem!r} is not among the {len(names)} registered images",
        path=path,
        place=place,
        accepted=f"the name of one of them{listed}",
    )


def _stem(name: str) -> str:
    return PurePosixPath(name).stem


def _whole_stem(name: str) -> str:
    """A name without its ending, its folders kept."""
    return str(PurePosixPath(name).with_suffix(""))


def _without_zeros(stem: str) -> str:
    return _DIGITS.sub(lambda digits: str(int(digits.group())), stem)
