"""What a run says of its cache: computed, cached, fetched, and found damaged."""

from __future__ import annotations

import io

from record_samples import make_sample, scene_result
from rich.console import Console

from reports.cost_sheets import cache_sheets, stage_sheets
from reports.record import Damage, StageTiming
from reports.tables import overview

LOST = Damage(what="artifact", where="local", path="objects/ab/abc", finding="is missing")
TORN = Damage(
    what="record", where="shared", path="records/masks/k1.json", finding="is not a stage record"
)


def timing(stage: str, **fields: object) -> StageTiming:
    cost = {"seconds": 1.0, "cpu_seconds": 1.0, "peak_bytes": 1, "key": "k"}
    return StageTiming.model_validate(cost | {"stage": stage, "state": "cached"} | fields)


def test_damage_is_counted_for_the_run_and_for_each_scene() -> None:
    result, _, _ = make_sample()
    stages = (
        timing("render", fetched=True),
        timing("masks", state="computed", damage=(LOST, TORN)),
        timing("encode", damage=(LOST,), fetched=True),
        timing("query", state="computed", unshared="no route"),
    )
    scenes = (
        scene_result("kitchen", "gvr-paper", [], stages=stages),
        scene_result("kitchen", "lift", [], stages=stages[1:2]),  # the same file once more
        scene_result("garden", "gvr-paper", [], stages=(timing("render"),)),
    )
    result = result.model_copy(update={"scenes": scenes})
    (sheet,) = cache_sheets(result)
    assert sheet.rows == (
        ("all", "all", "3", "3", "2", "1", "1", "2", "1"),
        ("gvr-paper", "rooms / kitchen", "2", "2", "2", "1", "1", "1", "1"),
        ("lift", "rooms / kitchen", "1", "0", "0", "1", "1", "1", "0"),
    )
    assert sheet.notes == (
        "Found damaged or unreadable: 1 artifacts and 1 records; 2 stages computed again for it.",
        "local objects/ab/abc is missing",
        "shared records/masks/k1.json is not a stage record",
        "1 stages without the shared store: no route",
    )
    states = [row[1] for row in stage_sheets(result)[0].rows]
    assert states == ["fetched", "recomputed (damaged)", "fetched again (damaged)", "computed"]
    console = Console(file=io.StringIO(), width=100)
    console.print(overview(result, []))
    assert "Found damaged or unreadable: 1 artifacts and 1 records" in console.file.getvalue()


def test_a_result_of_an_earlier_version_says_nothing_was_damaged() -> None:
    result, _, _ = make_sample()
    saved = result.model_dump(mode="json")
    for scene in saved["scenes"]:
        for stage in scene["stages"]:
            for name in ("damage", "fetched", "unshared"):
                del stage[name]
    older = type(result).model_validate(saved)
    assert older == result
    (sheet,) = cache_sheets(older)
    assert sheet.rows == (("all", "all", "3", "3", "0", "0", "0", "0", "0"),)
    assert cache_sheets(result.model_copy(update={"scenes": ()})) == []
