"""A suite over scenes of one's own, as a file with comments that is ready to be edited."""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Sequence
from pathlib import Path

from jinja2 import Environment, PackageLoader, StrictUndefined

from datasets.own import own_queries
from datasets.recognise import CAPTURE
from flows.lines import BUNDLED, bundled_models
from flows.own_scenes import FoundData
from flows.suite import SuiteConfig, resolve_scenes
from gvr_core.atomic import atomic_write
from gvr_core.errors import ConfigError, unknown_name
from gvr_core.method_names import METHODS
from gvr_core.models.registry import needs_world, require_weights

EXAMPLES = ("a chair", "a plant")
"""What is asked of captures until somebody says better."""


def suite_name(folder: Path) -> str:
    """A suite's name made of a folder's."""
    name = re.sub(r"[^A-Za-z0-9_.-]+", "-", folder.resolve().name).strip("-._")
    return name[:64] or "mine"


def suite_text(
    folder: Path,
    found: Sequence[FoundData],
    queries: Sequence[str] = EXAMPLES,
    methods: Sequence[str] = ("gvr-robust",),
    models: str = "onboard",
) -> str:
    """The suite as text, checked as a run would check it.

    Args:
        folder: The folder that was looked at.
        found: What it holds.
        queries: What to ask of each capture.
        methods: Names of methods.
        models: Label of a bundled set of models.

    Raises:
        ConfigError: for a name that is not known, a query that cannot be asked, or oracle models
            where a scene does not state its truth.
        ModelError: for weights that are missing.
    """
    for method in methods:
        if method not in METHODS:
            raise unknown_name("method", method, METHODS)
    chosen = bundled_models(models)
    require_weights(chosen)
    unlabelled = [data for data in found if data.layout == CAPTURE and data.scenes]
    if unlabelled and needs_world(chosen):
        raise ConfigError(
            f"models {models!r} need the truth, which {unlabelled[0].scenes[0].name} does not "
            "state",
            accepted=", ".join(name for name, m in BUNDLED.items() if not needs_world(m)),
        )
    own_queries(queries)
    text = (
        _templates()
        .get_template("own_suite.toml.j2")
        .render(
            folder=str(folder.resolve()),
            name=suite_name(folder),
            found=found,
            queries=list(dict.fromkeys(queries)),
            methods=list(dict.fromkeys(methods)),
            others=", ".join(name for name in METHODS if name not in methods),
            models=BUNDLED[models].model_dump(exclude_defaults=True),
        )
    )
    suite = SuiteConfig.model_validate(tomllib.loads(text))
    resolve_scenes(suite.datasets)
    return text


def check_free(path: Path, force: bool) -> None:
    """Refuse a file that is there, unless it is to give way.

    Raises:
        ConfigError: naming the file.
    """
    if path.exists() and not force:
        raise ConfigError("there is a file already", path=path, accepted="--out FILE, or --force")


def write_suite(path: Path, text: str) -> None:
    """Write a suite file, whole or not at all.

    Raises:
        ConfigError: for a file that cannot be written.
    """
    try:
        with atomic_write(path) as stream:
            stream.write(text.encode("utf-8"))
    except (OSError, UnicodeEncodeError) as error:
        raise ConfigError(
            f"cannot be written: {getattr(error, 'strerror', None) or error}",
            path=path,
            accepted="a .toml file in a folder of yours",
        ) from error


def _templates() -> Environment:
    made = Environment(
        loader=PackageLoader("flows", "templates"),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        autoescape=False,
    )
    # TOML's basic strings and arrays of them are written as JSON writes them.
    made.filters["toml"] = lambda value: json.dumps(value, ensure_ascii=False).replace(
        "\x7f", "\\u007f"
    )
    made.filters["comment"] = lambda text: "".join(c if c.isprintable() else "?" for c in str(text))
    return made
