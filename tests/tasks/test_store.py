from __future__ import annotations

import json
import os
import pickle
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from gvr_core.errors import StoreError
from tasks.store import Artifact, StageOutput, StageRecord, Store, canonical_json, stage_key

DIGEST = "0" * 64


@pytest.fixture
def store(tmp_path: Path) -> Store:
    return Store(tmp_path / "store")


def write_over(path: Path, data: bytes) -> None:
    """Change a read-only object in place, as a failing disk or a careless script would."""
    path.chmod(0o644)
    path.write_bytes(data)


# Objects


def test_root_is_argument_else_variable_else_project_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("GVR_STORE", raising=False)
    assert Store().root == tmp_path / ".gvr" / "store"
    monkeypatch.setenv("GVR_STORE", str(tmp_path / "elsewhere"))
    assert Store().root == tmp_path / "elsewhere"
    assert Store(tmp_path / "given").root == tmp_path / "given"
    assert not any(tmp_path.iterdir())  # made at the first write, not before


@pytest.mark.parametrize(
    "dtype", ["bool", "uint8", "int32", "int64", "float16", "float32", "float64"]
)
def test_arrays_come_back_as_they_were(store: Store, dtype: str) -> None:
    values = (np.arange(24).reshape(2, 3, 4) % 5).astype(dtype)
    loaded = store.load_arrays(store.put_arrays("test", {"values": values}))["values"]
    assert loaded.dtype == values.dtype
    np.testing.assert_array_equal(loaded, values)


def test_arrays_of_any_layout_have_one_digest(store: Store) -> None:
    plain = np.arange(24, dtype=np.int32).reshape(4, 6)
    wide = np.zeros((4, 12), np.int32)
    wide[:, ::2] = plain
    layouts = {
        "C": plain,
        "Fortran": np.asfortranarray(plain),
        "strided": wide[:, ::2],
        "transposed": np.ascontiguousarray(plain.T).T,
        "big-endian": plain.astype(">i4"),
        "read-only": np.broadcast_to(plain, (1, 4, 6))[0],
    }
    digests = {name: store.put_arrays("test", {"a": a}).digest for name, a in layouts.items()}
    assert set(digests.values()) == {digests["C"]}
    artifact = store.put_arrays("test", {"a": layouts["Fortran"]})
    np.testing.assert_array_equal(store.load_arrays(artifact)["a"], plain)


def test_arrays_of_no_axes_and_of_no_elements(store: Store) -> None:
    arrays = {"scalar": np.array(2.5), "empty": np.zeros((0, 3), np.float32)}
    loaded = store.load_arrays(store.put_arrays("test", arrays))
    assert loaded["scalar"].shape == () and loaded["scalar"] == 2.5
    assert loaded["empty"].shape == (0, 3) and loaded["empty"].dtype == np.float32


def test_digest_depends_on_names_values_dtypes_and_meta_only(store: Store) -> None:
    a, b = np.arange(3), np.arange(4.0)
    meta = {f"key{index}": index for index in range(8)}
    first = store.put_arrays("test", {"a": a, "b": b}, meta)
    backwards = dict(reversed(meta.items()))
    assert store.put_arrays("test", {"b": b, "a": a}, backwards).digest == first.digest
    others = [
        store.put_arrays("test", {"a": a, "c": b}, meta),
        store.put_arrays("test", {"a": a, "b": b + 1}, meta),
        store.put_arrays("test", {"a": a.astype(np.int32), "b": b}, meta),
        store.put_arrays("test", {"a": a, "b": b}, meta | {"key0": 1}),
    ]
    assert len({first.digest, *(artifact.digest for artifact in others)}) == 5


def test_one_array_of_many_is_read_alone(store: Store) -> None:
    artifact = store.put_arrays("test", {"a": np.arange(3), "b": np.zeros((5, 2))})
    assert list(store.load_arrays(artifact, ["b"])) == ["b"]
    stored = store.open_arrays(artifact)
    assert list(stored) == ["a", "b"] and stored.shape("b") == (5, 2)
    np.testing.assert_array_equal(stored["a"], [0, 1, 2])
    with pytest.raises(StoreError, match=r"no array 'c' \(accepted: a, b\)"):
        store.load_arrays(artifact, ["c"])


