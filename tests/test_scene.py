import re
import shutil
import tomllib
from pathlib import Path

import pytest
from hypothesis import given, strategies as st

from morphofold.errors import (
    DoesNotApply,
    ImpossibleBody,
    NamedTwice,
    NotFinite,
    NotReadable,
    OutOfRange,
    TooLarge,
    UnknownName,
    WrongFile,
    WrongShape,
)
from morphofold.sim.scene import LEVELS, SHAPES
from morphofold.sim.scene.effect_registry import effect_names, effects_of
from morphofold.sim.scene.scene_files import load_scene, scene_names, to_toml, toml_value
from morphofold.studies.pages import scene_page

GOOD = """
name = "mine"
[geometry]
cortex_thickness = 3.0
hole_radius = 25.0
[growth]
final = 1.8
[effects.contact]
[output]
stages = [1.5]
"""


def write(tmp_path, text):
    path = tmp_path / "mine.toml"
    path.write_text(text)
    return path


def test_built_in_scenes_are_named_after_their_files_and_read_back_as_themselves(tmp_path):
    assert {"demo", "fig5"} <= set(scene_names())
    for name in scene_names():
        scene = load_scene(name)
        assert scene.name == name
        assert load_scene(write(tmp_path, to_toml(scene))) == scene


def test_only_the_effects_named_are_there_and_the_final_growth_is_a_stage(tmp_path):
    scene = load_scene(write(tmp_path, GOOD))
    assert (scene.effects.keys(), scene.stages) == ({"contact"}, (1.5, 1.8))


def test_settings_change_single_values(tmp_path):
    scene = load_scene(write(tmp_path, GOOD), ["growth.law=tangential", "geometry.cortex_thickness=2"])
    assert (scene.growth.law, scene.geometry.cortex_thickness) == ("tangential", 2.0)
    with pytest.raises(NotReadable, match=r"'growth\.law'"):
        load_scene(write(tmp_path, GOOD), ["growth.law"])


def test_edges_longer_than_half_the_cortex_take_two_elements_through_it_unless_told():
    elements = [load_scene("fig5", [f"accuracy.edge={edge}"]).elements_through_cortex for edge in (1.001, 1.0, 0.4)]
    assert elements == [2, 3, 3]  # T = 2 mm
    assert load_scene("fig5", ["accuracy.edge=4", "accuracy.elements_through_cortex=5"]).elements_through_cortex == 5
    assert load_scene("fig5", ["accuracy.level=draft"]).elements_through_cortex == 2


@pytest.mark.parametrize(
    ("change", "kind", "named"),
    [
        (("final = 1.8", "finale = 1.8"), UnknownName, r"mine\.toml, line 7: .*growth\.finale\b.* final\b"),
        (("hole_radius = 25.0", "hole_radius = 60.0"), ImpossibleBody, r"line 5: geometry: hole_radius 60\b.*\b47\b"),
        (("final = 1.8", "final = nan"), NotFinite, r"line 7: growth\.final"),
        (("stages = [1.5]", "stages = [1.9]"), OutOfRange, r"line 10: .*\b1\.9\b.*growth\.final = 1\.8\b"),
        (("stages = [1.5]", "stages = [1.501, 1.504]"), NamedTwice, r"output\.stages\b.*\b0\.01\b"),
        (('name = "mine"', 'name = "mine'), NotReadable, r"mine\.toml: .*\bline 2\b"),
        (("[growth]", "[accuracy]\nedge = 0.01\n[growth]"), TooLarge, r"\b0\.01 mm\b.*\b5e\+06\b"),
        (("[geometry]", '[geometry]\nshape = "patch"'), UnknownName, r"line 6: .*\bgeometry\.hole_radius\b"),
        (("hole_radius = 25.0", 'shape = "radial"'), DoesNotApply, r"line 8: .*\beffects\.contact\b.*'radial'"),
    ],
)
def test_a_bad_scene_is_refused_with_its_line(tmp_path, change, kind, named):
    with pytest.raises(kind, match=named):
        load_scene(write(tmp_path, GOOD.replace(*change)))


