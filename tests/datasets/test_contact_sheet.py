from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from native_scene import written

from datasets.contact_sheet import LABEL, contact_sheet, main, write_sheet
from datasets.images import read_image


def flat(colour: tuple[int, int, int]) -> np.ndarray:
    return np.full((30, 40, 3), colour, np.uint8)


def test_tiles_lie_in_rows_under_their_labels(tmp_path: Path) -> None:
    tiles = [("a", flat((255, 0, 0))), ("b", flat((0, 255, 0))), ("c", flat((0, 0, 255)))]
    sheet = contact_sheet(tiles, columns=2, width=80)
    assert sheet.shape == (2 * (60 + LABEL), 160, 3)
    assert tuple(sheet[LABEL + 30, 40]) == (255, 0, 0)
    assert tuple(sheet[LABEL + 30, 120]) == (0, 255, 0)
    assert tuple(sheet[2 * LABEL + 90, 40]) == (0, 0, 255)
    assert tuple(sheet[2 * LABEL + 90, 120]) == (255, 255, 255)
    assert sheet[:LABEL, :80].min() < 100
    write_sheet(tmp_path / "sheet.png", sheet)
    # a palette may be a shade off
    assert np.abs(read_image(tmp_path / "sheet.png").astype(int) - sheet).max() < 8


def test_the_command_shows_scenes_and_views(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("one", "two"):
        written(tmp_path / "scenes" / name)
    folder = f"folder:{tmp_path / 'scenes'}"
    assert main([folder, str(tmp_path / "all.png"), "--width", "48"]) == 0
    height = read_image(tmp_path / "all.png").shape[0]
    views = len(list((tmp_path / "scenes/one/images").iterdir()))
    arguments = [folder, str(tmp_path / "one.png"), "--scene", "one", "--columns", "1"]
    assert main([*arguments, "--width", "48"]) == 0
    assert read_image(tmp_path / "one.png").shape == (views * height, 48, 3)
    assert main([folder, str(tmp_path / "no.png"), "--scene", "three"]) == 1
    assert "accepted: one, two" in capsys.readouterr().err
    assert not (tmp_path / "no.png").exists()
