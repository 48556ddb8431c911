from __future__ import annotations

import base64
import json
import lzma
import pickle
import sys
from pathlib import Path
from typing import Any

import pytest
from prefect import flow
from prefect.filesystems import LocalFileSystem
from prefect.results import ResultStore

from tasks.prefect_results import RESULT_SERIALIZER, StageResultStorage, result_key
from tasks.prefect_runtime import PrefectRuntime
from tasks.stage import Stage, run_stage
from tasks.store import Artifact, Store

KEY = "0" * 64


class Marker:
    """Unpickling this makes a file."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self):
        return (Path.touch, (self.path,))


def write_one(store: Store, inputs: object, config: object) -> dict[str, Artifact]:
    return {"n": store.put_json("n", 1)}


DEMO = Stage("demo", 1, write_one)


def record(key: str, result: str = "1", **serializer: Any) -> dict[str, Any]:
    plain = RESULT_SERIALIZER.model_dump(mode="json")
    return {
        "metadata": {
            "storage_key": key,
            "expiration": None,
            "serializer": serializer or plain,
            "prefect_version": "3.8.8",
            "storage_block_id": None,
        },
        "result": result,
    }


def doctored(key: str, marker: Path) -> dict[str, dict[str, Any]]:
    """Result records that run code in whoever reads them as Prefect does, and some bad ones."""
    pickled = pickle.dumps(Marker(marker))
    text = base64.encodebytes(pickled).decode()
    squeezed = base64.encodebytes(lzma.compress(base64.encodebytes(pickled))).decode()
    plain = RESULT_SERIALIZER.model_dump(mode="json")
    return {
        "cloudpickle": record(key, text, type="pickle", picklelib="cloudpickle"),
        "pickle": record(key, text, type="pickle", picklelib="pickle"),
        "compressed": record(key, squeezed, type="compressed/pickle"),
        "old form": {"serializer": {"type": "pickle"}, "data": text},
        "library": record(key, "1", **(plain | {"jsonlib": "evil"})),
        "decoder": record(key, "{}", **(plain | {"object_decoder": "evil.decode"})),
        "surplus": record(key) | {"data": text},
        "other key": record(result_key("other", KEY)),
        "no text": record(key) | {"result": {"a": 1}},
    }


def files_of(store: Store, key: str) -> Path:
    return store.root / "prefect-results" / "demo" / f"{key}.json"


def test_a_record_that_prefect_would_run_is_refused(
    store: Store, tmp_path: Path, evil: Path
) -> None:
    key = result_key("demo", KEY)
    path = files_of(store, KEY)
    path.parent.mkdir(parents=True)
    guarded = ResultStore(result_storage=StageResultStorage(root=str(store.root)))
    for name, content in doctored(key, evil).items():
        path.write_text(json.dumps(content))
        assert not guarded.exists(key), name
        with pytest.raises(ValueError, match="is refused"):
            guarded.read(key)
    assert not evil.exists()
    path.write_text(json.dumps(record(key, '{"a": 1}')))
    assert guarded.exists(key) and guarded.read(key).result == {"a": 1}


@pytest.mark.parametrize("name", ["cloudpickle", "pickle", "compressed", "library", "decoder"])
def test_the_same_records_do_run_code_without_the_guard(
    tmp_path: Path, evil: Path, name: str
) -> None:
    """The test above would be empty if the records were harmless."""
    key = result_key("demo", KEY)
    (tmp_path / key).write_text(json.dumps(doctored(key, evil)[name]))
    ResultStore(result_storage=LocalFileSystem(basepath=str(tmp_path))).exists(key)
    assert evil.exists()


@pytest.mark.parametrize("name", ["cloudpickle", "library", "other key"])
def test_a_doctored_record_in_a_flow_is_replaced_not_run(
    prefect_server: PrefectRuntime, store: Store, evil: Path, name: str
) -> None:
    @flow
    def one() -> str:
        return run_stage(DEMO, store, {}, {}).state

    assert one() == "Completed"
    key = DEMO.key({}, {})
    path = files_of(store, key)
    good = json.loads(path.read_text())
    assert good["metadata"]["serializer"]["object_decoder"] is None
    path.write_text(json.dumps(doctored(result_key("demo", key), evil)[name]))
    assert one() == "Cached"  # by the store's own record, which is sound
    assert not evil.exists()
    assert json.loads(path.read_text()) == good


def test_a_prefect_record_of_another_result_is_not_believed(
    prefect_server: PrefectRuntime, store: Store
) -> None:
    @flow
    def one() -> Artifact:
        return run_stage(DEMO, store, {}, {})["n"]

    artifact = one()
    path = files_of(store, DEMO.key({}, {}))
    other = store.put_json("n", 666)
    path.write_text(path.read_text().replace(artifact.digest, other.digest))
    assert one() == artifact


@pytest.mark.parametrize("key", ["../x-" + KEY, "/etc/passwd", "demo", KEY, "demo-" + KEY + "/x"])
def test_keys_that_are_no_stage_results_are_refused(store: Store, key: str) -> None:
    storage = StageResultStorage(root=str(store.root))
    content = json.dumps(record(key)).encode()
    with pytest.raises(ValueError, match="result key"):
        storage.read_path(key)
    with pytest.raises(ValueError, match="result key"):
        storage.write_path(key, content)
    with pytest.raises(ValueError, match="cannot be stored"):
        storage.write_path(result_key("demo", KEY), b"\x80\x04pickle")
    assert not store.root.exists()


@pytest.fixture
def store(tmp_path: Path) -> Store:
    return Store(tmp_path / "store")


@pytest.fixture
def evil(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A module that makes a file when it is imported; returns the file, still to be made."""
    marker = tmp_path / "marker"
    folder = tmp_path / "modules"
    folder.mkdir()
    (folder / "evil.py").write_text(
        f"import pathlib\npathlib.Path({str(marker)!r}).touch()\n"
        "loads = decode = lambda *args, **kwargs: None\n"
    )
    monkeypatch.syspath_prepend(folder)
    monkeypatch.delitem(sys.modules, "evil", raising=False)
    yield marker
    sys.modules.pop("evil", None)


def test_a_record_that_the_disk_does_not_take_is_said_and_no_error(
    prefect_server: PrefectRuntime, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    store = Store(tmp_path / "store")
    store.root.mkdir()
    (store.root / "prefect-results").write_text("in the way")

    @flow
    def once() -> str:
        return run_stage(DEMO, store, {}, {}).state

    assert once() == "Completed"
    assert once() == "Cached"
    said = [line for line in caplog.messages if "is not kept" in line]
    assert len(said) == 2
    assert not any("Traceback" in (record.exc_text or "") for record in caplog.records)
