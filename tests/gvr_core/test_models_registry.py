"""Names in a configuration become models, loaded once; and imports live with our folder names."""

from __future__ import annotations

import subprocess
import sys
import threading
from pathlib import Path

import pytest
from pydantic import ValidationError

from gvr_core.errors import ConfigError
from gvr_core.models import registry
from gvr_core.models.conse import ConseEncoder, ConseSettings
from gvr_core.models.graph_segmenter import GraphSegmenter, GraphSettings
from gvr_core.models.random_encoder import RandomEncoder
from gvr_core.models.ranked_proposals import RankedProposals
from gvr_core.models.registry import ModelConfig, build_models

ROOT = Path(__file__).resolve().parents[2]


def in_a_fresh_process(code: str) -> str:
    """What code prints in an interpreter that has the project's folder first on its path."""
    code = f"import sys; sys.path.insert(0, {str(ROOT)!r})\n{code}"
    done = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        timeout=300,
        cwd=ROOT,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def test_the_default_is_all_onboard_and_loaded_once() -> None:
    first, second = build_models(), build_models(ModelConfig())
    assert isinstance(first.segmenter, GraphSegmenter)
    assert isinstance(first.encoder, ConseEncoder)
    assert isinstance(first.text_segmenter, RankedProposals)
    assert first.encoder is second.encoder and first.segmenter is second.segmenter
    for model in (first.segmenter, first.encoder, first.text_segmenter):
        assert model.name.startswith("onboard-")


def test_other_settings_are_other_models() -> None:
    config = ModelConfig(encoder="random:1", graph=GraphSettings(max_masks=7))
    assert (
        build_models(config).segmenter.name
        != build_models(ModelConfig(encoder="random:1")).segmenter.name
    )


def test_the_control_is_named_with_its_seed() -> None:
    names = set()
    for seed in (0, 17):
        encoder = build_models(ModelConfig(encoder=f"random:{seed}")).encoder
        assert isinstance(encoder, RandomEncoder)
        assert f"seed={seed}," in encoder.name
        names.add(encoder.name)
    assert len(names) == 2


@pytest.mark.parametrize(
    ("field", "value", "known"),
    [
        ("segmenter", "sam9", "onboard-graph"),
        ("encoder", "clipp", "onboard-conse, open_clip:MODEL/TAG, oracle, random:SEED"),
        ("encoder", "random:", "random:SEED"),
        ("encoder", "random:-1", "random:SEED"),
        ("text_segmenter", "dino", "onboard-ranked"),
    ],
)
def test_unknown_names_are_refused_with_the_known_ones(field: str, value: str, known: str) -> None:
    with pytest.raises(ConfigError) as error:
        build_models(ModelConfig.model_validate({field: value}))
    assert value in str(error.value) and known in str(error.value)


def test_unknown_settings_are_refused() -> None:
    with pytest.raises(ValidationError, match="segmentor"):
        ModelConfig.model_validate({"segmentor": "onboard-graph"})
    with pytest.raises(ValidationError, match="crop"):
        ModelConfig.model_validate({"conse": {"crop": "masked"}})


def test_threads_that_want_one_model_share_one_loading(monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[object] = []

    class Slow(RandomEncoder):
        def __init__(self, settings: ConseSettings) -> None:
            made.append(threading.get_ident())
            threading.Event().wait(0.05)
            super().__init__()

    monkeypatch.setattr(registry, "ConseEncoder", Slow)
    registry._conse_encoder.cache_clear()
    try:
        found: list[object] = []
        threads = [
            threading.Thread(target=lambda: found.append(build_models().encoder)) for _ in range(6)
        ]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert len(made) == 1 and len(found) == 6 and len(set(map(id, found))) == 1
    finally:
        registry._conse_encoder.cache_clear()


def test_reading_a_configuration_imports_nothing_heavy() -> None:
    heavy = in_a_fresh_process(
        "from gvr_core.models.registry import ModelConfig, build_models\n"
        "build_models(ModelConfig(encoder='random:0'))\n"
        "print([m for m in ('torch', 'transformers', 'open_clip', 'prefect') if m in sys.modules])"
    )
    assert heavy == "[]"


def test_libraries_import_although_our_folder_is_called_datasets() -> None:
    printed = in_a_fresh_process(
        "import datasets, transformers, timm, mlflow\n"
        "from transformers import BertModel\n"
        "print(datasets.__file__)"
    )
    assert Path(printed.splitlines()[-1]).parent == ROOT / "datasets"


def test_the_onboard_models_never_import_sentence_transformers() -> None:
    printed = in_a_fresh_process(
        "from gvr_core.models.registry import build_models\n"
        "build_models().encoder.encode_texts(['a cat'])\n"
        "print('sentence_transformers' in sys.modules, 'datasets' in sys.modules)"
    )
    assert printed.splitlines()[-1] == "False False"
