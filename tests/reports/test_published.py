from __future__ import annotations

import re
import tomllib
from importlib import resources
from pathlib import Path
from statistics import fmean

import pytest

from gvr_core.errors import ConfigError
from gvr_core.protocols import PROTOCOLS
from reports.published import families, families_of, published, read_published

FILE = Path(str(resources.files("reports") / "published.toml"))

SMALL = """
[[families]]
id = "ovs3d.masks"
about = "masks"
dataset = "ovs3d"
beside = ["ovs3d.binary"]
metrics = ["iou"]
scenes = ["bed", "sofa"]
reported_protocol = "not stated"

[[families.rows]]
method = "A"
scenes.bed = { iou = 60.0 }
scenes.sofa = { iou = 70.0 }
overall = { iou = 65.0 }
source = "a paper"

[[families.rows]]
method = "B"
overall = { iou = 5.0 }
source = "a paper"
"""


@pytest.fixture
def small(tmp_path: Path) -> Path:
    path = tmp_path / "published.toml"
    path.write_text(SMALL)
    return path


def broken(path: Path, old: str, new: str) -> ConfigError:
    assert old in SMALL
    path.write_text(SMALL.replace(old, new))
    with pytest.raises(ConfigError) as caught:
        read_published(path)
    assert caught.value.path == str(path)
    return caught.value


def test_every_overall_is_the_mean_of_its_scenes_or_says_why_not() -> None:
    checked = odd = 0
    for family in tomllib.loads(FILE.read_text())["families"]:
        for row in family["rows"]:
            for metric, printed in row.get("overall", {}).items():
                values = [v[metric] for v in row.get("scenes", {}).values() if metric in v]
                mean = fmean(values) if values else row.get("recomputed", {}).get(metric)
                if mean is None:
                    continue
                checked += 1
                if abs(mean - printed) > 0.06:
                    odd += 1
                    assert f"{mean:.1f}" in row["note"], (family["id"], row["method"], metric)
    assert (checked, odd) == (62, 8)


def test_the_paper_itself() -> None:
    (row,) = [
        row for row in published("lerf_ovs", "lerf_ovs.langsplat_2d/1") if row.method == "GVR"
    ]
    assert row.overall == {"acc": 87.5, "iou": 56.2}
    assert row.scenes["waldo_kitchen"] == {"acc": 95.8, "iou": 50.1}
    assert (row.prepare_seconds, row.query_seconds) == (37.0, 0.25)
    assert row.training_free and row.first_hand
    # Nobody outside knows what its Acc is, so it is no number of any protocol here.
    assert row.protocol is None
    (rooms,) = [row for row in published("ovs3d") if row.method == "GVR"]
    assert rooms.overall == {"iou": 95.4}
    assert not [row for row in published("lerf_mask") if "GVR" in row.method]


def test_the_arithmetic_slips_stand_as_printed_and_as_recomputed() -> None:
    (row,) = [row for row in published("lerf_ovs") if row.relative_to]
    assert (row.method, row.relative_to) == ("GVR w/o RFL & SMFI", "GVR")
    assert row.overall == {"acc": -26.6, "iou": -18.2}
    assert row.recomputed == {"acc": -27.1, "iou": -28.2}
    assert (row.true_overall("acc"), row.true_overall("iou")) == (-27.1, -28.2)


def test_only_the_papers_own_rows_are_first_hand() -> None:
    first_hand = {(f.id, row.method) for f in families() for row in f.rows if row.first_hand}
    assert first_hand == {
        ("lerf_ovs.rendered_2d", "GVR"),
        ("lerf_ovs.rendered_2d", "GVR w/o RFL & SMFI"),
        ("ovs3d.masks", "GVR"),
    }


def test_families_stand_beside_protocols_that_exist_and_share_their_metrics() -> None:
    for family in families():
        specs = [spec for spec in PROTOCOLS.values() if family.stands_beside(spec.id)]
        assert {spec.id.partition("/")[0] for spec in specs} == set(family.beside)
        for spec in specs:
            assert set(family.metrics) <= {metric for metric, _ in spec.headline}


def test_one_method_has_other_numbers_in_another_family() -> None:
    def langsplat(protocol: str) -> float:
        return next(r for r in published("lerf_ovs", protocol) if r.method == "LangSplat").overall[
            "iou"
        ]

    assert langsplat("lerf_ovs.langsplat_2d/1") == 51.4
    assert langsplat("lerf_ovs.opengaussian_3d/1") == 9.66
    # A newer version of a protocol still has the family beside it, if not under it.
    assert langsplat("lerf_ovs.langsplat_2d/7") == 51.4


def test_data_sets_without_published_numbers_have_none() -> None:
    assert published("gallery") == ()
    assert published("lerf_ovs", "gvr.in_scene_2d/1") == ()
    assert families_of("composite") == ()


