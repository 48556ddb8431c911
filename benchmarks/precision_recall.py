"""Whether a result flags too much or too little: ``python benchmarks/precision_recall.py RESULT``.

Prints, for each line of a result's folder, the mean precision and recall of its flags over all
queries for things that are there.
"""

from __future__ import annotations

import sys
from pathlib import Path

from gvr_core.metrics import FLAGS_3D
from reports.result_io import read_result


def main() -> None:
    """Print a line of figures for each line of the result."""
    _, rows = read_result(Path(sys.argv[1]))
    scored = [row for row in rows if row.protocol == FLAGS_3D]
    for line in dict.fromkeys(row.method for row in scored):
        own = [row.metrics for row in scored if row.method == line]
        precision, recall = (sum(m[k] for m in own) / len(own) for k in ("precision", "recall"))
        print(f"{line}: precision {precision:.2f}, recall {recall:.2f} of {len(own)} queries")


if __name__ == "__main__":
    main()