@pytest.mark.parametrize(
    "arrays",
    [
        {"a": np.array([object()])},
        {"a": np.array(["text"])},
        {"a": np.zeros(2, np.complex64)},
        {"a": [1, 2]},
        {"": np.zeros(2)},
        {"__metadata__": np.zeros(2)},
    ],
)
def test_what_is_no_array_of_numbers_is_refused(store: Store, arrays: dict) -> None:
    with pytest.raises(StoreError, match="accepted"):
        store.put_arrays("test", arrays)
    assert not list(store.temporary.iterdir())


def test_files_bytes_and_json_come_back(store: Store, tmp_path: Path) -> None:
    source = tmp_path / "Picture.PNG"
    source.write_bytes(b"picture")
    picture = store.put_file(source, "picture", {"width": 4})
    assert picture.path.endswith(".png") and picture.bytes == 7 and picture.meta == {"width": 4}
    assert store.path(picture).read_bytes() == source.read_bytes() == b"picture"
    text = store.put_bytes("text", b"picture", ".txt")
    assert text.digest == picture.digest and text.path != picture.path
    assert store.load_bytes(text) == b"picture"
    value = {"b": [1, 2.5, None, True], "a": "é"}
    assert store.load_json(store.put_json("value", value)) == value
    assert store.put_json("value", {"a": "é", "b": [1, 2.5, None, True]}).digest == (
        store.put_json("value", value).digest
    )


def test_missing_file_and_bad_suffix_are_refused(store: Store, tmp_path: Path) -> None:
    with pytest.raises(StoreError, match="absent"):
        store.put_file(tmp_path / "absent.ply", "splat")
    with pytest.raises(StoreError, match="suffix"):
        store.put_bytes("text", b"", "/../../x")


def test_same_content_twice_is_one_read_only_object(store: Store) -> None:
    first, second = store.put_bytes("text", b"abc"), store.put_bytes("text", b"abc")
    assert first == second
    objects = [path for path in (store.root / "objects").rglob("*") if path.is_file()]
    assert objects == [store.path(first)]
    assert objects[0].stat().st_mode & 0o222 == 0
    assert not list(store.temporary.iterdir())


def test_putting_again_heals_a_damaged_object(store: Store) -> None:
    artifact = store.put_bytes("text", b"abc")
    write_over(store.path(artifact), b"abd")
    with pytest.raises(StoreError, match="another content"):
        store.path(artifact)
    store.put_bytes("text", b"abc")
    assert store.load_bytes(artifact) == b"abc"


def test_a_change_is_seen_after_the_content_was_found_right(store: Store) -> None:
    artifact = store.put_bytes("text", b"abc" * 1000)
    path = store.path(artifact)
    time.sleep(2.1)  # from here on the stamp is trusted
    assert store.problem(artifact) is None and store._found_right
    before = path.stat()
    write_over(path, b"abd" + b"abc" * 999)
    path.chmod(0o444)
    os.utime(path, ns=(before.st_atime_ns, before.st_mtime_ns))
    assert path.stat().st_mtime_ns == before.st_mtime_ns and path.stat().st_size == before.st_size
    assert store.problem(artifact) == "has another content than its digest says"


def test_paths_that_leave_the_store_are_refused(store: Store, tmp_path: Path) -> None:
    secret = tmp_path / "secret"
    secret.write_bytes(b"secret")
    real = store.put_bytes("text", b"secret")
    paths = [
        "../secret",
        str(secret),
        f"objects/{real.digest[:2]}/../../../secret",
        f"objects/00/{real.digest}",
        f"objects/{DIGEST[:2]}/{DIGEST}",
        f"objects/{real.digest[:2]}/{real.digest}/../../../../secret",
        "",
    ]
    for path in paths:
        forged = real.model_copy(update={"path": path})
        for load in (store.path, store.load_bytes, store.load_json, store.load_arrays):
            with pytest.raises(StoreError, match="artifact path"):
                load(forged)
    place = store.path(real)
    place.unlink()
    place.symlink_to(secret)
    with pytest.raises(StoreError, match="symbolic link or folder"):
        store.load_bytes(real)
    place.unlink()
    place.parent.rename(tmp_path / "moved")
    place.parent.symlink_to(tmp_path / "moved")
    for use in (store.load_bytes, lambda _: store.put_bytes("text", b"secret")):
        with pytest.raises(StoreError, match="is a symbolic link"):
            use(real)
    assert not list((tmp_path / "moved").iterdir())


# Keys


