"""The comparison of two runs as JSON values."""

from __future__ import annotations

from typing import Any

from reports.bootstrap import Estimate
from reports.run_comparison import RunComparison


def as_json(comparison: RunComparison, fail_if_drop: float | None = None) -> dict[str, Any]:
    """A comparison as JSON values; numbers in their own units, ``drop`` in points."""

    def estimate(found: Estimate) -> dict[str, Any]:
        return {
            "value": found.value,
            "low": found.low,
            "high": found.high,
            "n_scenes": found.n_scenes,
        }

    return {
        "a": comparison.a.run_id,
        "b": comparison.b.run_id,
        "numbers": [
            {
                "dataset": n.dataset,
                "method": n.method,
                "protocol": n.column.protocol,
                "metric": n.column.metric,
                "title": n.column.title,
                "a": n.a,
                "b": n.b,
                "drop": n.drop,
                "difference": estimate(n.difference.estimate),
                "n_pairs": n.difference.n_pairs,
                "better": n.sign.n_better,
                "worse": n.sign.n_worse,
                "same": n.sign.n_same,
                "sign_test_p": n.sign.p,
            }
            for n in comparison.numbers
        ],
        "queries": [
            {
                "dataset": q.dataset,
                "scene": q.scene,
                "method": q.method,
                "query": q.query,
                "text": q.text,
                "values": [
                    {"protocol": c.protocol, "metric": c.metric, "a": x, "b": y}
                    for c, x, y in q.values
                ],
            }
            for q in comparison.queries
        ],
        "left_out": list(comparison.left_out),
        "notes": list(comparison.notes),
        "fail_if_drop": fail_if_drop,
        "dropped": None
        if fail_if_drop is None
        else [
            {"dataset": n.dataset, "method": n.method, "title": n.column.title, "drop": n.drop}
            for n in comparison.dropped(fail_if_drop)
        ],
    }
