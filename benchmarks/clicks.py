"""How well a SAM cuts out what is clicked on: ``python benchmarks/clicks.py FOLDER``.

FOLDER holds ``encoder.onnx`` and the decoder, here or under GVR_MODELS. The photographs are
scikit-image's, the outlines were drawn by hand on them (``tests/data/outlines``), and the clicks
were chosen before any model was asked.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.console import Console

from gvr_core.models.base import Mask
from gvr_core.models.full_strength import onnx_folder
from gvr_core.models.sam_onnx import OnnxSam
from gvr_core.models.sam_prompts import SparseSamSettings
from gvr_core.models.sam_segmenter import SamSegmenter
from reports.document import replace_block

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests"))
from outlines import photograph, read_outlines
from photograph_frames import photograph_frame

BLOCK = "clicks"
"""Name of the block of the page that ``--into`` rewrites."""


def table(folder: Path) -> str:
    """IoU with each outline, as Markdown."""
    segmenter = SamSegmenter(OnnxSam(*OnnxSam.files(folder)), SparseSamSettings())
    lines = [
        "| thing | click | chosen mask | best of its three | box |",
        "| :--- | :--- | ---: | ---: | ---: |",
    ]
    for outline in read_outlines():
        frame, truth = photograph_frame(photograph(outline)), outline.mask

        def iou(mask: Mask, truth: NDArray[np.bool_] = truth) -> float:
            return float((mask.pixels & truth).sum() / (mask.pixels | truth).sum())

        chosen = iou(segmenter.at_point(frame, outline.point))
        best = max(iou(mask) for mask in segmenter.masks_at(frame, outline.point))
        box = iou(segmenter.in_box(frame, Mask(truth).box))
        x, y = outline.point
        lines.append(f"| {outline.thing} | {x:g}, {y:g} | {chosen:.2f} | {best:.2f} | {box:.2f} |")
    return "\n".join(lines)


def main() -> None:
    """Measure, print, and put the table into a page."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", help="folder of the two graphs, e.g. mobile_sam")
    parser.add_argument("--into", type=Path, help=f"page with a block <!-- {BLOCK} -->")
    arguments = parser.parse_args()
    text = table(onnx_folder(arguments.folder))
    Console(soft_wrap=True).print(text, markup=False, highlight=False)
    if arguments.into is not None:
        replace_block(arguments.into, BLOCK, text)


if __name__ == "__main__":
    main()
