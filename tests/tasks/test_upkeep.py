from __future__ import annotations

import os
import threading
import time
from pathlib import Path

import pytest

from gvr_core.errors import StoreError
from tasks.store import Artifact, Store

DAY = 86400.0
A, B = "a" * 64, "b" * 64


@pytest.fixture
def store(tmp_path: Path) -> Store:
    return Store(tmp_path / "store")


def compute(store: Store, stage: str, key: str, text: str) -> Artifact:
    record, computed = store.compute_once(
        stage, 1, key, lambda: {"text": store.put_bytes("text", text.encode(), ".txt")}
    )
    assert computed
    return record.artifacts["text"]


def age(path: Path, days: float) -> None:
    then = time.time() - days * DAY
    os.utime(path, (then, then))


def age_everything(store: Store, days: float) -> None:
    for path in store.root.rglob("*"):
        if path.is_file():
            age(path, days)


def test_listing_shows_records_and_sizes(store: Store) -> None:
    assert store.ls().records == () and not store.root.exists()
    compute(store, "render", A, "one")
    compute(store, "masks", B, "three")
    store.put_bytes("text", b"loose")
    (store.root / "records" / "masks" / "broken.json").write_text("{")
    listing = store.ls()
    assert [(line.stage, line.key, line.bytes) for line in listing.records] == [
        ("masks", B, 5),
        ("render", A, 3),
    ]
    assert listing.stages == {"masks": 1, "render": 1}
    assert (listing.objects, listing.object_bytes, listing.unreadable) == (3, 13, 1)
    assert [line.stage for line in store.ls("render").records] == ["render"]


def test_verify_finds_each_kind_of_damage(store: Store) -> None:
    artifacts = [compute(store, "render", f"{index:064x}", f"text {index}") for index in range(4)]
    store.put_bytes("text", b"loose")
    report = store.verify()
    assert report.sound and (report.records, report.artifacts) == (4, 4)
    assert (report.orphans, report.orphan_bytes, report.bytes_hashed) == (1, 5, 24)

    store.path(artifacts[0]).unlink()
    for artifact, content in ((artifacts[1], b"text"), (artifacts[2], b"text 9")):
        path = store.path(artifact)
        path.chmod(0o644)
        path.write_bytes(content)
    (store.root / "records" / "render" / f"{9:064x}.json").write_text("null")
    report = store.verify()
    findings = {problem.path: problem.finding for problem in report.problems}
    assert not report.sound and findings == {
        artifacts[0].path: "is missing",
        artifacts[1].path: "has 4 bytes instead of 6",
        artifacts[2].path: "has another content than its digest says",
        f"records/render/{9:064x}.json": "is not a stage record of this schema",
    }
    assert {problem.key for problem in report.problems} == {
        *(f"{index:064x}" for index in range(3)),
        None,
    }
    assert store.path(artifacts[3]).read_bytes() == b"text 3"  # a check changes nothing


def test_gc_removes_only_what_no_record_names(store: Store) -> None:
    named = compute(store, "render", A, "named")
    loose = store.put_bytes("text", b"loose")
    (store.temporary / "unfinished").write_bytes(b"half")
    results = store.root / "prefect-results" / "render"
    results.mkdir(parents=True)
    (results / f"{A}.json").write_text("{}")
    (results / f"{B}.json").write_text("{}")
    age_everything(store, 2)

    planned = store.gc(dry_run=True)
    assert planned.dry_run and store.path(loose).exists()
    report = store.gc()
    assert report == planned.model_copy(update={"dry_run": False})
    assert report.removed == (loose.path,) and report.bytes_freed == 5 + 4 + 2
    assert (report.records, report.objects, report.temporary) == (0, 1, 1)
    assert (report.prefect_results, report.locks, report.spared) == (1, 1, 0)
    assert store.load_bytes(named) == b"named" and store.lookup("render", A) is not None
    assert [path.name for path in results.iterdir()] == [f"{A}.json"]
    assert not list(store.temporary.iterdir())
    with pytest.raises(StoreError, match="is missing"):
        store.path(loose)
    assert store.gc().removed == ()


def test_gc_spares_the_young(store: Store) -> None:
    loose = store.put_bytes("text", b"loose")
    assert store.gc().spared == 1 and store.path(loose).exists()
    age(store.path(loose), 2)
    store.put_bytes("text", b"loose")  # somebody wants it again
    assert store.gc().spared == 1 and store.load_bytes(loose) == b"loose"
    assert store.gc(grace_seconds=0).removed == (loose.path,)


def test_gc_spares_what_a_running_stage_has_put(store: Store) -> None:
    before = store.put_bytes("text", b"before")
    age(store.path(before), 3)
    put, go_on = threading.Event(), threading.Event()
    records = []

    def slow() -> dict[str, Artifact]:
        artifact = store.put_bytes("text", b"during")
        age(store.path(artifact), 1)  # the stage has been running for two days
        age(store.lock_path(A), 2)
        put.set()
        assert go_on.wait(20)
        return {"text": artifact}

    thread = threading.Thread(
        target=lambda: records.append(store.compute_once("render", 1, A, slow)[0])
    )
    thread.start()
    assert put.wait(20)
    try:
        report = store.gc(keep_days=0, grace_seconds=0)
    finally:
        go_on.set()
        thread.join()
    assert report.removed == (before.path,) and report.spared == 1 and report.locks == 0
    assert store.load_bytes(records[0].artifacts["text"]) == b"during"


def test_gc_keeps_records_used_lately(store: Store) -> None:
    old, used = compute(store, "render", A, "old"), compute(store, "render", B, "used")
    both = compute(store, "masks", A, "used")
    assert both.digest == used.digest
    age_everything(store, 10)
    assert store.lookup("render", B) is not None
    report = store.gc(keep_days=7)
    assert set(report.removed) == {
        f"records/render/{A}.json",
        f"records/masks/{A}.json",
        old.path,
    }
    assert store.load_bytes(used) == b"used" and store.verify().sound
    assert store.gc(keep_days=7).removed == ()
    with pytest.raises(StoreError, match="negative"):
        store.gc(keep_days=-1)


def test_gc_keeps_what_a_record_of_another_schema_names(store: Store) -> None:
    artifact = compute(store, "render", A, "from the future")
    path = store.record_path("render", A)
    path.write_text(path.read_text().replace('"schema":1', '"schema":2'))
    age_everything(store, 9)
    assert store.lookup("render", A) is None
    assert store.gc().removed == () and store.load_bytes(artifact) == b"from the future"


def test_gc_of_a_folder_that_is_no_store_touches_nothing(tmp_path: Path) -> None:
    other = tmp_path / "photographs"
    (other / "objects" / "aa").mkdir(parents=True)
    (other / "objects" / "aa" / "holiday.jpg").write_bytes(b"picture")
    age(other / "objects" / "aa" / "holiday.jpg", 99)
    assert Store(other).gc(keep_days=0, grace_seconds=0).bytes_freed == 0
    assert (other / "objects" / "aa" / "holiday.jpg").read_bytes() == b"picture"
    assert Store(tmp_path / "absent").gc().bytes_freed == 0
    assert not (tmp_path / "absent").exists()
