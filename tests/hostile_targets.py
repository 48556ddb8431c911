"""Every parser of the project as one function of bytes, for property tests and for the fuzzer.

A target takes bytes, puts them where its parser finds them, and reads them; what was accepted is
used a little, as the next step would use it. Only a ``GVRError`` may come out. Seeds are valid
files, the smallest that there are.
"""

from __future__ import annotations

import io
import json
import pickle
import struct
import zipfile
import zlib
from collections import OrderedDict
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from hostile_trees import SCENE, SIZE, native_scene, published_tree, some_cameras, some_gaussians
from PIL import Image

Reader = Callable[[bytes, Path], object]


@dataclass(frozen=True)
class Target:
    """One parser."""

    name: str
    read: Reader
    """Reads bytes; the folder is the target's own, and outlives the call."""
    seeds: Callable[[Path], Sequence[bytes]]
    """Valid inputs; the folder may be written to."""
    words: tuple[str, ...] = ()
    """What the format is written with, for the fuzzer's dictionary."""


def _file(name: str, reader: Callable[[Path], object]) -> Reader:
    """A parser of one file."""

    def read(data: bytes, folder: Path) -> object:
        path = folder / name
        path.write_bytes(data)
        return reader(path)

    return read


def _content(*paths: Path) -> list[bytes]:
    return [path.read_bytes() for path in paths]


# Splats


def _read_splat(path: Path) -> None:
    from gvr_core.exports import write_target
    from gvr_core.splat_io import read_splat

    gaussians = read_splat(path)
    write_target(path.with_name("export.ply"), path, np.arange(len(gaussians)) == 0)


def _ply_seeds(folder: Path) -> list[bytes]:
    from plyfile import PlyData

    from gvr_core.splat_io import write_ply

    write_ply(folder / "a.ply", some_gaussians(2))
    ply = PlyData.read(folder / "a.ply")
    seeds = _content(folder / "a.ply")
    for text, order in ((True, "="), (False, ">")):
        PlyData(ply.elements, text=text, byte_order=order).write(folder / "b.ply")
        seeds += _content(folder / "b.ply")
    return seeds


def _dot_splat_seeds(folder: Path) -> list[bytes]:
    row = struct.pack("<6f8B", 0, 1, 2, 0.1, 0.1, 0.1, 1, 2, 3, 255, 255, 128, 128, 128)
    return [row, row * 3]


# Cameras


def _use(cameras: Sequence[tuple[str, Any]]) -> None:
    from datasets.own import MAX_SIDE, at_most

    for _, camera in cameras:
        at_most(camera, MAX_SIDE)
        camera.project(np.zeros((1, 3)))


COLMAP = ("cameras", "images", "points3D")


def _colmap_seeds(name: str, binary: bool) -> Callable[[Path], list[bytes]]:
    def seeds(folder: Path) -> list[bytes]:
        texts = _colmap_files(folder)
        return [(_colmap_binary if binary else texts)[name]]

    return seeds


def _colmap_files(folder: Path) -> dict[str, bytes]:
    from datasets.colmap import write_colmap_text

    named = [(f"{name}.png", camera) for name, camera in some_cameras().items()]
    write_colmap_text(folder / "text", named, [[0, 0, 1.0]], [[1, 2, 3]])
    return {name: (folder / "text" / f"{name}.txt").read_bytes() for name in COLMAP}


_colmap_binary = {
    "cameras": struct.pack("<QIiQQ4d", 1, 1, 1, 12, 9, 10, 10, 6, 4.5),
    "images": struct.pack("<QI7dI", 1, 1, 1, 0, 0, 0, 0, 0, 4, 1)
    + b"a.png\0"
    + struct.pack("<Q2dQ", 1, 0.5, 0.5, 1),
    "points3D": struct.pack("<QQ3d3BdQII", 1, 1, 0, 0, 1, 1, 2, 3, 0.5, 1, 1, 0),
}