def test_a_level_that_is_set_overrules_the_edge_that_was_there(tmp_path):
    demo, fine = load_scene("demo"), ["accuracy.level=fine"]
    assert load_scene("demo", fine).edge == pytest.approx(LEVELS["fine"] * demo.geometry.cortex_thickness)
    assert load_scene(write(tmp_path, 'like = "demo"\n[accuracy]\nlevel = "fine"\n')) == load_scene("demo", fine)
    assert load_scene("demo", [*fine, "accuracy.edge=1.0"]).edge == 1.0
    assert load_scene("demo", ["accuracy.precision=double"]).edge == demo.edge


def test_a_body_from_a_file_has_the_mesh_of_the_file():
    with pytest.raises(DoesNotApply, match=r"\baccuracy\b.*geometry\.shape = 'mesh'"):
        load_scene("mesh", ["accuracy.level=draft"])


def test_all_problems_are_told_at_once(tmp_path):
    text = GOOD.replace("final = 1.8", 'final = 9\nlaw = "x"') + "foo = 1"
    with pytest.raises(UnknownName, match=r"growth\.law\b.*'x'") as caught:
        load_scene(write(tmp_path, text))
    assert "\n" not in str(caught.value)
    assert len(caught.value.__notes__) == 2


def test_an_unknown_scene_is_refused_with_the_nearest_name(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"'fig55'.*\bfig5\b"):
        load_scene("fig55")
    with pytest.raises(FileNotFoundError, match=r"none\.toml"):
        load_scene(tmp_path / "none.toml")
    with pytest.raises(IsADirectoryError, match=re.escape(f"{tmp_path}: ")):
        load_scene(tmp_path)


@pytest.mark.parametrize(
    ("settings", "kind", "message"),
    [
        (["geometry.radius=9000", "growth.final=1.5"], TooLarge, r"^settings .*=9000, .*=1\.5: .*\b5e\+06\b"),
        (["growth.final=1.2", "growth=3"], NotReadable, r"setting growth=3: growth: .*\b3\b"),
        (["growth.final=1.5", "geometry.hole_radius=70"], ImpossibleBody, r"^setting geometry\.hole_radius=70: "),
        (["growth.final=9", "growth.final=8"], OutOfRange, r"^setting growth\.final=8: "),
        (["growth.final=1.5", "output.stages=[1.7]"], OutOfRange, r"^setting output\.stages=.*: .*\b1\.7\b.*\b1\.5\b"),
        (["geometry.shape=radial"], UnknownName, r"^setting geometry\.shape=radial: .*\bgeometry\.portion\b"),
        (["effects.ramp={}"], NotReadable, r"effects\.ramp\.shape: "),
        (["name=../mine"], NotReadable, r"name: .*'\.\./mine'"),
        (["growth.final=1.5\nfoo=3"], NotReadable, r"growth\.final: .*\\nfoo=3'"),
        (["like=fig5"], DoesNotApply, r"setting 'like=fig5'"),
        (["effects.regional_growth.spots=[]"], WrongShape, r"effects\.regional_growth\.spots: .*\b1\b"),
    ],
)
def test_a_bad_setting_is_refused_by_name_in_one_plain_line(settings, kind, message):
    with pytest.raises(kind, match=message) as caught:
        load_scene("fig5", settings)
    assert len(str(caught.value).splitlines()) == 1


def test_a_setting_is_not_blamed_for_what_the_file_says(tmp_path):
    path = write(tmp_path, GOOD.replace("hole_radius = 25.0", "hole_radius = 60.0"))
    with pytest.raises(ImpossibleBody, match=r"mine\.toml, line 5: geometry: hole_radius 60\b"):
        load_scene(path, ["geometry.portion=octant", "growth.final=1.6"])


def test_a_scene_is_like_a_built_in_one_or_a_file_beside_it(tmp_path):
    fig5 = load_scene("fig5")
    scene = load_scene(write(tmp_path, 'name = "mine"\nlike = "fig5"\n[material]\nmu_ratio = 3.0'))
    assert scene == fig5.model_copy(update={"name": "mine", "material": scene.material})
    assert scene.material.mu_ratio == 3
    (tmp_path / "base.toml").write_text(GOOD)
    scene = load_scene(write(tmp_path, 'name = "over"\nlike = "base.toml"'))  # the working directory is another
    assert (scene.name, scene.stages) == ("over", (1.5, 1.8))


