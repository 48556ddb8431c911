"""Two machines, which share nothing but a bucket: what one computed the other has."""

from __future__ import annotations

import json
import logging
import pickle
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from s3_server import S3Server

from gvr_core.errors import ConfigError, StoreError
from tasks import lease, remote_tier
from tasks.findings import Notes
from tasks.store import Artifact, StageOutput, StageRecord, Store, canonical_json

DIGEST = "0" * 64
BIG = np.arange(3_000_000, dtype=np.float64)  # 24 MB: several pieces
STAGE = f"records/demo/{DIGEST}.json"


@pytest.fixture(autouse=True)
def no_rest(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(remote_tier, "REST_SECONDS", 0.0)
    monkeypatch.setattr(lease, "POLL_SECONDS", 0.05)


@pytest.fixture
def machine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """A store as a machine of that name would have it: a local folder of its own."""

    def make(name: str, url: str) -> Store:
        monkeypatch.setenv("GVR_STORE_LOCAL", str(tmp_path / name))
        return Store(url)

    return make


@pytest.fixture(params=["s3", "file", "memory"])
def url(request: pytest.FixtureRequest, tmp_path: Path) -> str:
    if request.param == "s3":
        return f"s3://{request.getfixturevalue('s3').new_bucket()}/store"
    if request.param == "file":
        return f"file://{tmp_path}/shared"
    return f"memory://{tmp_path.name}"


def work(store: Store, calls: list[int], array: np.ndarray = BIG[:9]):
    def function() -> StageOutput:
        calls.append(1)
        text = store.put_bytes("text", b"result")
        return StageOutput(
            {"array": store.put_arrays("array", {"a": array}), "text": text, "same": text}, {"n": 3}
        )

    return function


def compute(store: Store, calls: list[int], notes: Notes | None = None, key: str = DIGEST):
    return store.compute_once("demo", 1, key, work(store, calls), notes=notes)


def test_a_second_machine_computes_nothing(url: str, machine) -> None:
    calls: list[int] = []
    first, second = machine("a", url), machine("b", url)
    record, computed = compute(first, calls)
    assert computed
    notes = Notes()
    again, computed = compute(second, calls, notes)
    assert (again, computed, len(calls)) == (record, False, 1)
    assert notes.fetched and not notes.findings and not notes.unshared
    np.testing.assert_array_equal(second.load_arrays(again.artifacts["array"])["a"], BIG[:9])
    assert second.verify().sound and second.verify_shared().sound
    assert second.verify_shared().artifacts == 3
    assert (second.counts.hits, second.counts.misses) == (1, 0)
    listing = second.ls_shared()
    assert (listing.stages, listing.objects) == ({"demo": 1}, 2)
    notes = Notes()
    assert compute(second, calls, notes) == (record, False)
    assert not notes.fetched


def test_large_objects_travel_in_pieces(s3: S3Server, machine) -> None:
    url = f"s3://{s3.new_bucket()}"
    first, second = machine("a", url), machine("b", url)
    put = first.compute_once("demo", 1, DIGEST, work(first, [], BIG))[0]
    got = second.lookup("demo", DIGEST)
    assert got == put
    np.testing.assert_array_equal(second.load_arrays(got.artifacts["array"])["a"], BIG)


def shared_file(s3: S3Server, url: str, name: str) -> str:
    return f"{url.removeprefix('s3://')}/{name}"


@pytest.mark.parametrize("damage", ["deleted", "truncated", "longer", "flipped", "swapped"])
def test_a_damaged_shared_object_is_counted_computed_again_and_healed(
    s3: S3Server, machine, damage: str
) -> None:
    url = f"s3://{s3.new_bucket()}/store"
    calls: list[int] = []
    first, second, third = (machine(name, url) for name in "abc")
    record, _ = compute(first, calls)
    text, array = record.artifacts["text"], record.artifacts["array"]
    path = shared_file(s3, url, array.path)
    content = s3.files().cat_file(path)
    if damage == "deleted":
        s3.files().rm_file(path)
    else:
        changed = {
            "truncated": content[:-1],
            "longer": content + b"x",
            "flipped": bytes([content[0] ^ 1]) + content[1:],
            "swapped": s3.files().cat_file(shared_file(s3, url, text.path)),
        }[damage]
        s3.files().pipe_file(path, changed)
    assert [p.path for p in third.verify_shared().problems] == [array.path]
    notes = Notes()
    again, computed = compute(second, calls, notes)
    assert computed and len(calls) == 2 and again.artifacts == record.artifacts
    assert [(f.what, f.where, f.path) for f in notes.findings] == [
        ("artifact", "shared", array.path)
    ]
    assert s3.files().cat_file(path) == content
    assert third.verify_shared().sound
    assert not compute(third, calls)[1]
    assert not list(second.temporary.glob("*"))


class Marker:
    """Unpickling this makes a file."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self):
        return (Path.touch, (self.path,))


def test_hostile_shared_records_are_counted_misses(
    s3: S3Server, machine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    url = f"s3://{s3.new_bucket()}/store"
    record, _ = compute(machine("a", url), [])
    path = shared_file(s3, url, STAGE)
    good = json.loads(s3.files().cat_file(path))
    artifact, marker = good["artifacts"]["text"], tmp_path / "marker"
    no_sum = good | {"checksum": ""}

    def with_artifact(**changes: object) -> bytes:
        return json.dumps(no_sum | {"artifacts": {"text": artifact | changes}}).encode()

    other = record.model_copy(update={"stage": "other"}).with_checksum()
    monkeypatch.setattr(remote_tier, "RECORD_BYTES", 100_000)
    hostile = [
        b"",
        b"{",
        b"\xff\xfe",
        b"[" * 90_000,
        b" " * 100_001,
        pickle.dumps(Marker(marker)),
        canonical_json(other.to_json()),
        json.dumps(good | {"surplus": 1}).encode(),
        json.dumps(good | {"seconds": good["seconds"] + 1}).encode(),  # a flipped bit in a time
        json.dumps(no_sum | {"key": "1" * 64}).encode(),
        with_artifact(path="../../etc/passwd"),
        with_artifact(path="/etc/passwd"),
        with_artifact(path=f"objects/../{artifact['digest']}"),
        with_artifact(digest="1" * 64),
    ]
    victim = machine("b", url)
    for text in hostile:
        s3.files().pipe_file(path, text)
        notes = Notes()
        assert victim.lookup("demo", DIGEST, notes) is None
        assert [(f.what, f.where, f.path) for f in notes.findings] == [("record", "shared", STAGE)]
    assert not marker.exists()
    here = {p.relative_to(victim.root).parts[0] for p in victim.root.rglob("*") if p.is_file()}
    assert here <= {"locks", "shared"}
    calls: list[int] = []
    assert compute(victim, calls, notes := Notes())[1] and calls and notes.findings
    assert machine("c", url).lookup("demo", DIGEST) is not None


def test_an_artifact_that_lies_about_its_content_is_refused(s3: S3Server, machine) -> None:
    url = f"s3://{s3.new_bucket()}/store"
    record, _ = compute(machine("a", url), [])
    artifact = record.artifacts["text"]
    lie = artifact.model_copy(update={"bytes": 10**12})
    changed = record.model_copy(update={"artifacts": {"text": lie}}).with_checksum()
    s3.files().pipe_file(shared_file(s3, url, STAGE), canonical_json(changed.to_json()))
    victim = machine("b", url)
    assert victim.lookup("demo", DIGEST, notes := Notes()) is None
    assert "bytes instead of 1000000000000" in notes.findings[0].finding
    assert not (victim.root / "objects").exists()


def test_a_local_artifact_that_is_damaged_comes_back_from_the_shared_store(url, machine) -> None:
    calls: list[int] = []
    store = machine("a", url)
    record, _ = compute(store, calls)
    path = store.path(record.artifacts["array"])
    path.chmod(0o644)
    path.write_bytes(path.read_bytes()[:-3])
    assert compute(store, calls, notes := Notes()) == (record, False)
    assert [(f.what, f.where) for f in notes.findings] == [("artifact", "local")]
    assert notes.fetched and len(calls) == 1 and store.verify().sound


def test_what_was_computed_without_the_shared_store_is_put_there_later(
    url: str, machine, tmp_path: Path
) -> None:
    alone = Store(tmp_path / "a")
    compute(alone, [])
    compute(alone, [], key="1" * 64)
    store = machine("a", url)
    assert not compute(store, [])[1]  # a local hit, which the shared store lacks
    assert store.ls_shared().stages == {"demo": 1}
    report = store.push_all()
    assert (report.pushed, report.known, report.failed) == (1, 1, 0)
    assert store.ls_shared().stages == {"demo": 2}
    calls: list[int] = []
    assert not compute(machine("b", url), calls, key="1" * 64)[1] and not calls


def test_push_heals_what_verify_found(s3: S3Server, machine) -> None:
    url = f"s3://{s3.new_bucket()}/store"
    store = machine("a", url)
    record, _ = compute(store, [])
    path = shared_file(s3, url, record.artifacts["array"].path)
    content = s3.files().cat_file(path)
    s3.files().pipe_file(path, content[:-1] + b"?")  # of the same size
    assert store.push_all().pushed == 0
    assert not store.verify_shared().sound
    assert store.push_all().pushed == 1
    assert s3.files().cat_file(path) == content and store.verify_shared().sound


# Failures of the other side


def test_no_record_is_seen_without_its_objects(s3: S3Server, machine, monkeypatch) -> None:
    """An upload that breaks off: no record, and the next look-up puts everything."""
    from gvr_core.remote_folder import RemoteFolder

    url = f"s3://{s3.new_bucket()}/store"
    store = machine("a", url)
    real = RemoteFolder.upload

    def breaks(self: RemoteFolder, source: Path, name: str) -> None:
        if name.endswith(".safetensors"):
            raise remote_tier.RemoteError("cut off")
        real(self, source, name)

    with monkeypatch.context() as patch:
        patch.setattr(RemoteFolder, "upload", breaks)
        assert compute(store, [], notes := Notes())[1] and notes.unshared == "cut off"
    assert store.ls_shared().stages == {}
    assert machine("b", url).lookup("demo", DIGEST) is None
    assert store.lookup("demo", DIGEST) is not None
    assert machine("b", url).lookup("demo", DIGEST) is not None


UPLOADER = """
import sys
import numpy as np
from tasks.store import Store
store = Store(sys.argv[1])
store.compute_once("demo", 1, "0" * 64, lambda: {
    "a": store.put_arrays("a", {"a": np.random.default_rng(0).random(4_000_000)})
})
"""


def test_a_killed_uploader_leaves_nothing_that_counts(s3: S3Server, machine, tmp_path) -> None:
    url = f"s3://{s3.new_bucket()}/store"
    environment = s3.environment | {"GVR_STORE_LOCAL": str(tmp_path / "killed")}
    uploader = subprocess.Popen([sys.executable, "-c", UPLOADER, url], env=environment)
    try:
        deadline = time.monotonic() + 60
        while not (tmp_path / "killed" / "records" / "demo" / f"{DIGEST}.json").exists():
            assert time.monotonic() < deadline and uploader.poll() is None
            time.sleep(0.002)
    finally:
        uploader.kill()  # 32 MB are on their way
        uploader.wait()
    other = machine("b", url)
    assert other.ls_shared().stages == {}
    assert other.lookup("demo", DIGEST, notes := Notes()) is None and not notes.findings
    survivor = machine("killed", url)
    assert survivor.lookup("demo", DIGEST) is not None
    assert other.lookup("demo", DIGEST) is not None and other.verify_shared().sound


def test_an_outage_ends_nothing_is_warned_of_once_and_made_up_for(
    machine, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    import fsspec

    server = S3Server()
    try:
        monkeypatch.setitem(fsspec.config.conf, "s3", server.settings)
        url = f"s3://{server.new_bucket('outage')}/store"
        store = machine("a", url)
        calls: list[int] = []
        assert compute(store, calls)[1]
        server.kill()
        notes = [Notes(), Notes()]
        with caplog.at_level(logging.WARNING):
            assert compute(store, calls, notes[0], key="1" * 64)[1]
            assert compute(store, calls, notes[1], key="2" * 64)[1]
        assert len([r for r in caplog.records if "shared store" in r.message]) == 1
        assert all("connect" in note.unshared.lower() for note in notes)
        store.check()  # at the start of the next run: still no error
        server.start()  # empty, as its memory is gone
        server.new_bucket("outage")
        assert store.lookup("demo", "1" * 64) is not None
        report = store.push_all()
        assert (report.pushed, report.failed) == (1, 0)
        assert store.ls_shared().stages == {"demo": 2}
    finally:
        server.kill()


def test_a_store_that_takes_nothing_is_read(s3: S3Server, machine, monkeypatch, caplog) -> None:
    from gvr_core.remote_folder import RemoteFolder

    def refuses(self: RemoteFolder, *arguments: object) -> None:
        raise remote_tier.RemoteError("Access Denied", refused=True)

    url = f"s3://{s3.new_bucket()}/store"
    first = machine("a", url)
    first.check()
    record, _ = compute(first, [])
    for method in ("upload", "write", "create"):
        monkeypatch.setattr(RemoteFolder, method, refuses)
    reader = machine("b", url)
    reader.check()
    assert reader.lookup("demo", DIGEST) == record
    calls: list[int] = []
    notes = [Notes(), Notes()]
    with caplog.at_level(logging.WARNING):
        assert compute(reader, calls, notes[0], key="1" * 64)[1]
        assert compute(reader, calls, notes[1], key="2" * 64)[1]
    assert len([r for r in caplog.records if "takes nothing" in r.message]) == 1
    assert notes[0].unshared == "Access Denied" and "only be read" in notes[1].unshared


def test_what_cannot_work_is_an_error_at_the_start(s3: S3Server, machine, monkeypatch) -> None:
    with pytest.raises(StoreError, match="bucket does not exist"):
        machine("a", "s3://no-such-bucket/store").check()
    for url, message in [
        ("nope://bucket", "Protocol not known"),
        ("s3://key:secret@bucket/x", "password in the URL"),
        ("s3://bucket/../other", "names no folder"),
        ("s3://", "names no folder"),
        ("simplecache::s3://bucket", "no folder"),
    ]:
        with pytest.raises(ConfigError, match=message) as found:
            Store(url)
        assert "secret" not in str(found.value)
    registry = sys.modules["fsspec.registry"]
    real = registry.get_filesystem_class

    def missing(protocol: str):
        raise ImportError("Install s3fs to access S3") if protocol == "s3" else real(protocol)

    with monkeypatch.context() as patch:
        patch.setattr(registry, "get_filesystem_class", missing)
        with pytest.raises(ConfigError, match="Install s3fs"):
            Store("s3://bucket")
    bucket = s3.new_bucket()
    s3.files().pipe_file(f"{bucket}/gvr-store.json", b'{"layout": 2}')
    with pytest.raises(StoreError, match="accepted: layout 1"):
        Store(f"s3://{bucket}").check()


# Two machines at once


def test_two_machines_that_want_one_key_compute_once(s3: S3Server, machine) -> None:
    url = f"s3://{s3.new_bucket()}/store"
    calls: list[int] = []

    def slow(store: Store):
        def function() -> dict[str, Artifact]:
            calls.append(1)
            time.sleep(0.5)
            return {"text": store.put_bytes("text", b"x")}

        return function

    results: list[bool] = []
    stores = [machine(name, url) for name in "abc"]
    threads = [
        threading.Thread(
            target=lambda s: results.append(s.compute_once("demo", 1, DIGEST, slow(s))[1]),
            args=(s,),
        )
        for s in stores
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(30)
    assert len(calls) == 1 and sorted(results) == [False, False, True]
    assert not stores[0].remote.folder.entries("leases")


def test_the_lease_of_a_dead_machine_is_taken_over(s3: S3Server, machine) -> None:
    store = machine("a", f"s3://{s3.new_bucket()}/store")
    name = f"leases/demo/{DIGEST}"
    assert store.remote.folder.create(name, b"somebody 7")
    assert not store.remote.folder.create(name, b"another")
    start = time.monotonic()
    with lease.lease(store.remote.folder, name, lambda: None, expiry=0.5, poll=0.1) as found:
        assert found is None and time.monotonic() - start >= 0.5
        assert store.remote.folder.read(name, 99) != b"somebody 7"
    assert store.remote.folder.read(name, 99) is None


def test_a_held_lease_is_renewed_and_not_taken_over(s3: S3Server, machine) -> None:
    folder = machine("a", f"s3://{s3.new_bucket()}/store").remote.folder
    name, order = f"leases/demo/{DIGEST}", []

    def wait() -> None:
        with lease.lease(folder, name, lambda: None, expiry=0.8, poll=0.05):
            order.append("second")

    with lease.lease(folder, name, lambda: None, expiry=0.8):
        waiter = threading.Thread(target=wait)
        waiter.start()
        waiter.join(2.5)  # three times the expiry
        order.append("first")
    waiter.join(10)
    assert order == ["first", "second"]


# Upkeep, and other processes


def test_gc_removes_old_orphans_and_spares_the_rest(s3: S3Server, machine, monkeypatch) -> None:
    from tasks import remote_upkeep

    url = f"s3://{s3.new_bucket()}/store"
    store = machine("a", url)
    record, _ = compute(store, [])
    orphan = store.put_bytes("orphan", b"orphan")
    store.remote.folder.upload(store.path(orphan), orphan.path)
    s3.files().pipe_file(shared_file(s3, url, "objects/ab/README"), b"not ours")
    assert store.gc_shared().objects == 0 and store.gc_shared().spared == 1
    with pytest.raises(StoreError, match="accepted: 86400 s or more"):
        store.gc_shared(grace_seconds=3600)
    monkeypatch.setattr(remote_upkeep, "_its_time", lambda remote: time.time() + 25 * 3600)
    planned = store.gc_shared(dry_run=True)
    assert planned.removed == (orphan.path,)
    assert store.verify_shared().orphans == 1
    assert store.gc_shared().removed == (orphan.path,)
    assert store.verify_shared().sound and store.verify_shared().orphans == 0
    assert s3.files().exists(shared_file(s3, url, "objects/ab/README"))
    assert store.gc_shared(keep_days=0).records == 1  # and its objects with it
    assert store.ls_shared().objects == 0 and store.verify_shared().records == 0
    assert store.path(record.artifacts["text"]).exists()  # the local folder is as it was


def test_an_old_object_is_put_again_before_a_new_record_relies_on_it(
    s3: S3Server, machine, monkeypatch
) -> None:
    """A collector may be about to remove it, as no record names it."""
    url = f"s3://{s3.new_bucket()}/store"
    store = machine("a", url)
    artifact = store.put_arrays("array", {"a": BIG[:20_000]})
    store.remote.folder.upload(store.path(artifact), artifact.path)
    uploaded: list[str] = []
    real = type(store.remote.folder).upload
    monkeypatch.setattr(
        type(store.remote.folder),
        "upload",
        lambda self, source, name: (uploaded.append(name), real(self, source, name)),
    )
    work_on = lambda: {"a": store.put_arrays("array", {"a": BIG[:20_000]})}  # noqa: E731
    store.compute_once("demo", 1, DIGEST, work_on)
    assert uploaded == []  # young, and so relied on
    monkeypatch.setattr(remote_tier, "FRESH_SECONDS", -3600.0)
    store.compute_once("demo", 1, "1" * 64, work_on)
    assert uploaded == [artifact.path]


def test_a_store_is_sent_to_other_processes_with_its_url(s3: S3Server, machine, tmp_path) -> None:
    url = f"s3://{s3.new_bucket()}/store"
    store = machine("a", url)
    record, _ = compute(store, [])
    copy = pickle.loads(pickle.dumps(store))
    assert (copy.url, copy.root, copy.location) == (url, store.root, url)
    code = (
        "import sys; from tasks.store import Store; "
        "print(Store(sys.argv[1]).lookup('demo', '0' * 64).digest)"
    )
    environment = s3.environment | {"GVR_STORE_LOCAL": str(tmp_path / "worker")}
    done = subprocess.run(
        [sys.executable, "-c", code, url],
        env=environment,
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert done.stdout.strip() == record.digest, done.stderr


def test_names_and_listings_lead_nowhere_else(s3: S3Server, machine) -> None:
    url = f"s3://{s3.new_bucket()}/store"
    folder = machine("a", url).remote.folder
    for name in ("../x", "a/../b", "/etc/passwd", "a//b", "", "s3://b/x", "a\\b", ".hidden", "a/*"):
        with pytest.raises(StoreError, match="is no name"):
            folder.read(name, 10)
        with pytest.raises(StoreError, match="is no name"):
            folder.upload(Path("x"), name)
    root = url.removeprefix("s3://")
    for name in ("objects/../../evil", "objects/ab/..", "objects/ab/fine", "records/x y.json"):
        s3.files().pipe_file(f"{root}/{name}", b"x")
    assert [entry.name for entry in folder.entries("objects")] == ["objects/ab/fine"]
    assert folder.entries("records") == []


def test_a_record_of_an_earlier_version_has_no_checksum_and_is_read(tmp_path: Path) -> None:
    store = Store(tmp_path)
    record, _ = compute(store, [])
    assert record.checksum
    old = record.to_json()
    del old["checksum"]
    path = store.record_path("demo", DIGEST)
    path.write_bytes(canonical_json(old))
    assert store.lookup("demo", DIGEST) == StageRecord.from_json(canonical_json(old))
    path.write_bytes(canonical_json(record.to_json()).replace(b'"n":3', b'"n":7'))
    assert store.lookup("demo", DIGEST, notes := Notes()) is None
    assert [(f.what, f.path) for f in notes.findings] == [("record", STAGE)]