def _read_colmap(name: str, binary: bool) -> Reader:
    def read(data: bytes, folder: Path) -> None:
        from datasets.colmap import read_colmap_model

        model = folder / "model"
        if not model.is_dir():
            model.mkdir()
            for other, content in (_colmap_binary if binary else _colmap_files(folder)).items():
                (model / f"{other}.{'bin' if binary else 'txt'}").write_bytes(content)
        (model / f"{name}.{'bin' if binary else 'txt'}").write_bytes(data)
        _use(list(read_colmap_model(model).cameras.items()))

    return read


def _read_inria(path: Path) -> None:
    from datasets.inria_cameras import read_inria_cameras

    _use(read_inria_cameras(path))


def _inria_seeds(folder: Path) -> list[bytes]:
    from datasets.inria_cameras import write_inria_cameras

    write_inria_cameras(folder / "cameras.json", list(some_cameras(2).items()))
    return _content(folder / "cameras.json")


def _read_transforms(path: Path) -> None:
    from datasets.cameras_file import read_cameras

    _use(read_cameras(path))


def _transforms_seeds(folder: Path) -> list[bytes]:
    from transforms_files import instant_ngp, nerfstudio

    named = [(f"{name}.png", camera) for name, camera in some_cameras(2).items()]
    angles = {"camera_angle_x": 1.0, "w": 12, "h": 9, "frames": nerfstudio(named)["frames"][:1]}
    return [json.dumps(x).encode() for x in (nerfstudio(named), instant_ngp(named), angles)]


# Labels, queries, lists


def _read_labels(path: Path) -> None:
    from datasets.lerf_labels import read_frame_labels
    from datasets.mask_folders import Notes

    notes = Notes()
    for mask in read_frame_labels(path, notes).masks.values():
        mask.is_visible()
    notes.lines()


def _labels_seeds(folder: Path) -> list[bytes]:
    corners = [[1, 1], [5, 1.5], [5, 6], [1, 6]]
    flat = [[x for corner in corners for x in corner]]
    objects = [
        {"category": "mug", "segmentation": corners, "bbox": [1, 1, 5, 6]},
        {"category": "tea", "segmentation": flat, "bbox": [5, 6, 1, 1]},
    ]
    info = {"name": "frame_00001.jpg", "width": 12, "height": 9}
    return [json.dumps({"info": info, "objects": objects}).encode()]


def _read_classes(path: Path) -> None:
    from datasets.mask_folders import Notes
    from datasets.ovs3d import read_classes

    read_classes(path, Notes())


def _read_scene_file(path: Path) -> None:
    from datasets.native_records import read_scene_file

    read_scene_file(path)


def _read_queries(path: Path) -> None:
    from datasets.native_records import read_queries

    for query in read_queries(path, ("red box", "blue box")):
        query.model_dump_json()


def _read_npy_labels(path: Path) -> None:
    from datasets.native_records import read_labels

    read_labels(path, 6, 2)


def _npy(array: np.ndarray) -> bytes:
    file = io.BytesIO()
    np.save(file, array)
    return file.getvalue()


def _native_files(*names: str) -> Callable[[Path], list[bytes]]:
    def seeds(folder: Path) -> list[bytes]:
        scene = native_scene(folder / "native")
        return _content(*(scene / name for name in names))

    return seeds


# Pictures


def _read_picture(path: Path) -> None:
    from datasets.images import read_image, read_mask
    from datasets.picture_folder import picture_size

    data = path.read_bytes()
    if data.startswith(_PNG):
        path.write_bytes(with_sums(data))
    size = picture_size(path)
    # Larger ones are decoded as these are, only slower.
    if size[0] * size[1] <= 1_000_000:
        read_image(path)
        read_mask(path)


_PNG = b"\x89PNG\r\n\x1a\n"