def test_key_changes_with_every_part_and_with_nothing_else() -> None:
    inputs, config = {"scene": "ab" * 32, "views": "cd" * 32}, {"a": 1, "b": [True, None, 0.5]}
    key = stage_key("render", 1, inputs, config)
    assert key == stage_key("render", 1, dict(reversed(inputs.items())), {"b": config["b"], "a": 1})
    others = {
        stage_key("masks", 1, inputs, config),
        stage_key("render", 2, inputs, config),
        stage_key("render", 1, inputs | {"scene": "ef" * 32}, config),
        stage_key("render", 1, {"views": inputs["scene"], "scene": inputs["views"]}, config),
        stage_key("render", 1, inputs, config | {"a": 2}),
        stage_key("render", 1, inputs, config | {"c": None}),
    }
    assert len(others | {key}) == 7


@pytest.mark.parametrize(
    ("value", "place"),
    [
        ({"a": {"b": [1, (2,)]}}, r"a\.b\[1\] is of type tuple"),
        ({"a": Path("x")}, "a is of type PosixPath"),
        ({"a": np.float64(1)}, "a is of type float64"),
        ({"a": float("nan")}, "a is nan"),
        ({"a": {1: 2}}, "a has the key 1"),
        ({"a": {1, 2}}, "a is of type set"),
    ],
)
def test_values_that_are_not_json_cannot_be_keys(value: dict, place: str) -> None:
    with pytest.raises(StoreError, match=place):
        stage_key("render", 1, {}, value)


def test_bad_names_and_inputs_are_refused(store: Store) -> None:
    with pytest.raises(StoreError, match="input 'scene' is 'gallery'"):
        stage_key("render", 1, {"scene": "gallery"}, {})
    for name in ("../x", "Render", "", "a/b", "a" * 49):
        with pytest.raises(StoreError, match="stage name"):
            store.lookup(name, DIGEST)
    for key in ("../x", "", "0" * 63, "G" * 64):
        with pytest.raises(StoreError, match="stage key"):
            store.lookup("render", key)


# Records


def counting(store: Store, calls: list[int], text: bytes = b"result"):
    def function() -> StageOutput:
        calls.append(1)
        return StageOutput({"text": store.put_bytes("text", text)}, {"count": 3})

    return function


def test_record_holds_what_was_computed_and_its_cost(store: Store) -> None:
    def function() -> StageOutput:
        block = np.ones(30_000_000)  # 240 MB
        end = time.process_time() + 0.2
        while time.process_time() < end:
            block[:1000] += 1
        return StageOutput({"sum": store.put_json("sum", float(block[-1]))}, {"count": 3})

    key = stage_key("demo", 2, {}, {})
    record, computed = store.compute_once("demo", 2, key, function)
    assert computed and record.detail == {"count": 3}
    assert (record.stage, record.version, record.key) == ("demo", 2, key)
    assert record.seconds >= 0.19 and record.cpu_seconds >= 0.19
    assert record.peak_bytes > 240e6
    assert store.lookup("demo", key) == record
    on_disk = json.loads(store.record_path("demo", key).read_text())
    assert on_disk["schema"] == 1 and on_disk["artifacts"]["sum"]["kind"] == "sum"


@pytest.mark.skipif(not Path("/proc/self/clear_refs").exists(), reason="Linux only")
def test_peak_memory_is_that_of_the_stage_not_of_the_process(store: Store) -> None:
    np.ones(50_000_000).sum()  # 400 MB, gone before the stage begins
    small, _ = store.compute_once("small", 1, DIGEST, counting(store, []))
    assert small.peak_of == "stage"
    large, _ = store.compute_once(
        "large", 1, "1" * 64, lambda: {"n": store.put_json("n", float(np.ones(40_000_000).sum()))}
    )
    assert large.peak_bytes - small.peak_bytes > 250e6


def test_second_call_computes_nothing(store: Store) -> None:
    calls: list[int] = []
    first, computed = store.compute_once("demo", 1, DIGEST, counting(store, calls))
    second, again = store.compute_once("demo", 1, DIGEST, counting(store, calls))
    assert (computed, again, len(calls)) == (True, False, 1) and first == second
    assert (store.counts.hits, store.counts.misses) == (1, 1)
    _, refreshed = store.compute_once("demo", 1, DIGEST, counting(store, calls), refresh=True)
    assert refreshed and len(calls) == 2


