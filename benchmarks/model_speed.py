"""How fast the full-strength models prepare a view: ``python benchmarks/model_speed.py``.

Times, for each view, SAM's automatic masks at LangSplat's settings and the encoding of patches
with open_clip. Where the published checkpoints are in the models folder, they are used; else
networks of the same size at random weights, which take the same time for each step, saved as
checkpoints and loaded by the same code. What random masks are like says nothing, so patches for
the encoder are boxes drawn at random, as many for each view as ``--patches`` says.

Without a GPU it prints that nothing was measured, and exits; ``--device cpu`` measures anyway.
"""

from __future__ import annotations

import argparse
import statistics
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
from photograph_frames import photograph_frame
from rich.console import Console
from skimage import data
from skimage.transform import resize

from gvr_core.errors import ModelError
from gvr_core.models.base import Encoder, Frame, Mask, Segmenter
from gvr_core.models.devices import DeviceChoice, pick_device
from gvr_core.models.full_strength import open_clip, sam
from gvr_core.models.open_clip_encoder import OpenClipSettings
from gvr_core.models.sam_prompts import SamSettings
from gvr_core.paper import PREPARATION_SECONDS
from reports.document import replace_block
from reports.environment import describe_environment

BLOCK = "model-speed"
"""Name of the block of the page that ``--into`` rewrites."""
WIDTH, HEIGHT = 988, 731
"""Pictures of LERF-OVS, pixels."""


def a_photograph() -> Frame:
    """A photograph at the size of LERF-OVS's pictures."""
    rgb = resize(data.coffee(), (HEIGHT, WIDTH), anti_aliasing=True)
    return photograph_frame(np.rint(rgb * 255).astype(np.uint8))


def random_patches(count: int) -> list[Mask]:
    """Boxes of all sizes, anywhere."""
    rng, masks = np.random.default_rng(0), []
    for _ in range(count):
        x, y = np.sort(rng.integers(0, WIDTH, 2)), np.sort(rng.integers(0, HEIGHT, 2))
        pixels = np.zeros((HEIGHT, WIDTH), np.bool_)
        pixels[y[0] : y[1] + 1, x[0] : x[1] + 1] = True
        masks.append(Mask(pixels))
    return masks


def random_sam(variant: str, folder: Path) -> Path:
    """A SAM of a published size at random weights, as a checkpoint."""
    from segment_anything import sam_model_registry

    path = folder / f"{variant}.pth"
    torch.manual_seed(0)
    torch.save(sam_model_registry[variant]().state_dict(), path)
    return path


def random_clip(model: str, folder: Path) -> Path:
    """An open_clip model at random weights, as a checkpoint."""
    import open_clip as library

    path = folder / f"{model}.pt"
    torch.manual_seed(0)
    torch.save(library.create_model(model, pretrained=None).state_dict(), path)
    return path


def the_segmenter(
    variant: str, settings: SamSettings, device: DeviceChoice, folder: Path
) -> tuple[Segmenter, str]:
    """SAM, and what its weights are."""
    try:
        return sam(variant, settings, device), "published"
    except ModelError:
        return sam(str(random_sam(variant, folder)), settings, device), "random"


def the_encoder(which: str, device: DeviceChoice, folder: Path) -> tuple[Encoder, str]:
    """An open_clip model, and what its weights are."""
    try:
        return open_clip(which, OpenClipSettings(), device), "published"
    except ModelError:
        path = random_clip(which.partition("/")[0], folder)
        return open_clip(which, OpenClipSettings(checkpoint=path), device), "random"


def seconds(function: Callable[[], object], repeats: int) -> tuple[float, float, float]:
    """Median, least and most seconds, after one run that does not count."""
    function()
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        function()
        times.append(time.perf_counter() - start)
    return statistics.median(times), min(times), max(times)


def measure(arguments: argparse.Namespace) -> str:
    """Both models, as the Markdown of the page."""
    device = pick_device(arguments.device)
    environment = describe_environment()
    card = environment.gpu if device.type == "cuda" else None
    where = card or f"{environment.cpu_count} x {environment.processor}, no GPU used"
    frame, patches = a_photograph(), random_patches(arguments.patches)
    settings = SamSettings(points_per_side=arguments.points, crop_layers=arguments.crop_layers)
    with tempfile.TemporaryDirectory() as folder:
        segmenter, sam_weights = the_segmenter(
            arguments.sam, settings, arguments.device, Path(folder)
        )
        masks = seconds(lambda: segmenter.automatic(frame), arguments.views)
        encoder, clip_weights = the_encoder(arguments.clip, arguments.device, Path(folder))
        encoding = seconds(lambda: encoder.encode_patches(frame, patches), arguments.views)
    grid = f"{settings.points_per_side} points a side, {settings.crop_layers} crop layers"
    lines = [
        f"{where}; a picture of {WIDTH}x{HEIGHT}; "
        f"median (least to most) of {arguments.views} runs.",
        "",
        "| step | model | weights | what | seconds a view |",
        "| :--- | :--- | :--- | :--- | ---: |",
        f"| masks | SAM {arguments.sam} | {sam_weights} | {grid} | {_spread(masks)} |",
        f"| encoding | {arguments.clip} | {clip_weights} | {arguments.patches} patches "
        f"| {_spread(encoding)} |",
        "",
        f"Together {masks[0] + encoding[0]:.2f} s a view, so {PREPARATION_SECONDS:g} s, the "
        "paper's preparation of a scene on one RTX 4090 (views not stated), would do for "
        f"{PREPARATION_SECONDS / (masks[0] + encoding[0]):.0f} views.",
    ]
    return "\n".join(lines)


def _spread(times: tuple[float, float, float]) -> str:
    return f"{times[0]:.2f} ({times[1]:.2f} to {times[2]:.2f})"


def main() -> None:
    """Measure, print, and put the table into a page."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--device", choices=("auto", "cpu", "cuda"), default="auto")
    parser.add_argument("--sam", default="vit_h", help="vit_h, vit_l or vit_b")
    parser.add_argument("--clip", default="ViT-B-16/laion2b_s34b_b88k", help="MODEL/TAG")
    parser.add_argument("--views", type=int, default=5, help="runs measured, after one that is not")
    parser.add_argument("--points", type=int, default=32, help="of the grid, a side")
    parser.add_argument("--crop-layers", type=int, default=1)
    parser.add_argument("--patches", type=int, default=100, help="encoded a view")
    parser.add_argument("--into", type=Path, help=f"page with a block <!-- {BLOCK} -->")
    arguments = parser.parse_args()
    if arguments.device == "auto" and pick_device().type == "cpu":
        text = "Not measured: there was no GPU at hand."
    else:
        text = measure(arguments)
    Console(soft_wrap=True).print(text, markup=False, highlight=False)
    if arguments.into is not None:
        replace_block(arguments.into, BLOCK, text)


if __name__ == "__main__":
    main()
