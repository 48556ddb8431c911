"""Suites: what a benchmark run is made of, read from TOML and checked before anything runs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    ValidationError,
    field_validator,
    model_validator,
)

from datasets.captures import CAPTURES
from datasets.registry import FOLDER, check_dataset, get_dataset
from flows.bundled import bundled_suites
from flows.lines import BUNDLED, Line, ModelSet, make_lines
from flows.run_config import RunConfig
from gvr_core.errors import ConfigError, did_you_mean, unknown_name
from gvr_core.methods import MethodConfig, check_method, check_options, variants
from gvr_core.models.registry import ModelConfig, check_models
from gvr_core.rendering import get_renderer
from gvr_core.untrusted import read_toml


class DatasetChoice(BaseModel):
    """A data set, and which of its scenes."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    name: str
    """A registered name, or for scenes of one's own ``folder:PATH`` (in the native layout) or
    ``captures:PATH`` (splats and cameras, without truth)."""
    scenes: tuple[str, ...] | None = None
    """Names of scenes; all of them where left out."""
    settings: dict[str, Any] = Field(default_factory=dict)
    """What the data set itself can be told, e.g. where its splats lie."""

    @field_validator("name")
    @classmethod
    def _one_spelling(cls, name: str) -> str:
        # As the data set itself is called: results are found again by that.
        for kind in (FOLDER, CAPTURES):
            if name.startswith(kind):
                return f"{kind}{Path(name.removeprefix(kind))}"
        return name