@pytest.mark.parametrize("damage", ["deleted", "truncated", "flipped", "directory", "link"])
def test_damaged_artifact_is_a_counted_miss_and_is_healed(
    store: Store, tmp_path: Path, damage: str
) -> None:
    calls: list[int] = []
    record, _ = store.compute_once("demo", 1, DIGEST, counting(store, calls))
    path = store.path(record.artifacts["text"])
    content = path.read_bytes()
    if damage == "truncated":
        write_over(path, content[:-1])
    elif damage == "flipped":
        write_over(path, bytes([content[0] ^ 1]) + content[1:])
    else:
        path.unlink()
    if damage == "directory":
        path.mkdir()
    copy = tmp_path / "copy"
    if damage == "link":
        copy.write_bytes(content)
        path.symlink_to(copy)

    assert store.lookup("demo", DIGEST) is None
    assert (store.counts.misses, store.counts.damaged, store.counts.unreadable) == (2, 1, 0)
    if damage in ("truncated", "flipped"):
        assert not path.exists() and list((store.root / "damaged").glob(f"*{path.name}"))
    healed, computed = store.compute_once("demo", 1, DIGEST, counting(store, calls))
    assert computed and len(calls) == 2 and healed.artifacts == record.artifacts
    assert store.load_bytes(record.artifacts["text"]) == content
    assert store.lookup("demo", DIGEST) == healed
    assert not path.is_symlink() and (damage != "link" or copy.read_bytes() == content)


class Marker:
    """Unpickling this makes a file."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self):
        return (Path.touch, (self.path,))


def test_hostile_records_are_misses(store: Store, tmp_path: Path) -> None:
    calls: list[int] = []
    record, _ = store.compute_once("demo", 1, DIGEST, counting(store, calls))
    path = store.record_path("demo", DIGEST)
    good = json.loads(path.read_text())
    artifact = good["artifacts"]["text"]
    marker = tmp_path / "marker"
    hostile: list[bytes] = [
        b"",
        b"{",
        b"null",
        b"\xff\xfe",
        b"[" * 100_000,
        pickle.dumps(Marker(marker)),
        json.dumps(good | {"schema": 2}).encode(),
        json.dumps(good | {"surplus": 1}).encode(),
        json.dumps(good | {"stage": "other"}).encode(),
        json.dumps(good | {"key": "1" * 64}).encode(),
        json.dumps(good | {"seconds": "NaN"}).encode(),
        json.dumps(good | {"artifacts": [artifact]}).encode(),
        json.dumps(good | {"artifacts": {"text": artifact | {"digest": "../x"}}}).encode(),
        json.dumps(good | {"artifacts": {"text": artifact | {"path": "../../passwd"}}}).encode(),
    ]
    for text in hostile:
        path.write_bytes(text)
        before = store.counts.unreadable + store.counts.damaged
        assert store.lookup("demo", DIGEST) is None
        assert store.counts.unreadable + store.counts.damaged == before + 1
    assert not marker.exists()
    again, computed = store.compute_once("demo", 1, DIGEST, counting(store, calls))
    assert computed and again.artifacts == record.artifacts


def test_a_failed_stage_leaves_no_record_and_no_lock(store: Store) -> None:
    def fails() -> dict[str, Artifact]:
        raise ArithmeticError("no good")

    with pytest.raises(ArithmeticError, match="no good"):
        store.compute_once("demo", 1, DIGEST, fails)
    assert store.lookup("demo", DIGEST) is None
    assert store.compute_once("demo", 1, DIGEST, counting(store, []))[1]


@pytest.mark.parametrize(
    ("output", "message"),
    [
        (lambda store: None, "returned NoneType"),
        (lambda store: {"a": np.zeros(3)}, "returned dict"),
        (lambda store: StageOutput({}, {"n": np.float32(1)}), "n is of type float32"),
        (lambda store: StageOutput({}, {"n": float("inf")}), "n is inf"),
        (
            lambda store: {
                "a": Artifact(kind="x", digest=DIGEST, path=f"objects/00/{DIGEST}", bytes=0)
            },
            "is not in the store",
        ),
        (
            lambda store: {"a": Artifact(kind="x", digest=DIGEST, path="/etc/passwd", bytes=0)},
            "artifact path",
        ),
    ],
)
def test_results_that_cannot_be_stored_are_errors(store: Store, output, message: str) -> None:
    with pytest.raises(StoreError, match=message):
        store.compute_once("demo", 1, DIGEST, lambda: output(store))
    assert store.lookup("demo", DIGEST) is None


def test_a_stage_that_asks_for_itself_is_an_error_not_a_deadlock(store: Store) -> None:
    def again() -> dict[str, Artifact]:
        return store.compute_once("demo", 1, DIGEST, again)[0].artifacts

    with pytest.raises(StoreError, match="asks for its own result"):
        store.compute_once("demo", 1, DIGEST, again)


def test_digest_of_a_record_is_that_of_its_contents() -> None:
    artifact = Artifact(kind="x", digest=DIGEST, path="p", bytes=1)
    other = artifact.model_copy(update={"digest": "1" * 64})
    fields = {"stage": "demo", "version": 1, "key": DIGEST, "peak_of": "stage", "created": "now"}
    cheap = StageRecord(**fields, artifacts={"a": artifact}, seconds=1, cpu_seconds=1, peak_bytes=1)
    dear = cheap.model_copy(update={"seconds": 9.0, "key": "2" * 64})
    assert cheap.digest == dear.digest
    assert cheap.digest != cheap.model_copy(update={"artifacts": {"a": other}}).digest
    assert cheap.digest != cheap.model_copy(update={"artifacts": {"b": artifact}}).digest
    assert StageRecord.from_json(canonical_json(cheap.to_json())) == cheap


# Many at once


def test_threads_that_want_one_key_compute_once(store: Store) -> None:
    calls: list[int] = []

    def slow() -> dict[str, Artifact]:
        calls.append(1)
        time.sleep(0.2)
        return {"text": store.put_bytes("text", b"x")}

    results: list[bool] = []
    threads = [
        threading.Thread(
            target=lambda: results.append(store.compute_once("demo", 1, DIGEST, slow)[1])
        )
        for _ in range(8)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(calls) == 1 and sorted(results) == [False] * 7 + [True]


RACER = """
import sys, time
from pathlib import Path
from tasks.store import Store
store, log = Store(sys.argv[1]), Path(sys.argv[2])
def slow():
    with log.open("a") as file:
        file.write("computed\\n")
    time.sleep(0.5)
    return {"text": store.put_bytes("text", b"x")}
