"""What each command's help teaches besides its options: examples, and what comes next.

The tests parse every example, and look for every command in docs/command_line.md.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

FIRST, RUN, RESULTS, HERE = "Start here", "Run", "Results", "What is here"
"""Panels of ``gvr --help``."""


@dataclass(frozen=True)
class Lesson:
    """What the help of one command adds to its options."""

    examples: tuple[str, ...]
    next: str
    """What one does after it."""
    panel: str | None = None
    """Where ``gvr --help`` lists it; None for commands of a group."""


LESSONS = {
    "init": Lesson(
        ("gvr init my_scenes", 'gvr init my_scenes --query "a red cup" --out cups.toml'),
        "edit the file, then gvr run FILE.",
        FIRST,
    ),
    "doctor": Lesson(("gvr doctor", "gvr doctor --json"), "gvr run bench.", FIRST),
    "run": Lesson(
        (
            "gvr run bench",
            "gvr run bench --method gvr-paper --scene gallery_0 --limit 3",
            "gvr run my_scenes.toml --dry-run",
        ),
        "gvr report, or gvr compare with an earlier result.",
        FIRST,
    ),
    "ground": Lesson(
        (
            'gvr ground chair.ply --cameras cameras.json --query "a chair"',
            'gvr ground chair.ply --cameras scene --query "a chair" --export without',
        ),
        "gvr view SPLAT --cameras CAMERAS, to ask more of the scene.",
        RUN,
    ),
    "view": Lesson(
        ("gvr view gallery/gallery_0", "gvr view chair.ply --cameras cameras.json"),
        "open the address that it prints.",
        RUN,
    ),
    "schedule": Lesson(
        ('gvr schedule bench --cron "0 2 * * *"', "gvr schedule bench --interval 6h"),
        "gvr ls, when a run has ended.",
        RUN,
    ),
    "ls": Lesson(("gvr ls", "gvr ls --json"), "gvr show RESULT.", RESULTS),
    "show": Lesson(
        ("gvr show", "gvr show --markdown", "gvr show --sheet pictures.png"),
        "gvr report, for the evidence behind the numbers.",
        RESULTS,
    ),
    "report": Lesson(
        ("gvr report", "gvr report --out report.html --max-mb 10"),
        "open the file in a browser.",
        RESULTS,
    ),
    "compare": Lesson(
        (
            "gvr compare 20260101T000000Z-00000a 20260102T000000Z-00000b",
            "gvr compare before after --fail-if-drop 1.0 --html compared.html",
        ),
        "gvr report, for the evidence behind one of the two.",
        RESULTS,
    ),
    "score": Lesson(
        ("gvr score --protocol lerf_ovs.opengaussian_3d",),
        "gvr show, for the new result's tables.",
        RESULTS,
    ),
    "sync": Lesson(
        ("gvr sync", "gvr sync --tracking-uri http://127.0.0.1:5000"), "gvr ui.", RESULTS
    ),
    "ui": Lesson(("gvr ui", "gvr ui --port 0"), "open the address that it prints.", RESULTS),
    "cache": Lesson(("gvr cache ls",), "gvr cache COMMAND --help.", HERE),
    "cache ls": Lesson(("gvr cache ls", "gvr cache ls --stage masks"), "gvr cache verify."),
    "cache verify": Lesson(
        ("gvr cache verify", "gvr cache verify --remote"),
        "gvr run: what is damaged is computed again, and nothing else.",
    ),
    "cache push": Lesson(
        ("gvr cache push --store s3://bucket/store",), "gvr cache ls, which shows both tiers."
    ),
    "cache gc": Lesson(
        ("gvr cache gc --dry-run", "gvr cache gc --keep-days 30"),
        "gvr cache ls.",
    ),
    "models": Lesson(("gvr models ls",), "gvr models COMMAND --help.", HERE),
    "models ls": Lesson(("gvr models ls", "gvr models ls --json"), "gvr models fetch NAME."),
    "models fetch": Lesson(
        ("gvr models fetch sam:vit_b", "gvr models fetch --all --quiet"),
        "gvr run SUITE --models paper, or a suite of your own.",
    ),
    "models verify": Lesson(
        ("gvr models verify", "gvr models verify sam:vit_b"),
        "gvr models fetch NAME, for one that is wrong.",
    ),
    "datasets": Lesson(("gvr datasets ls",), "gvr datasets COMMAND --help.", HERE),
    "datasets ls": Lesson(
        ("gvr datasets ls", "gvr datasets ls --json"), "gvr datasets check FOLDER."
    ),
    "datasets where": Lesson(
        ("gvr datasets where",), "set the variables that are not, then gvr datasets ls."
    ),
    "datasets check": Lesson(
        (
            "gvr datasets check lerf_ovs",
            "gvr datasets check garden --as capture --splat garden.ply",
        ),
        "gvr init FOLDER, for a suite over it.",
    ),
    "datasets export": Lesson(
        ("gvr datasets export composite crowded --layout lerf_mask --out exported",),
        "GVR_DATASETS=exported gvr run lerf_mask --models onboard.",
    ),
}
"""Command -> its lesson, in the order of ``gvr --help``."""


def taught(command: str) -> dict[str, Any]:
    """What Typer is told of a command besides its function.

    Args:
        command: A key of :data:`LESSONS`.
    """
    lesson = LESSONS[command]
    head = "Examples:" if len(lesson.examples) > 1 else "Example:"
    # Typer makes a line of each paragraph.
    paragraphs = [head, *(f"$ {example}" for example in lesson.examples), f"Next: {lesson.next}"]
    told: dict[str, Any] = {"epilog": "\n\n".join(paragraphs)}
    if lesson.panel is not None:
        told["rich_help_panel"] = lesson.panel
    return told
