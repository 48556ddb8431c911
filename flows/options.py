"""Options that several commands have."""

from __future__ import annotations

from typing import Annotated

import typer

from flows import completion

JsonOption = Annotated[
    bool, typer.Option("--json", help="One JSON document on standard output, for scripts.")
]
StoreOption = Annotated[
    str | None,
    typer.Option(
        "--store", help="Artifact store, a folder or a shared URL; GVR_STORE, else .gvr/store."
    ),
]
ResultsOption = Annotated[
    str | None,
    typer.Option(help="Results, a folder or a shared URL; GVR_RESULTS, else .gvr/results."),
]
TrackingOption = Annotated[
    str | None,
    typer.Option(help="MLflow to fill; MLFLOW_TRACKING_URI, else the project's own store."),
]
NoMlflowOption = Annotated[bool, typer.Option("--no-mlflow", help="Leave MLflow out.")]
QuietOption = Annotated[bool, typer.Option("--quiet", "-q", help="No progress bars.")]
SuiteArgument = Annotated[
    str,
    typer.Argument(
        help="A bundled suite (bench, composite, ablation, stress; lerf_ovs, lerf_mask, ovs3d, "
        "which need their data) or a .toml file.",
        autocompletion=completion.suites,
    ),
]
RunnerOption = Annotated[
    str | None,
    typer.Option(
        help="serial, threads, processes or dask; else the suite's.",
        autocompletion=completion.runners,
    ),
]
WorkersOption = Annotated[int | None, typer.Option(help="How many, instead of the suite's.")]
ResultArgument = Annotated[
    str,
    typer.Argument(
        help="A result's folder or its id; the newest where left out.",
        autocompletion=completion.results,
    ),
]
ModelsOption = Annotated[
    str,
    typer.Option(
        help="onboard, mobile-sam or paper: see `gvr models ls`.",
        autocompletion=completion.model_sets,
    ),
]
ExposedOption = Annotated[
    bool,
    typer.Option("--exposed", help="Let --host be an address that other machines reach."),
]
HostOption = Annotated[str, typer.Option(help="Address to listen at.")]
