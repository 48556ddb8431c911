"""Suites: what a benchmark run is made of, read from TOML and checked before anything runs."""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from importlib import resources
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from datasets.registry import check_dataset, get_dataset
from gvr_core.errors import ConfigError, unknown_name
from gvr_core.methods import MethodConfig, check_method
from gvr_core.models.registry import ModelConfig, check_models
from gvr_core.rendering import get_renderer

DEFAULT_SUITE = "bench"


class DatasetChoice(BaseModel):
    """A data set, and which of its scenes."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    name: str
    """A registered name, or ``folder:PATH`` for a folder of scenes of one's own."""
    scenes: tuple[str, ...] | None = None
    """Names of scenes; all of them where left out."""
    settings: dict[str, Any] = Field(default_factory=dict)
    """What the data set itself can be told, e.g. where its splats lie."""


class SuiteConfig(BaseModel):
    """A benchmark run, completely configured."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    name: str = Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]{0,63}$")
    datasets: tuple[DatasetChoice, ...] = Field(min_length=1)
    methods: tuple[MethodConfig, ...] = Field(default=(MethodConfig(),), min_length=1)
    models: ModelConfig = ModelConfig()
    renderer: str = "numba"
    limit: int | None = Field(default=None, ge=1)
    """Only the first so many queries of each scene."""
    experiment: str = Field(default="gvr-bench", min_length=1)
    """MLflow experiment."""

    @model_validator(mode="after")
    def _names_exist(self) -> SuiteConfig:
        for dataset in self.datasets:
            check_dataset(dataset.name)
        for method in self.methods:
            check_method(method.method)
        check_models(self.models)
        get_renderer(self.renderer)
        shown = [method.shown_name for method in self.methods]
        twice = sorted({name for name in shown if shown.count(name) > 1})
        if twice:
            raise ConfigError(
                f"two methods are called {', '.join(twice)}", accepted="a label of its own for each"
            )
        return self


def bundled_suites() -> dict[str, Path]:
    """The suites that come with the project, by name."""
    folder = Path(str(resources.files("flows") / "suites"))
    return {path.stem: path for path in sorted(folder.glob("*.toml"))}


def read_suite(name_or_path: str) -> SuiteConfig:
    """Read a suite: a bundled one by its name, or a TOML file by its path.

    Raises:
        ConfigError: naming the file, the place in it, and what is accepted.
    """
    bundled = bundled_suites()
    if name_or_path in bundled:
        return parse_suite(bundled[name_or_path])
    path = Path(name_or_path)
    if path.suffix == ".toml" or path.exists():
        return parse_suite(path)
    raise unknown_name("suite", name_or_path, [*bundled, "a path to a .toml file"])


def parse_suite(path: Path) -> SuiteConfig:
    """Read and check one suite file.

    Raises:
        ConfigError: naming the file, the place in it, and what is accepted.
    """
    try:
        data = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigError(
            f"cannot be read: {error.strerror}", path=path, accepted="a TOML file"
        ) from error
    except (UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise ConfigError(f"is not TOML: {error}", path=path, accepted="a TOML file") from error
    try:
        return SuiteConfig.model_validate(data)
    except ValidationError as error:
        raise _first_problem(error, path) from error
    except ConfigError as error:
        raise ConfigError(error.message, path=path, accepted=error.accepted) from error


def override(
    suite: SuiteConfig,
    methods: Sequence[str] = (),
    datasets: Sequence[str] = (),
    scenes: Sequence[str] = (),
    limit: int | None = None,
) -> SuiteConfig:
    """The suite with choices made on the command line.

    Args:
        suite: The suite as its file has it.
        methods: Run only these: names shown in the suite, or registered method names.
        datasets: Run only these; the suite's own settings are kept where it has the data set.
        scenes: Run only these scenes.
        limit: Only the first so many queries of each scene.

    Raises:
        ConfigError: for a name that does not exist.
    """
    changes: dict[str, Any] = {}
    if methods:
        shown = {method.shown_name: method for method in suite.methods}
        for name in methods:
            if name not in shown:
                check_method(name)
        changes["methods"] = tuple(shown.get(n) or MethodConfig(method=n) for n in methods)
    if datasets:
        known = {dataset.name: dataset for dataset in suite.datasets}
        for name in datasets:
            check_dataset(name)
        changes["datasets"] = tuple(known.get(n) or DatasetChoice(name=n) for n in datasets)
    if scenes:
        chosen = changes.get("datasets", suite.datasets)
        changes["datasets"] = tuple(
            dataset.model_copy(update={"scenes": tuple(scenes)}) for dataset in chosen
        )
    if limit is not None:
        if limit < 1:
            raise ConfigError(f"--limit is {limit}", accepted="1 or more")
        changes["limit"] = limit
    return suite.model_copy(update=changes)


def resolve_scenes(choices: Sequence[DatasetChoice]) -> list[tuple[str, str]]:
    """All (data set, scene) pairs of a suite.

    Raises:
        ConfigError: for a scene that the data set does not have.
        DatasetError: for a folder without scenes.
    """
    pairs = []
    for choice in choices:
        known = list(get_dataset(choice.name, choice.settings).scenes())
        for scene in known if choice.scenes is None else choice.scenes:
            if scene not in known:
                raise unknown_name(f"scene of {choice.name}", scene, known)
            pairs.append((choice.name, scene))
    return pairs


def _first_problem(error: ValidationError, path: Path) -> ConfigError:
    problem = error.errors()[0]
    place = ".".join(str(part) for part in problem["loc"]) or "top level"
    accepted = None
    if problem["type"] == "extra_forbidden":
        accepted = ", ".join(_fields_at(SuiteConfig, problem["loc"][:-1])) or None
    return ConfigError(problem["msg"], path=path, place=place, accepted=accepted)


def _fields_at(model: type[BaseModel], place: tuple[int | str, ...]) -> list[str]:
    """Names of the settings that a place in the suite file may have."""
    for part in place:
        if not isinstance(part, str) or part not in model.model_fields:
            continue
        inner = _model_in(model.model_fields[part].annotation)
        if inner is None:
            return []
        model = inner
    return list(model.model_fields)


def _model_in(annotation: Any) -> type[BaseModel] | None:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    for argument in getattr(annotation, "__args__", ()):
        inner = _model_in(argument)
        if inner is not None:
            return inner
    return None