def with_sums(data: bytes) -> bytes:
    """A PNG with the checksums put right, without which nothing behind them is reached."""
    out, at = [_PNG], len(_PNG)
    while at + 8 <= len(data):
        (length,) = struct.unpack(">I", data[at : at + 4])
        body = data[at + 4 : at + 8 + length]
        out.append(data[at : at + 4] + body + struct.pack(">I", zlib.crc32(body)))
        at += 12 + length
    return b"".join(out)


def _picture_seeds(folder: Path) -> list[bytes]:
    rng = np.random.default_rng(0)
    rgb = Image.fromarray(rng.integers(0, 255, (9, 12, 3), np.uint8))
    made = [
        (rgb, "PNG", {}), (rgb.convert("RGBA"), "PNG", {}), (rgb.convert("P"), "PNG", {}),
        (rgb.convert("1"), "PNG", {}), (rgb.convert("L"), "PNG", {"transparency": 0}),
        (rgb, "JPEG", {}), (rgb.convert("CMYK"), "JPEG", {}), (rgb, "BMP", {}), (rgb, "WEBP", {}),
        (rgb, "TIFF", {}), (rgb, "TIFF", {"compression": "tiff_lzw"}),
    ]  # fmt: skip
    seeds = []
    for picture, kind, options in made:
        file = io.BytesIO()
        picture.save(file, kind, **options)
        seeds.append(file.getvalue())
    return seeds


# Configurations


def _read_suite(path: Path) -> None:
    from flows.suite import parse_suite

    parse_suite(path)


def _suite_seeds(folder: Path) -> list[bytes]:
    from flows.bundled import bundled_suites

    mine = b'name="mine"\n[[datasets]]\nname="gallery"\nsettings={seeds=[1]}\n[models]\n'
    return [mine + b'encoder="random:1"\n', *_content(*bundled_suites().values())]


def _read_manifest(path: Path) -> None:
    from gvr_core.weights.folder import stored
    from gvr_core.weights.manifest import known

    for entry in known(path.parent).values():
        stored(entry, path.parent)


def _manifest_seeds(folder: Path) -> list[bytes]:
    url = "http://127.0.0.1/a"
    text = (
        f'[[checkpoints]]\nname="a"\nrole="x"\nlicence="MIT"\nsource="{url}"\n'
        f'[[checkpoints.files]]\npath="a/b.pth"\nurl="{url}"\nsize=1\nsha256="{64 * "a"}"\n'
    )
    return [text.encode()]


def _read_layout(path: Path) -> None:
    from datasets.layout import read_layout

    read_layout(path)


def _layout_seeds(folder: Path) -> list[bytes]:
    import datasets

    return _content(*sorted(Path(datasets.__path__[0]).glob("layouts/*.toml")))


def _read_open_clip(path: Path) -> None:
    from gvr_core.models.open_clip_config import file_config

    file_config(path)


def _open_clip_seeds(folder: Path) -> list[bytes]:
    model = {"embed_dim": 8, "vision_cfg": {"image_size": 32}, "text_cfg": {"width": 8}}
    whole = {"model_cfg": model, "preprocess_cfg": {"mean": [0.5] * 3, "std": [0.5] * 3}}
    return [json.dumps(x).encode() for x in (model, whole)]


def _read_grounding_dino(path: Path) -> None:
    from gvr_core.models.grounding_dino_config import VARIANTS, configuration

    configuration(next(iter(VARIANTS)), path)


def _read_bert(path: Path) -> None:
    from gvr_core.models.bert_folder import bert_folder

    (path.parent / "vocab.txt").write_text("a\n")
    bert_folder(path.parent)


# Weights


def _load_state(path: Path) -> None:
    from gvr_core.errors import ModelError
    from gvr_core.models.checkpoints import checkpoint, load_state
    from gvr_core.weights.safety import check_harmless

    try:
        check_harmless(path, path.name)
    except ModelError:
        load_state(checkpoint(path))
        return
    load_state(checkpoint(path))


