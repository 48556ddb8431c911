"""What keeping the evidence costs: seconds beside the query time, and megabytes, as a table.

python benchmarks/evidence_cost.py [SCENES ...] [--queries N] [--into docs/report.md]

Grounds the first queries of scenes of the gallery with the onboard models, and times what the
evidence adds to that. In a store of its own, or in one that has the answers already (--store): a
query then counts with the time of its original computation.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path

from datasets.registry import get_dataset
from flows.scene_setup import make_job
from gvr_core.books import PatchBook, ViewBook
from gvr_core.methods import MethodConfig
from reports.document import replace_block
from reports.evidence import to_webp
from reports.sheet import Sheet, to_markdown
from tasks.evidence import gather_evidence
from tasks.groundings import unpack_virtual
from tasks.stages import run_stages
from tasks.store import Store


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scenes", nargs="*", default=["gallery_0"])
    parser.add_argument("--queries", type=int, default=4)
    parser.add_argument("--store", type=Path, help="a store to use instead of an empty one")
    parser.add_argument("--into", type=Path, help="document with a block evidence-cost")
    arguments = parser.parse_args()
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for scene in arguments.scenes:
            data = get_dataset("gallery", {}).load(scene)
            store = Store(arguments.store or Path(folder))
            job = make_job(data, MethodConfig(), store, limit=arguments.queries)
            rows.append((scene, *measured(job)))
    sheet = Sheet(
        "What the evidence costs",
        ("scene", "query s", "virtual views ms", "the rest ms", "share", "MB a scene"),
        tuple(rows),
        1,
        (
            "A query: seconds to locate and segment, and milliseconds that its evidence adds: "
            "small pictures of the virtual views, and the rest. MB: of all its "
            f"{arguments.queries} queries, and of the views that they share.",
        ),
    )
    text = to_markdown(sheet)
    print(text)
    if arguments.into is not None:
        replace_block(arguments.into, "evidence-cost", text)


def measured(job) -> tuple[str, ...]:
    """Of one scene: seconds of a query, milliseconds of its evidence, their share, megabytes."""
    runs = run_stages(job)
    n = len(job.queries)
    query = (runs["query"].record.seconds + runs["segment"].record.seconds) / n
    groundings = job.store.load_arrays(runs["segment"]["groundings"])
    places = job.store.load_json(runs["query"]["localizations"])
    views = ViewBook.from_arrays(job.store.load_arrays(runs["render"]["views"]))
    patches = PatchBook.from_arrays(job.store.load_arrays(runs["masks"]["patches"]))
    full = [
        job.tools.renderer.render(job.data.scene.gaussians, job.data.scene.views[0].camera).rgb
        for _ in unpack_virtual(groundings)
    ]
    start = time.perf_counter()
    for rgb in full:
        to_webp(rgb)
    virtual = (time.perf_counter() - start) / n
    times = []
    for _ in range(3):
        start = time.perf_counter()
        evidence = gather_evidence(
            job.data, job.queries, groundings, places, views, patches, job.tools.renderer
        )
        times.append((time.perf_counter() - start) / n)
    rest = min(times)
    size = len(evidence.model_dump_json()) / 1e6
    share = 100 * (virtual + rest) / query
    return (
        f"{query:.2f}",
        f"{1000 * virtual:.0f}",
        f"{1000 * rest:.0f}",
        f"{share:.1f} %",
        f"{size:.2f}",
    )


if __name__ == "__main__":
    main()