while not (log.parent / "go").exists():
    time.sleep(0.005)
print(store.compute_once("demo", 1, "0" * 64, slow)[1])
"""


def test_processes_that_want_one_key_compute_once(store: Store, tmp_path: Path) -> None:
    log = tmp_path / "log"
    command = [sys.executable, "-c", RACER, str(store.root), str(log)]
    racers = [subprocess.Popen(command, stdout=subprocess.PIPE, text=True) for _ in range(3)]
    time.sleep(1.5)
    (tmp_path / "go").touch()
    answers = sorted(racer.communicate(timeout=30)[0].strip() for racer in racers)
    assert answers == ["False", "False", "True"]
    assert log.read_text() == "computed\n"


HOLDER = """
import os, sys, time
from pathlib import Path
from tasks.store import Store
store, flag = Store(sys.argv[1]), Path(sys.argv[2])
def hang():
    store.put_bytes("text", b"unfinished business")
    child = os.fork()  # a worker of the stage, which outlives its parent
    if child == 0:
        time.sleep(20)
        os._exit(0)
    (flag.parent / "child").write_text(str(child))
    flag.touch()
    time.sleep(60)
store.compute_once("demo", 1, "0" * 64, hang)
"""


def test_killed_holder_frees_its_lock(store: Store, tmp_path: Path) -> None:
    flag = tmp_path / "computing"
    holder = subprocess.Popen([sys.executable, "-c", HOLDER, str(store.root), str(flag)])
    child = None
    try:
        deadline = time.monotonic() + 20
        while not flag.exists():
            assert time.monotonic() < deadline and holder.poll() is None
            time.sleep(0.01)
        child = int((tmp_path / "child").read_text())
        results: list[bool] = []
        waiter = threading.Thread(
            target=lambda: results.append(
                store.compute_once("demo", 1, DIGEST, counting(store, []))[1]
            )
        )
        waiter.start()
        waiter.join(0.5)
        assert waiter.is_alive()  # the holder has it
        holder.kill()
        holder.wait()
        os.kill(child, 0)  # the worker still runs
        waiter.join(3)
        assert results == [True]
    finally:
        holder.kill()
        holder.wait()
        if child is not None:
            os.kill(child, 9)