def test_a_lower_final_growth_drops_the_stages_that_it_does_not_reach(tmp_path):
    like = 'name = "mine"\nlike = "fig5"\n[growth]\nfinal = 1.3\n'
    for scene in (load_scene("fig5", ["growth.final=1.3"]), load_scene(write(tmp_path, like))):
        assert scene.output.stages == tuple(g for g in load_scene("fig5").output.stages if g <= 1.3) != ()
    with pytest.raises(OutOfRange, match=r"line 6: .*\b1\.5\b.*\b1\.3\b"):
        load_scene(write(tmp_path, f"{like}[output]\nstages = [1.5]"))


@pytest.mark.parametrize(
    ("base", "kind", "message"),
    [
        ("x = [", NotReadable, r"mine\.toml: like = 'base\.toml': .*base\.toml: "),
        ('like = "fig5"', WrongFile, r"mine\.toml: like = 'base\.toml': "),
        ("[growth]\nfinal = 9", OutOfRange, r"base\.toml, line 2: growth\.final: .*\b9\b"),
    ],
)
def test_a_base_that_is_no_scene_is_named(tmp_path, base, kind, message):
    (tmp_path / "base.toml").write_text(base)
    with pytest.raises(kind, match=message):
        load_scene(write(tmp_path, 'name = "mine"\nlike = "base.toml"'))


PAGE = Path(__file__).parent.parent / "docs" / "scenes.md"
in_a_checkout = pytest.mark.skipif(not PAGE.is_file(), reason="needs a checkout")


@in_a_checkout
def test_the_page_of_scenes_says_which_shapes_take_which_effects_and_is_up_to_date(tmp_path):
    for shape in SHAPES:  # some share a row
        row = re.search(rf"^\| (?:\w+, )*{shape}(?:, \w+)* \| (.*) \|$", PAGE.read_text("utf-8"), re.M)[1].split(" | ")
        assert {name for name, cell in zip(effect_names(), row) if cell == "yes"} == set(effects_of(shape))
    copy = shutil.copy(PAGE, tmp_path / "scenes.md")
    scene_page.write(copy)
    assert copy.read_bytes() == PAGE.read_bytes()


@in_a_checkout
def test_the_page_of_scenes_has_every_key_and_a_key_that_tables_share_once():
    text = PAGE.read_text("utf-8")
    keys = {name for model in scene_page.MODEL_OF_HEAD.values() for name in model.model_fields}
    assert all(f"`{name}`" in text or f"[{name}]" in text for name in keys - {"effects"})
    assert (text.count("| `degree` |"), text.count("| `kappa_ratio` |")) == (1, 1)
    assert (text.count("The keys of a map, and:"), text.count("The keys of a map.\n")) == (1, 1)


@in_a_checkout
def test_the_scenes_of_the_page_are_scenes(tmp_path):
    texts = re.findall(r"```toml\n(.*?)```", PAGE.read_text("utf-8"), re.S)
    assert len(texts) == 10
    for text in texts:
        load_scene(write(tmp_path, text if "name =" in text else f'name = "x"\n{text}'))


@given(st.text() | st.text(st.characters(categories=["Cc", "Cf", "Zl", "Zp"]), min_size=1))
def test_every_text_a_scene_can_hold_comes_back_from_its_toml(text):
    """Of controls alone, too: a carriage return, U+0001 and DEL."""
    assert tomllib.loads(f"v = {toml_value(text)}") == {"v": text}
    assert tomllib.loads(f"v = {toml_value([text, {'a': text}])}") == {"v": [text, {"a": text}]}
    if text and "\0" not in text:
        scene = load_scene("mesh")
        geometry = scene.geometry.model_copy(update={"file": text})
        assert tomllib.loads(to_toml(scene.model_copy(update={"geometry": geometry})))["geometry"]["file"] == text
