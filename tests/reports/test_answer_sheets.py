"""Answers on scenes whose truth nobody knows: shown, not scored."""

from __future__ import annotations

import io

from record_samples import Sample, scene_result
from rich.console import Console

from reports import tables
from reports.record import Result
from reports.sheet import TERMINAL_WIDTH


def unscored(sample: Sample, **fields: object) -> Result:
    result, _, _ = sample
    scene = scene_result("shed", "gvr-paper", ["cup", "unicorn"], dataset="captures:mine", **fields)
    named = tuple(q.model_copy(update={"text": f"the {q.query}"}) for q in scene.queries)
    return result.model_copy(update={"scenes": (scene.model_copy(update={"queries": named}),)})


def overview(result: Result, rows: list) -> str:
    file = io.StringIO()
    Console(file=file, width=TERMINAL_WIDTH, color_system=None).print(tables.overview(result, rows))
    return file.getvalue()


def test_answers_stand_where_scores_would(sample: Sample) -> None:
    text = overview(unscored(sample), [])
    assert "captures:mine: what was answered" in text
    (cup,) = [line.split() for line in text.splitlines() if "the cup" in line]
    assert cup == ["gvr-paper", "shed", "the", "cup", "yes", "40", "0.1", "0.2", "0.3"]
    (unicorn,) = [line.split() for line in text.splitlines() if "the unicorn" in line]
    assert unicorn[-3:] == ["no", "0", "–"]
    assert "mIoU" not in text
    markdown = tables.readme_block(unscored(sample), [])
    assert "| the cup | yes | 40 | 0.1 0.2 0.3 |" in markdown


def test_scored_data_sets_keep_their_table_beside_it(sample: Sample) -> None:
    result, rows, _ = sample
    both = result.model_copy(update={"scenes": (*result.scenes, *unscored(sample).scenes)})
    text = overview(both, rows)
    assert "rooms: localisation accuracy" in text and "captures:mine: what was answered" in text
    assert "captures:mine: localisation accuracy" not in text


def test_lines_are_not_compared_without_scores(sample: Sample) -> None:
    text = overview(unscored(sample, reference="gvr-paper"), [])
    assert "difference" not in text
