"""Plugins: found by name, loaded when named, refused in words that say which package is meant."""

from __future__ import annotations

import copy
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from fresh_folder import environment
from oracle_boxes import boxes
from plugin_packages import as_in_a_new_process, install
from small_scene import two_boxes

from gvr_core import plugins
from gvr_core.errors import ConfigError, PluginError
from gvr_core.methods import MethodConfig, build_method, check_method, variants
from gvr_core.methods.gvr_paper import GVRPaper
from gvr_core.models.registry import ModelConfig, build_models, check_models
from gvr_core.rendering import get_renderer

METHOD = """
from gvr_core.methods.gvr_paper import GVRPaper, LocateConfig, SegmentConfig

def make(tools, name, top_k=1):
    return GVRPaper(tools, LocateConfig(top_k=top_k), SegmentConfig(), name)
"""
ENCODER = """
from gvr_core.models.random_encoder import RandomEncoder

def make(seed=0):
    return RandomEncoder(seed)
"""
RENDERER = """
from gvr_core.rendering.numba_renderer import NumbaRenderer
"""


def toy(folder: Path, version: str = "1.0", module: str = METHOD, name: str = "toy") -> None:
    install(
        folder,
        name,
        version,
        {plugins.METHODS: {"toy": f"{name}_x:make"}},
        {f"{name}_x.py": module},
    )