def _state() -> OrderedDict[str, Any]:
    import torch

    return OrderedDict(a=torch.ones(2, 3), b=torch.nn.Parameter(torch.zeros(2, dtype=torch.half)))


def _torch_seeds(folder: Path) -> list[bytes]:
    import torch

    seeds = []
    for state in (_state(), {"model": _state(), "epoch": 3, "names": ["a", (1, 2.5), None]}):
        for zipped in (True, False):
            file = io.BytesIO()
            torch.save(state, file, _use_new_zipfile_serialization=zipped)
            seeds.append(file.getvalue())
    return seeds


def _parts(data: bytes) -> dict[str, bytes]:
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def _pickle_seeds(folder: Path) -> list[bytes]:
    seeds = [seed for seed in _torch_seeds(folder) if seed.startswith(b"PK")]
    return [_parts(seed)["archive/data.pkl"] for seed in seeds]


@lru_cache(maxsize=1)
def _archive() -> dict[str, bytes]:
    return _parts(_torch_seeds(Path())[0])


def in_archive(data: bytes) -> bytes:
    """A pickle in an archive of ``torch.save`` that is otherwise whole."""
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as archive:
        for name, content in _archive().items():
            archive.writestr(name, data if name.endswith(".pkl") else content)
    return file.getvalue()


def _read_pickle(data: bytes, folder: Path) -> object:
    return _file("a.pth", _load_state)(in_archive(data), folder)


def _safetensors_seeds(folder: Path) -> list[bytes]:
    from safetensors.torch import save

    return [save({"a": _state()["a"]}), save(dict(_state()), {"x": "y"})]


def _read_onnx(path: Path) -> None:
    from gvr_core.models.sam_onnx import _all_masks

    _all_masks(path.read_bytes(), path)


def _onnx_seeds(folder: Path) -> list[bytes]:
    from onnx import TensorProto, helper

    from gvr_core.models.sam_onnx import DECODER_INPUTS

    names = ("masks", "iou_predictions", "low_res_masks")
    inputs = [helper.make_tensor_value_info(n, TensorProto.FLOAT, [1]) for n in DECODER_INPUTS]
    outputs = [helper.make_tensor_value_info(n, TensorProto.FLOAT, [1]) for n in names]
    first = next(iter(DECODER_INPUTS))
    nodes = [helper.make_node("MatMul", [first, "w"], [name]) for name in names]
    weights = [helper.make_tensor("w", TensorProto.FLOAT, [1], [2.0])]
    graph = helper.make_graph(nodes, "g", inputs, outputs, weights)
    return [helper.make_model(graph).SerializeToString()]


# Predictions


def _read_predictions(ending: str, flags: bool = False) -> Reader:
    def read(data: bytes, folder: Path) -> None:
        from gvr_core.books import Books
        from gvr_core.methods.predictions import Predictions, PredictionsConfig
        from gvr_core.scene import Query, Scene, View

        place = folder / "predictions" / SCENE / ("flags" if flags else "v01")
        place.mkdir(parents=True, exist_ok=True)
        if data.startswith(_PNG):
            data = with_sums(data)
        (place / f"a red box{ending}").write_bytes(data)
        views = tuple(View(name, camera) for name, camera in some_cameras(2).items())
        scene = Scene("test", SCENE, some_gaussians(), views)
        config = PredictionsConfig(folder=folder / "predictions")
        config.digest()
        Predictions(config).segment(
            scene, Books.none(), None, Query(id="red-1", text="a red box", target="red box")
        )

    return read


def _prediction_seeds(folder: Path) -> list[bytes]:
    file = io.BytesIO()
    grey = np.zeros((SIZE[1], SIZE[0]), np.uint8)
    grey[2:4] = 255
    Image.fromarray(grey).save(file, "PNG")
    return [file.getvalue()]


# The store


def _read_record(data: bytes, folder: Path) -> None:
    from tasks.records import StageRecord, canonical_json

    record = StageRecord.from_json(data)
    canonical_json(record.to_json())
    assert record.digest
    assert record.total_bytes >= 0


