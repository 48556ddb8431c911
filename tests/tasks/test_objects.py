"""The objects of the store: what goes in comes out, and nothing leaves the store."""

from __future__ import annotations

import os
import time
from pathlib import Path

import numpy as np
import pytest

from gvr_core.errors import StoreError
from tasks.store import Store

DIGEST = "0" * 64


@pytest.fixture
def store(tmp_path: Path) -> Store:
    return Store(tmp_path / "store")


def write_over(path: Path, data: bytes) -> None:
    """Change a read-only object in place, as a failing disk or a careless script would."""
    path.chmod(0o644)
    path.write_bytes(data)


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