def test_nothing_is_looked_for_while_names_are_the_projects_own() -> None:
    code = (
        "from flows.suite import bundled_suites, read_suite\n"
        "from gvr_core import plugins\n"
        "for name in bundled_suites(): read_suite(name)\n"
        "print(plugins._entry_points.cache_info().misses)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment(), capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == "0", done.stderr


def test_a_name_is_known_before_anything_is_imported(packages: Path) -> None:
    toy(packages, module="raise SystemError('imported')")
    assert plugins.offered(plugins.METHODS) == ("toy",)
    assert plugins.is_offered(plugins.METHODS, "toy")
    with pytest.raises(ConfigError, match=r"accepted: .*gvr-paper.*toy"):
        check_method("tooy")
    (offer,) = plugins.all_offers()
    assert (offer.group, offer.name, offer.source) == (plugins.METHODS, "toy", "toy 1.0")


def test_a_method_is_made_with_its_options_under_its_label(packages: Path) -> None:
    toy(packages)
    tools = boxes().method().tools
    config = MethodConfig(method="toy", label="mine", options={"top_k": 3})
    method = build_method(config, tools)
    assert isinstance(method, GVRPaper)
    assert (method.name, method.locating.top_k) == ("mine", 3)
    assert variants(config.model_copy(update={"leave_one_out": True})) == (config,)
    with pytest.raises(PluginError, match=r"toy 1\.0, .*toy = toy_x:make: .*colour"):
        build_method(config.model_copy(update={"options": {"colour": 1}}), tools)


@pytest.mark.parametrize(
    ("module", "expected"),
    [
        ("import nothing_of_that_name", "ModuleNotFoundError: No module named"),
        ("def mk(): ...", "AttributeError"),
        ("1 +", "SyntaxError"),
        ("make = 3", "a int (accepted: a class or a function"),
    ],
    ids=["import", "missing", "syntax", "no function"],
)
def test_one_that_cannot_be_loaded_is_named(
    packages: Path,
    module: str,
    expected: str,
) -> None:
    toy(packages, module=module)
    with pytest.raises(PluginError) as error:
        check_method("toy")
    assert f"toy 1.0, [{plugins.METHODS}] toy = toy_x:make: " in str(error.value)
    assert expected in str(error.value)


def test_what_lacks_a_part_of_its_role_is_refused(packages: Path) -> None:
    toy(packages, module="class make:\n    def __init__(self, tools, name): self.name = name\n")
    with pytest.raises(PluginError, match=r"make has no prepare, index.*accepted: an object with"):
        build_method(MethodConfig(method="toy"), boxes().method().tools)


def test_two_packages_with_one_name_are_refused(packages: Path) -> None:
    toy(packages)
    toy(packages, name="toys", version="2.1")
    with pytest.raises(ConfigError, match=r"2 packages offer 'toy' in .*: toy 1\.0, toys 2\.1"):
        check_method("toy")


def test_the_projects_own_names_win(packages: Path) -> None:
    refusing = {"loud.py": "raise SystemError('imported')"}
    offers = {
        plugins.METHODS: {"gvr-paper": "loud:make"},
        plugins.MODELS: {"onboard-graph": "loud:make"},
        plugins.RENDERERS: {"numba": "loud:make"},
    }
    install(packages, "loud", "1", offers, refusing)
    assert isinstance(build_method(MethodConfig(), boxes().method().tools), GVRPaper)
    check_models(ModelConfig())
    assert "[" not in get_renderer("numba").name
    assert "loud" not in sys.modules


def test_the_origin_follows_version_and_code(packages: Path) -> None:
    def identity() -> str:
        as_in_a_new_process(packages)
        return MethodConfig(method="toy").identity

    toy(packages)
    first = identity()
    assert first.startswith("toy [toy 1.0 ")
    assert identity() == first
    toy(packages, version="1.1")
    newer = identity()
    toy(packages, version="1.0", module=METHOD + "# edited\n")
    assert len({first, newer, identity()}) == 3
    assert MethodConfig().identity == "gvr-paper"


def test_the_code_is_that_of_the_whole_package(packages: Path) -> None:
    files = {"pack/__init__.py": "", "pack/deep/__init__.py": "", "pack/deep/way.py": METHOD}
    found = set()
    for helper in ("", "1", "2"):
        offers = {plugins.METHODS: {"toy": "pack.deep.way:make"}}
        install(packages, "pack", f"1.{helper or 0}", offers, files | {"pack/helper.py": helper})
        as_in_a_new_process(packages)
        found.add(plugins.load(plugins.METHODS, "toy").origin.split()[-1])
    assert len(found) == 3


def test_a_model_carries_its_origin_and_options_in_its_name(packages: Path) -> None:
    install(packages, "enc", "3", {plugins.MODELS: {"blind": "enc:make"}}, {"enc.py": ENCODER})
    plain = build_models(ModelConfig(encoder="blind")).encoder
    assert plain.name.startswith("random/") and " [enc 3 " in plain.name
    assert build_models(ModelConfig(encoder="blind")).encoder is plain
    told = ModelConfig(encoder="blind", options={"blind": {"seed": 5}})
    assert build_models(told).encoder.name != plain.name
    assert build_models(told).text_segmenter.name != build_models().text_segmenter.name
    vectors = plain.encode_texts(["a cat"])
    assert vectors.shape == (1, plain.dim)
    for twin in (copy.copy(plain), copy.deepcopy(plain)):
        assert np.array_equal(twin.encode_texts(["a cat"]), vectors)
    with pytest.raises(PluginError, match="RandomEncoder has no automatic, at_point, in_box"):
        build_models(ModelConfig(segmenter="blind"))


def test_options_that_nothing_reads_are_refused(packages: Path) -> None:
    install(packages, "enc", "3", {plugins.MODELS: {"blind": "enc:make"}}, {"enc.py": ENCODER})
    with pytest.raises(ConfigError, match=r"options of blind .*no options: no model is a plugin's"):
        check_models(ModelConfig(options={"blind": {"seed": 5}}))
    with pytest.raises(ConfigError, match=r"options of bland .*accepted: blind\)"):
        check_models(ModelConfig(encoder="blind", options={"bland": {}}))


def test_a_renderer_draws_under_its_own_name(packages: Path) -> None:
    offers = {plugins.RENDERERS: {"mine": "ren:NumbaRenderer"}}
    install(packages, "ren", "0.2", offers, {"ren.py": RENDERER})
    mine, own = get_renderer("mine"), get_renderer("numba")
    assert mine.name.startswith(f"{own.name} [ren 0.2 ")
    scene, _ = two_boxes(1)
    camera = scene.views[0].camera
    drawn, twin = (r.render(scene.gaussians, camera).rgb for r in (mine, own))
    assert np.array_equal(drawn, twin)
    with pytest.raises(ConfigError, match="accepted: gsplat, mine, numba"):
        get_renderer("mime")


def test_metadata_that_cannot_be_read_is_one_error(packages: Path) -> None:
    toy(packages)
    (info,) = packages.glob("*.dist-info")
    (info / "entry_points.txt").write_text(f"[{plugins.METHODS}]\nno equals sign\n")
    with pytest.raises(PluginError, match="entry points cannot be read"):
        check_method("toy")