KEY = "a" * 64


def _record_seeds(folder: Path) -> list[bytes]:
    artifact = {
        "kind": "x",
        "digest": KEY,
        "path": f"objects/aa/{KEY}.json",
        "bytes": 3,
        "meta": {"n": 1},
    }
    record = {
        "schema": 1, "stage": "render", "version": 1, "key": KEY, "artifacts": {"a": artifact},
        "seconds": 1.5, "cpu_seconds": 2.0, "peak_bytes": 100, "peak_of": "stage", "created": "now",
        "detail": {"n_patches": 3, "seconds": {"a": 0.5}},
    }  # fmt: skip
    return [json.dumps(record).encode()]


def _read_lookup(data: bytes, folder: Path) -> None:
    from tasks.store import Store

    store = Store(folder / "store")
    path = store.record_path("render", KEY)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(data)
    store.lookup("render", KEY)
    list(store.records())


def _read_arrays(path: Path) -> None:
    from tasks.arrays import StoredArrays
    from tasks.groundings import unpack_answers

    stored = StoredArrays(path)
    for name in stored:
        stored.shape(name)
        assert stored[name] is not None
    unpack_answers(stored)


def _arrays_seeds(folder: Path) -> list[bytes]:
    from gvr_core.methods.base import Grounding
    from tasks.arrays import write_arrays
    from tasks.groundings import pack_groundings

    flags = np.array([True, False, True, False, False, False])
    found = Grounding(flags, flags.astype(np.float32), np.zeros(3), True, 0.5)
    given = Grounding(
        flags, flags.astype(np.float32), None, True, 0.5, given={"v": np.ones((2, 2))}
    )
    write_arrays(folder / "a.safetensors", pack_groundings([found, given], 6), {"n": 1})
    return _content(folder / "a.safetensors")


def _read_prefect(data: bytes, folder: Path) -> None:
    from gvr_core.errors import StoreError
    from tasks.prefect_results import RESULT_SERIALIZER, refuse

    reason = refuse(data, f"render-{KEY}")
    if reason is not None:
        raise StoreError(reason)
    RESULT_SERIALIZER.loads(json.loads(data)["result"].encode())


def _prefect_seeds(folder: Path) -> list[bytes]:
    from tasks.prefect_results import RESULT_SERIALIZER

    metadata = {
        "storage_key": f"render-{KEY}",
        "expiration": None,
        "serializer": RESULT_SERIALIZER.model_dump(mode="json"),
        "prefect_version": "3",
        "storage_block_id": None,
    }
    return [json.dumps({"metadata": metadata, "result": '{"a": 1}'}).encode()]


# Results


def _read_result(name: str) -> Reader:
    def read(data: bytes, folder: Path) -> None:
        from record_samples import reseal

        from reports.aggregate import aggregate
        from reports.mlflow_content import run_contents
        from reports.result_io import read_result
        from reports.tables import readme_block

        place = _sample(folder)
        original = (place / name).read_bytes()
        (place / name).write_bytes(data)
        try:
            if name != "SHA256SUMS":
                reseal(place)
            result, rows = read_result(place)
            run_contents(place, result, rows, aggregate(rows, result.scenes))
            readme_block(result, rows)
        finally:
            (place / name).write_bytes(original)
            reseal(place)

    return read


def _sample(folder: Path) -> Path:
    from record_samples import make_sample

    from reports.result_io import write_result

    result, rows, pictures = make_sample()
    place = folder / "sample"
    return place if place.is_dir() else write_result(place, result, rows, pictures)


def _result_seeds(name: str) -> Callable[[Path], list[bytes]]:
    return lambda folder: _content(_sample(folder) / name)


# Whole trees: one byte chooses a file, one what is done to it