COLUMNS = {
    "2.1": ("lerf_ovs.rendered_2d", ("iou", "acc"), "figurines teatime ramen waldo_kitchen", 1),
    "2.2": (
        "lerf_ovs.selection_3d",
        ("iou", "acc_at_0.25"),
        "figurines teatime ramen waldo_kitchen",
        1,
    ),
    "2.3": ("lerf_mask.masks", ("iou", "boundary_iou"), "figurines ramen teatime", 1),
    "2.4": ("ovs3d.masks", ("iou",), "bed bench room sofa lawn", 6),
}
"""Section of the collected protocols -> family, order of metrics, scenes, column of the mean."""

ROW = re.compile(r"^\| (?!Method|---)(.+) \|$", re.MULTILINE)


def cell(text: str, metrics: tuple[str, ...]) -> dict[str, float]:
    """``38.6/75.0`` -> values; remarks behind a number are passed over."""
    numbers = re.match(r"^(\d+\.\d+|-)?(?:/(\d+\.\d+|-))?", text.replace("*", "").strip())
    assert numbers is not None
    pairs = zip(metrics, numbers.groups(), strict=False)
    return {metric: float(value) for metric, value in pairs if value not in (None, "-")}


@pytest.mark.parametrize("section", COLUMNS)
def test_against_the_collection_that_it_was_taken_from(shared: Path, section: str) -> None:
    family_id, metrics, names, at_mean = COLUMNS[section]
    scenes = names.split()
    (family,) = [family for family in families() if family.id == family_id]
    rows = {row.method: row for row in family.rows}
    text = (shared / "protocols.md").read_text(encoding="utf-8")
    block = text.split(f"### {section} ")[1].split("\n#")[0]
    found = 0
    for line in ROW.findall(block):
        cells = [each.strip() for each in line.split("|")]
        method = re.sub(r" \((paper|third-party run|SAM)\)|\*", "", cells[0])
        method = {"Gaga": "Gaga (SAM)"}.get(method, method)
        if section == "2.3" and method == "THGS":
            method = "THGS (by others)"
        if "DP/GLR" in method:
            method = "DP/GLR"
        if method == "ILGS":  # one scene alone, in words
            assert rows[method].scenes == {"teatime": {"iou": 81.2}}
            assert "81.2 (teatime) claimed; user 63.3" in line
            continue
        row = rows[method]
        assert row.overall == cell(cells[at_mean], metrics), method
        first = 1 if at_mean != 1 else 2
        for scene, said in zip(scenes, cells[first : first + len(scenes)], strict=True):
            assert row.scenes.get(scene, {}) == cell(said, metrics), (method, scene)
        found += 1
    assert found == {"2.1": 15, "2.2": 18, "2.3": 7, "2.4": 12}[section]


def test_a_small_file(small: Path) -> None:
    (family,) = read_published(small)
    first, second = family.rows
    assert (first.family, first.dataset) == ("ovs3d.masks", "ovs3d")
    assert first.reported_protocol == "not stated"
    assert first.mean_of_scenes("iou") == 65.0
    assert first.true_overall("iou") is None
    assert second.mean_of_scenes("iou") is None
    assert not (first.first_hand or second.first_hand)


def test_a_wrong_overall_needs_a_note_with_the_mean(small: Path) -> None:
    error = broken(small, "overall = { iou = 65.0 }", "overall = { iou = 75.0 }")
    assert error.place is not None and error.place.startswith("families.0.rows.0")
    assert "65.0" in error.message
    error = broken(small, "{ iou = 65.0 }", '{ iou = 75.0 }\nnote = "from a table"')
    assert "65.0" in error.message
    small.write_text(SMALL.replace("{ iou = 65.0 }", '{ iou = 75.0 }\nnote = "the mean is 65.0"'))
    (family,) = read_published(small)
    assert family.rows[0].true_overall("iou") == 65.0


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("scenes.sofa = {", "scenes.lawn = {", "lawn"),
        ("iou = 5.0", "acc = 5.0", "acc"),
        ('method = "B"', 'method = "A"', "twice"),
        ('method = "B"', 'method = "B"\nrelative_to = "C"', "C"),
        ('method = "B"', 'method = "B"\nprotocol = "ovs3d.binary/99"', "ovs3d.binary/99"),
        ("overall = { iou = 5.0 }", "", "no numbers"),
        ('source = "a paper"', "", "required"),
        ("iou = 5.0", 'iou = "five"', "number"),
        ("iou = 5.0", "iou = nan", "finite"),
        ('method = "B"', 'method = "B"\nseconds = 3', "not permitted"),
        ('method = "B"', 'method = "B"\nquery_seconds = 0', "greater than 0"),
        ('dataset = "ovs3d"', 'dataset = "gallery"', "lerf_ovs"),
        ("[[families]]", "[[family]]", "no families"),
        ("[[families]]", "[[families", "cannot be read"),
        ("[[families.rows]]", "[families.rows]", "cannot be read"),
    ],
)
def test_broken_files(small: Path, old: str, new: str, says: str) -> None:
    assert says in broken(small, old, new).message


def test_rows_that_are_none(small: Path) -> None:
    small.write_text(SMALL.split("[[families.rows]]")[0] + "rows = [3]\n")
    with pytest.raises(ConfigError, match=r"rows\.0"):
        read_published(small)
    with pytest.raises(ConfigError, match="cannot be read"):
        read_published(small.with_name("nothing.toml"))