class SuiteConfig(BaseModel):
    """A benchmark run, completely configured."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    name: str = Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]{0,63}$")
    datasets: tuple[DatasetChoice, ...] = Field(min_length=1)
    methods: tuple[MethodConfig, ...] = Field(default=(MethodConfig(),), min_length=1)
    models: tuple[ModelSet, ...] = Field(default=(ModelSet(),), min_length=1)
    """Every method runs with each of these; a single one may be given as a table."""
    renderer: str = "numba"
    limit: int | None = Field(default=None, ge=1)
    """Only the first so many queries of each scene."""
    exclude_eval_views: bool = False
    """Keep the test views out of the knowledge views, where a data set has them in both."""
    evidence: bool = True
    """Keep the steps behind each answer as small pictures, for `gvr report`; variants of
    ``leave_one_out`` have none."""
    experiment: str = Field(default="gvr-bench", min_length=1)
    """MLflow experiment."""
    run: RunConfig = RunConfig()
    """Where and how its scenes are computed; changes no result."""

    @field_validator("models", mode="before")
    @classmethod
    def _one_set(cls, given: Any) -> Any:
        if isinstance(given, ModelConfig):
            return (given.model_dump(),)
        return (given,) if isinstance(given, dict) else given

    @model_validator(mode="after")
    def _names_exist(self) -> SuiteConfig:
        for dataset in self.datasets:
            check_dataset(dataset.name)
            _refuse_doubles(f"scenes of {dataset.name}", dataset.scenes or ())
        _refuse_doubles("data sets", [dataset.name for dataset in self.datasets])
        for method in self.methods:
            check_method(method.method)
            check_options(method)
        for models in self.models:
            check_models(models)
        labels = [models.label for models in self.models]
        if len(labels) > 1 and (not all(labels) or len(set(labels)) < len(labels)):
            raise ConfigError(
                f"{len(labels)} sets of models, labelled {', '.join(map(repr, labels))}",
                accepted="a label of its own for each",
            )
        get_renderer(self.renderer)
        self.lines()
        return self

    def lines(self) -> tuple[Line, ...]:
        """Every method, and its variants, with every model set, in the order of running."""
        return make_lines(self.methods, self.models)


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
    file = f"{name_or_path}.toml"
    if Path(file).is_file():
        raise ConfigError(
            f"unknown suite {name_or_path!r}; did you mean {file!r}?", accepted=", ".join(bundled)
        )
    raise unknown_name("suite", name_or_path, [*bundled, "a path to a .toml file"])


def parse_suite(path: Path) -> SuiteConfig:
    """Read and check one suite file.

    Raises:
        ConfigError: naming the file, the place in it, and what is accepted.
    """
    try:
        data = read_toml(path)
    except OSError as error:
        meant = did_you_mean(str(path), map(str, path.parent.glob("*.toml")))
        raise ConfigError(
            f"cannot be read: {error.strerror}{meant}",
            path=path,
            accepted="a TOML file; `gvr init FOLDER` writes one",
        ) from error
    except ValueError as error:
        raise ConfigError(f"is not TOML: {error}", path=path, accepted="a TOML file") from error
    try:
        return SuiteConfig.model_validate(data)
    except ValidationError as error:
        raise _first_problem(error, path, data) from error
    except ConfigError as error:
        raise ConfigError(error.message, path=path, accepted=error.accepted) from error


def override(
    suite: SuiteConfig,
    methods: Sequence[str] = (),
    datasets: Sequence[str] = (),
    scenes: Sequence[str] = (),
    limit: int | None = None,
    models: Sequence[str] = (),
    exclude_eval_views: bool = False,
) -> SuiteConfig:
    """The suite with choices made on the command line.

    Args:
        suite: The suite as its file has it.
        methods: Run only these: names shown in the suite, a method's with the variants that the
            suite has of it; labels of single variants; or registered method names.
        datasets: Run only these; the suite's own settings are kept where it has the data set.
        scenes: Run only these scenes.
        limit: Only the first so many queries of each scene.
        models: Run only with these: labels of the suite's model sets, or of bundled
            ones (:data:`flows.lines.BUNDLED`).
        exclude_eval_views: Keep test views out of the knowledge views.

    Raises:
        ConfigError: for a name that does not exist.
    """
    changes: dict[str, Any] = {}
    if exclude_eval_views:
        changes["exclude_eval_views"] = True
    if methods:
        changes["methods"] = _chosen_methods(suite, methods)
    if models:
        own = {chosen.label: chosen for chosen in suite.models if chosen.label}
        sets = BUNDLED | own
        for name in models:
            if name not in sets:
                raise unknown_name("set of models", name, sets)
        changes["models"] = tuple(sets[name] for name in dict.fromkeys(models))
    if datasets:
        known = {dataset.name: dataset for dataset in suite.datasets}
        for name in datasets:
            check_dataset(name)
        names = dict.fromkeys(datasets)
        changes["datasets"] = tuple(known.get(n) or DatasetChoice(name=n) for n in names)
    if scenes:
        chosen = changes.get("datasets", suite.datasets)
        changes["datasets"] = tuple(
            dataset.model_copy(update={"scenes": tuple(dict.fromkeys(scenes))})
            for dataset in chosen
        )
    if limit is not None:
        if limit < 1:
            raise ConfigError(f"--limit is {limit}", accepted="1 or more")
        changes["limit"] = limit
    return suite.model_copy(update=changes)


def _chosen_methods(suite: SuiteConfig, names: Sequence[str]) -> tuple[MethodConfig, ...]:
    shown = {method.shown_name: method for method in suite.methods}
    single = {v.shown_name: v for method in suite.methods for v in variants(method)[1:]}
    chosen = []
    for name in dict.fromkeys(names):
        if name not in shown and name not in single:
            check_method(name, asked=True, others=(*shown, *single))
        chosen.append(shown.get(name) or single.get(name) or MethodConfig(method=name))
    # A single variant is no second line beside its own method with all its variants.
    covered = {v.shown_name for method in chosen for v in variants(method)[1:]}
    return tuple(method for method in chosen if method.shown_name not in covered)


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


def _refuse_doubles(what: str, names: Sequence[str]) -> None:
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise ConfigError(f"among the {what}, {', '.join(twice)} twice", accepted="each once")


def _first_problem(error: ValidationError, path: Path, data: dict[str, Any]) -> ConfigError:
    problem = error.errors()[0]
    parts = list(problem["loc"])
    if parts[:2] == ["models", 0] and isinstance(data.get("models"), dict):
        del parts[1]  # a single table, as the file has it
    place = ".".join(str(part) for part in parts) or "top level"
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