def _read_tree(layout: str) -> Reader:
    def read(data: bytes, folder: Path) -> None:
        from datasets.registry import get_dataset

        root = _tree(layout, folder)
        files = sorted(path for path in root.rglob("*") if path.is_file())
        path = files[data[0] % len(files)] if data else files[0]
        original = path.read_bytes()
        target = change_file(path, data[1:])
        try:
            name = f"folder:{root}" if layout == "native" else layout
            dataset = get_dataset(name, {} if layout == "native" else {"root": str(root)})
            for scene in dataset.scenes():
                found = dataset.load(scene)
                views = {view.name: view for view in found.truth.test_views}
                for view, thing in found.truth.masks:
                    found.truth.mask(views[view], thing)
        finally:
            if target.is_symlink() or target.is_file():
                target.unlink()
            elif target.is_dir():
                target.rmdir()
            path.write_bytes(original)

    return read


def _tree(layout: str, folder: Path) -> Path:
    root = folder / "tree" if layout == "native" else folder / "trees" / layout
    if not root.is_dir():
        if layout == "native":
            native_scene(root / SCENE)
        else:
            published_tree(layout, folder / "trees")
    return root


def change_file(path: Path, change: bytes) -> Path:
    """Do to a file of a tree what a byte says; where its name is then taken by something."""
    kind = change[0] % 8 if change else 0
    content = path.read_bytes()
    if kind < 4:
        if kind == 0:
            path.write_bytes(change[1:])
        elif kind == 1:
            path.write_bytes(content[: len(content) * (change[1] if len(change) > 1 else 0) // 256])
        else:
            at = int.from_bytes(change[1:3], "big") % max(1, len(content))
            path.write_bytes(content[:at] + change[3:] + content[at + (kind == 2) * len(change) :])
        return path
    path.unlink()
    if kind == 4:
        path.mkdir()
    elif kind == 5:
        path.symlink_to(path.name)
    elif kind == 6:
        path.symlink_to("/etc/hostname")
    return path


def _tree_seeds(layout: str) -> Callable[[Path], list[bytes]]:
    def seeds(folder: Path) -> list[bytes]:
        count = len([path for path in _tree(layout, folder).rglob("*") if path.is_file()])
        return [bytes([i, kind, 7, 9]) for i in range(count) for kind in range(8)]

    return seeds


JSON_WORDS = ("[", "{", "}", "null", "NaN", "Infinity", "1e999", "true", '"', "9" * 400, "\\ud800")
TOML_WORDS = ("[[", "]]", "=", '"""', "0x", "inf", "nan", "1979-05-27", "'", "{", ".", "\\u00")
PICKLE_WORDS = ("ctorch._utils\n_rebuild_tensor_v2\n", "ccollections\nOrderedDict\n", "R.", "Q.")
PLY_WORDS = (
    "element vertex ",
    "property float ",
    "property list uchar int ",
    "end_header\n",
    "inf",
)

TARGETS: dict[str, Target] = {
    target.name: target
    for target in (
        Target("ply", _file("a.ply", _read_splat), _ply_seeds, PLY_WORDS),
        Target("splat", _file("a.splat", _read_splat), _dot_splat_seeds),
        *(
            Target(
                f"colmap-{part}-{'bin' if binary else 'txt'}",
                _read_colmap(part, binary),
                _colmap_seeds(part, binary),
                () if binary else ("PINHOLE ", "nan ", "inf ", "#", "OPENCV "),
            )
            for part in COLMAP
            for binary in (True, False)
        ),
        Target("cameras-json", _file("cameras.json", _read_inria), _inria_seeds, JSON_WORDS),
        Target(
            "transforms-json", _file("transforms.json", _read_transforms), _transforms_seeds,
            (*JSON_WORDS, '"camera_angle_x"', '"applied_scale"', '"fl_x"'),
        ),
        Target("lerf-labels", _file("frame_00001.json", _read_labels), _labels_seeds, JSON_WORDS),
        Target("classes", _file("classes.txt", _read_classes), lambda _: [b"red box\nmug\n"]),
        Target("scene-json", _file("scene.json", _read_scene_file), _native_files("scene.json"),
               JSON_WORDS),
        Target("queries-json", _file("queries.json", _read_queries), _native_files("queries.json"),
               JSON_WORDS),
        Target("labels-npy", _file("labels.npy", _read_npy_labels), _native_files("labels.npy"),
               ("descr", "shape", "fortran_order", "|O", "<i2")),
        Target("picture", _file("a.png", _read_picture), _picture_seeds,
               ("IHDR", "tRNS", "PLTE", "iCCP", "zTXt", "acTL", "fcTL", "RIFF", "VP8L")),
        Target("suite", _file("a.toml", _read_suite), _suite_seeds, TOML_WORDS),
        Target("manifest", _file("manifest.toml", _read_manifest), _manifest_seeds, TOML_WORDS),
        Target("layout", _file("a.toml", _read_layout), _layout_seeds, TOML_WORDS),
        Target("open-clip-config", _file("a.json", _read_open_clip), _open_clip_seeds, JSON_WORDS),
        Target("grounding-dino-config", _file("a.toml", _read_grounding_dino),
               lambda _: [b"num_queries=900\nbackbone='swin_T_224_1k'\n"], TOML_WORDS),
        Target("bert-config", _file("config.json", _read_bert),
               lambda _: [b'{"model_type": "bert"}'], JSON_WORDS),
        Target("torch-file", _file("a.pth", _load_state), _torch_seeds, PICKLE_WORDS),
        Target("torch-pickle", _read_pickle, _pickle_seeds, PICKLE_WORDS),
        Target("safetensors", _file("a.safetensors", _load_state), _safetensors_seeds,
               ("data_offsets", "dtype", "BF16", "F8_E4M3", "U64", "shape")),
        Target("onnx", _file("decoder.onnx", _read_onnx), _onnx_seeds),
        Target("predictions-png", _read_predictions(".png"), _prediction_seeds),
        Target("predictions-maps", _read_predictions(".npy"),
               lambda _: [_npy(np.full((9, 12), 0.5)), _npy(np.zeros((3, 9, 12), np.float32))]),
        Target("predictions-flags", _read_predictions(".npy", flags=True),
               lambda _: [_npy(np.array([0, 2])), _npy(np.ones(6, bool))]),
        Target("stage-record", _read_record, _record_seeds, JSON_WORDS),
        Target("store-lookup", _read_lookup, _record_seeds, JSON_WORDS),
        Target("stored-arrays", _file("a.safetensors", _read_arrays), _arrays_seeds,
               ("data_offsets", "dtype", "BF16", "F8_E4M3", "shape")),
        Target("prefect-result", _read_prefect, _prefect_seeds, (*JSON_WORDS, '"pickle"')),
        *(
            Target(f"result-{name}", _read_result(name), _result_seeds(name), JSON_WORDS)
            for name in ("result.json", "rows.jsonl", "SHA256SUMS")
        ),
        *(
            Target(f"tree-{layout}", _read_tree(layout), _tree_seeds(layout))
            for layout in ("native", "lerf_ovs", "lerf_mask", "ovs3d")
        ),
    )
}  # fmt: skip
"""Every parser, by name."""


def _read_broken(data: bytes, folder: Path) -> None:
    if data.startswith(b"{"):
        raise KeyError("broken on purpose")
    if data.startswith(b"["):
        bytearray(b"x") * 2**28


BROKEN = Target("broken", _read_broken, lambda _: [b"12", b"34"], ("{", "["))
"""A parser that is broken on purpose: the fuzzer has to find how."""


def evil(command: str) -> bytes:
    """A pickle that runs a shell command when it is loaded."""

    class Evil:
        def __reduce__(self) -> tuple[Any, ...]:
            import os

            return os.system, (command,)

    return pickle.dumps(Evil())
