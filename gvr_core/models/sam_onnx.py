"""Any SAM that was exported as a pair of ONNX graphs, through onnxruntime."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterator, Mapping
from functools import cached_property
from pathlib import Path
from threading import RLock
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from gvr_core.errors import ModelError
from gvr_core.models.checkpoints import Checkpoint, checkpoint
from gvr_core.models.cpu_workers import cpu_workers
from gvr_core.models.sam_architecture import MEAN, STD
from gvr_core.models.sam_prompts import Embedding, input_coordinates, input_size

if TYPE_CHECKING:
    import onnx
    import torch

ENCODER, DECODERS = "encoder.onnx", ("decoder.onnx", "sam.onnx")
"""Names of the two graphs in their folder; of the decoder, the first that is there."""
DECODER_INPUTS = (
    "image_embeddings",
    "point_coords",
    "point_labels",
    "mask_input",
    "has_mask_input",
    "orig_im_size",
)
"""Inputs of the decoder that segment_anything's own export script makes."""
BOX_FIRST, BOX_SECOND, PADDING = 2, 3, -1
"""Labels in an exported decoder, beside 1 and 0 for points inside and outside."""


class OnnxSam:
    """An encoder and a decoder in one folder, as segment_anything's export script makes them.

    Many exports choose the best of the masks inside the graph. The masks that it chooses from
    are taken out before that, so that all three levels are there; work on whole pictures that
    the graph does after the choice is not done.

    Args:
        encoder: Picture -> embedding. Neither graph may keep its weights in further files.
        decoder: Embedding and prompt -> masks.
    """

    def __init__(self, encoder: Checkpoint, decoder: Checkpoint) -> None:
        self._encoder_file = encoder
        self._decoder_file = decoder
        self._loading = RLock()

    @staticmethod
    def files(folder: Path) -> tuple[Checkpoint, Checkpoint]:
        """The two graphs of a folder: ``encoder.onnx``, and ``decoder.onnx`` or ``sam.onnx``.

        Raises:
            ModelError: if one is missing.
        """
        found = [name for name in DECODERS if (folder / name).is_file()]
        return checkpoint(folder / ENCODER), checkpoint(folder / (found or DECODERS)[0])

    @property
    def name(self) -> str:
        """Name, version and digests of the two graphs."""
        return f"sam-onnx/1:{self._encoder_file.tag}+{self._decoder_file.tag}"

    @property
    def side(self) -> int:
        """Side of the square input, pixels."""
        side = self._encoder.get_inputs()[0].shape[-1]
        return int(side)

    @property
    def device(self) -> torch.device:
        """Where logits are: the processor."""
        import torch

        return torch.device("cpu")

    @property
    def _encoder(self) -> Any:
        with self._loading:
            return self._encoder_session

    @property
    def _decoder(self) -> Any:
        with self._loading:
            return self._decoder_session

    @cached_property
    def _encoder_session(self) -> Any:
        path = self._encoder_file.path
        graph = _graph(_content(self._encoder_file), path).SerializeToString()
        session = _session(graph, path, os.cpu_count() or 1)
        inputs, outputs = session.get_inputs(), session.get_outputs()
        shape = inputs[0].shape
        if len(inputs) != 1 or len(outputs) != 1 or len(shape) != 4 or shape[1] != 3:
            raise ModelError(
                f"takes {[(i.name, i.shape) for i in inputs]}",
                path=path,
                accepted="one input of shape (B, 3, side, side), normalised, and one output",
            )
        if not isinstance(shape[2], int) or shape[2] != shape[3]:
            raise ModelError(f"its input is {shape}", path=path, accepted="a fixed square")
        return session

    @cached_property
    def _decoder_session(self) -> Any:
        path = self._decoder_file.path
        graph = _all_masks(_content(self._decoder_file), path)
        # One thread each: prompts run side by side, which is faster than sharing one prompt.
        return _session(graph, path, 1)

    def embed(self, rgb8: NDArray[np.uint8]) -> Embedding:
        """Run the image encoder on an (H, W, 3) uint8 picture.

        Raises:
            ModelError: for graphs that cannot be loaded.
        """
        from segment_anything.utils.transforms import ResizeLongestSide

        side = self.side
        resized = ResizeLongestSide(side).apply_image(rgb8).astype(np.float32)
        normal = (resized - np.array(MEAN, np.float32)) / np.array(STD, np.float32)
        square = np.zeros((1, 3, side, side), np.float32)
        square[0, :, : normal.shape[0], : normal.shape[1]] = normal.transpose(2, 0, 1)
        session = self._encoder
        features = session.run(None, {session.get_inputs()[0].name: square})[0]
        size = (rgb8.shape[0], rgb8.shape[1])
        return Embedding(features, size, input_size(size, side), features.nbytes)

    def decode_points(
        self, embedding: Embedding, points: NDArray[Any], labels: NDArray[np.int64]
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Masks for each of b prompts of p points; see :class:`PromptableSam`."""
        import torch

        scaled = input_coordinates(points, embedding).astype(np.float32)
        decoder = self._decoder

        def one(prompt: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
            coords = np.concatenate([scaled[prompt], np.zeros((1, 2), np.float32)])
            return _decode(decoder, embedding, coords, (*labels[prompt], PADDING))

        results = list(cpu_workers().map(one, range(len(scaled))))
        chosen = slice(1, None) if scaled.shape[1] == 1 else slice(0, 1)
        logits = np.concatenate([logits[:, chosen] for logits, _ in results])
        scores = np.concatenate([scores[:, chosen] for _, scores in results])
        return torch.from_numpy(logits), torch.from_numpy(scores)

    def decode_box(
        self, embedding: Embedding, box: NDArray[Any]
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """The mask that a box frames; see :class:`PromptableSam`."""
        import torch

        corners = input_coordinates(box.reshape(2, 2), embedding).astype(np.float32)
        logits, scores = _decode(self._decoder, embedding, corners, (BOX_FIRST, BOX_SECOND))
        return torch.from_numpy(logits[:, :1]), torch.from_numpy(scores[:, :1])


def _decode(
    session: Any, embedding: Embedding, coords: NDArray[np.float32], labels: tuple[int, ...]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Logits (1, 4, h, w) and predicted IoU (1, 4) of one prompt.

    The first mask is for clear prompts, the others for a single point.
    """
    given = {
        "image_embeddings": embedding.features,
        "point_coords": coords[None],
        "point_labels": np.array([labels], np.float32),
        "mask_input": np.zeros(session.get_inputs()[3].shape, np.float32),
        "has_mask_input": np.zeros(1, np.float32),
        "orig_im_size": np.array(embedding.picture_size, np.float32),
    }
    wanted = {node.name for node in session.get_inputs()}
    logits, scores = session.run(None, {k: v for k, v in given.items() if k in wanted})
    return logits, scores


def _content(weights: Checkpoint) -> bytes:
    """The bytes of a graph, which are those whose digest is in the name."""
    content = weights.path.read_bytes()
    found = hashlib.sha256(content).hexdigest()
    if found != weights.sha256:
        raise ModelError(f"sha256 is {found}", path=weights.path, accepted=weights.sha256)
    return content


def _session(graph: bytes, path: Path, threads: int) -> Any:
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads
    options.log_severity_level = 3
    try:
        return onnxruntime.InferenceSession(graph, options, ["CPUExecutionProvider"])
    except Exception as error:  # onnxruntime's errors have no common class
        raise ModelError(
            f"onnxruntime cannot load it: {' '.join(str(error).split())[:300]}", path=path
        ) from error


def _graph(content: bytes, path: Path) -> onnx.ModelProto:
    """A graph that is whole in itself: tensors in other files could lie anywhere."""
    import onnx

    try:
        model = onnx.load_model_from_string(content)
    except Exception as error:  # protobuf's errors have no common class
        raise ModelError(f"is no ONNX graph: {error}", path=path) from error
    for graph in _graphs(model.graph):
        if any(map(onnx.external_data_helper.uses_external_data, _tensors(graph))):
            raise ModelError(
                "keeps its weights in other files", path=path, accepted="a single file"
            )
        values = (*graph.input, *graph.output, *graph.initializer)
        names = [value.name for value in values]
        names += [name for node in graph.node for name in (*node.input, *node.output)]
        # Of bytes that are no UTF-8, the library makes bytes.
        if not all(isinstance(name, str) for name in names):
            raise ModelError("holds names that are no text", path=path, accepted="UTF-8")
    return model


def _graphs(graph: onnx.GraphProto) -> Iterator[onnx.GraphProto]:
    """A graph and those inside its nodes."""
    yield graph
    for attribute in (attribute for node in graph.node for attribute in node.attribute):
        for inner in (attribute.g, *attribute.graphs) if attribute.ByteSize() else ():
            if inner.ByteSize():
                yield from _graphs(inner)


def _tensors(graph: onnx.GraphProto) -> Iterator[onnx.TensorProto]:
    """The tensors that a graph itself holds."""
    yield from graph.initializer
    for sparse in graph.sparse_initializer:
        yield from (sparse.values, sparse.indices)
    for attribute in (attribute for node in graph.node for attribute in node.attribute):
        yield from (attribute.t, *attribute.tensors)


def _all_masks(content: bytes, path: Path) -> bytes:
    """The decoder up to all of its masks and predicted IoUs, as a graph with two outputs."""
    model = _graph(content, path)
    names = {node.name for node in model.graph.input}
    if not names.issuperset(DECODER_INPUTS) or len(model.graph.output) != 3:
        raise ModelError(
            f"takes {', '.join(sorted(names)) or 'nothing'}",
            path=path,
            accepted=f"a decoder that takes {', '.join(DECODER_INPUTS)} and gives masks, "
            "iou_predictions and low_res_masks",
        )
    makers = {output: node for node in model.graph.node for output in node.output}
    wanted = [_before_choice(makers, f, path) for f in ("low_res_masks", "iou_predictions")]
    graph: bytes = _cut(model, makers, wanted).SerializeToString()
    return graph


def _before_choice(makers: Mapping[str, onnx.NodeProto], output: str, path: Path) -> str:
    """The tensor that an output is chosen from: the last one that a matrix product made.

    Upwards along each node's first input there are reshapes, gathers and slices only. A bias
    that is added, or the shape that the product is brought into, still belongs to it.
    """
    name, belongs = output, output
    passed: set[str] = set()
    while name in makers and name not in passed:
        passed.add(name)
        node = makers[name]
        if node.op_type == "Gemm":
            return name
        if node.op_type == "MatMul":
            return belongs
        if not node.input:
            break
        name, belongs = node.input[0], name
    raise ModelError(f"has no matrix product above {output}", path=path)


def _cut(
    model: onnx.ModelProto, makers: Mapping[str, onnx.NodeProto], outputs: list[str]
) -> onnx.ModelProto:
    """The part of a graph that some of its tensors depend on."""
    import onnx

    needed, todo = set(outputs), list(outputs)
    while todo:
        node = makers.get(todo.pop())
        fresh = set(node.input) - needed if node else set()
        needed |= fresh
        todo += fresh
    graph = model.graph
    nodes = [node for node in graph.node if needed.intersection(node.output)]
    part = onnx.helper.make_graph(
        nodes,
        graph.name,
        [given for given in graph.input if given.name in needed],
        [onnx.ValueInfoProto(name=name) for name in outputs],
        [tensor for tensor in graph.initializer if tensor.name in needed],
    )
    cut = onnx.helper.make_model(part, opset_imports=model.opset_import)
    cut.ir_version = model.ir_version
    return cut
