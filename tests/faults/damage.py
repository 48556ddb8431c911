"""Files of the store and of results, damaged as disks and hands damage them."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from faults import children
from faults.checks import litter
from faults.lines import Line
from faults.work import Work, comparable, difference, emptied
from gvr_core.errors import GVRError
from reports.result_io import check_files, list_results, read_result
from tasks.store import Store

Damage = Callable[[Path, Sequence[Path], np.random.Generator], None]
"""Does something to a file; the others of its kind may serve as replacements."""


def flip_bit(path: Path, others: Sequence[Path], rng: np.random.Generator) -> None:
    """Flip one bit."""
    data = bytearray(path.read_bytes())
    data[rng.integers(len(data))] ^= 1 << rng.integers(8)
    _put(path, bytes(data))


def truncate(path: Path, others: Sequence[Path], rng: np.random.Generator) -> None:
    """Cut the end off."""
    data = path.read_bytes()
    _put(path, data[: rng.integers(len(data))])


def delete(path: Path, others: Sequence[Path], rng: np.random.Generator) -> None:
    """Delete it."""
    path.unlink()


def replace(path: Path, others: Sequence[Path], rng: np.random.Generator) -> None:
    """Put another file's content there."""
    content = path.read_bytes()
    different = [other for other in others if other.read_bytes() != content]
    _put(path, different[rng.integers(len(different))].read_bytes())


DAMAGES: dict[str, Damage] = {
    "one bit flipped": flip_bit,
    "truncated": truncate,
    "deleted": delete,
    "replaced by another's": replace,
}


def damage_store(
    work: Work,
    folder: Path,
    reference: dict[str, Any],
    lines: dict[str, Line],
    seed: int,
    most: int | None = None,
) -> None:
    """Damage every object and every record in each way; each must be found and made again.

    Args:
        work: The work.
        folder: For stores and results.
        reference: An undisturbed result.
        lines: ``"objects"`` and ``"records"``, where tries are counted.
        seed: Of places and replacements.
        most: Try only so many of each kind and way.
    """
    found = folder / "damage.jsonl"
    sound = emptied(folder / "sound") / "store"

    def every() -> None:
        work.run(sound, folder / "sound" / "results")
        rng = np.random.default_rng(seed)
        with found.open("w") as file:
            for kind, pattern in (("objects", "objects/??/*"), ("records", "records/*/*.json")):
                names = [path.relative_to(sound) for path in sorted(sound.glob(pattern))]
                for way in DAMAGES:
                    for name in names[:most]:
                        losses = _damage_one(work, folder, reference, kind, way, name, names, rng)
                        line = {"kind": kind, "where": f"{name}, {way}", "losses": losses}
                        print(json.dumps(line), file=file)

    ended = children.run(every, timeout=1200)
    if ended.code != 0:
        raise RuntimeError(ended.output[-2000:])
    for text in found.read_text().splitlines():
        entry = json.loads(text)
        lines[entry["kind"]].add(entry["losses"], entry["where"])


def _damage_one(
    work: Work,
    folder: Path,
    reference: dict[str, Any],
    kind: str,
    way: str,
    name: Path,
    names: Sequence[Path],
    rng: np.random.Generator,
) -> list[str]:
    place = emptied(folder / "damaged")
    root, results = place / "store", place / "results"
    shutil.copytree(folder / "sound" / "store", root)
    DAMAGES[way](root / name, [root / other for other in names], rng)
    losses = []
    # A deleted record is no damage: nothing says that it was ever there.
    reported = {problem.path for problem in Store(root).verify().problems}
    if (name.as_posix() in reported) == (kind == "records" and way == "deleted"):
        losses.append(f"cache verify reports {sorted(reported) or 'nothing'}")
    store = Store(root)
    try:
        result = work.run(store, results)
    except Exception as error:
        return [*losses, f"the next run failed: {type(error).__name__}: {error}"]
    counts = store.counts
    expected = counts.misses if way == "deleted" else counts.damaged + counts.unreadable
    if not expected:
        losses.append(f"not counted: {counts}")
    if unlike := difference(reference, comparable(result)):
        losses.append(f"the next result is not the undisturbed one: {unlike}")
    losses += [f"still there: {problem.path}" for problem in Store(root).verify().problems]
    return losses + litter(root, results)


def damage_result(
    work: Work, folder: Path, line: Line, seed: int, reference: dict[str, Any]
) -> None:
    """Damage every file of a result in each way; each must be found, and the next run whole."""
    store, results = emptied(folder / "result") / "store", folder / "result" / "results"

    def make() -> None:
        work.run(store, results)

    for _ in range(2):
        ended = children.run(make)
        if ended.code != 0:
            raise RuntimeError(ended.last_line)
    sound, again = list_results(results)
    if unlike := difference(reference, comparable(again)):
        raise RuntimeError(unlike)
    rng = np.random.default_rng(seed)
    names = sorted(path.relative_to(sound) for path in sound.rglob("*") if path.is_file())
    for way, damage in DAMAGES.items():
        for name in names:
            hurt = emptied(folder / "hurt")
            shutil.copytree(sound, hurt, dirs_exist_ok=True)
            damage(hurt / name, [hurt / other for other in names], rng)
            losses = []
            try:
                read_result(hurt)
                check_files(hurt)
                losses.append("nobody noticed")
            except GVRError as error:
                if str(hurt) not in str(error):
                    losses.append(f"the error does not name the place: {error}")
            line.add(losses, f"{name}, {way}")


def _put(path: Path, data: bytes) -> None:
    path.chmod(0o644)
    path.write_bytes(data)
