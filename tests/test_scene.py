import pytest

from morphofold.sim.scene import LEVELS, Scene, load_scene, scene_names

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


def test_built_in_scenes_are_valid_and_named_after_their_files():
    assert {"demo", "fig5"} <= set(scene_names())
    for name in scene_names():
        assert load_scene(name).name == name


def test_a_resolved_scene_reads_back_as_itself(tmp_path):
    for name in scene_names():
        scene = load_scene(name)
        assert load_scene(write(tmp_path, scene.to_toml())) == scene
    odd = Scene(name="odd", title='a "quoted" \\ title')
    assert load_scene(write(tmp_path, odd.to_toml())) == odd


def test_only_the_effects_named_are_there(tmp_path):
    assert load_scene(write(tmp_path, GOOD)).effects.named == ("contact",)
    assert load_scene(write(tmp_path, GOOD.replace("[effects.contact]", ""))).effects.named == ()


def test_settings_change_single_values(tmp_path):
    scene = load_scene(write(tmp_path, GOOD), ["growth.law=tangential", "geometry.cortex_thickness=2"])
    assert (scene.growth.law, scene.geometry.cortex_thickness) == ("tangential", 2.0)
    with pytest.raises(ValueError, match=r"must read table\.key=value"):
        load_scene(write(tmp_path, GOOD), ["growth.law"])
    with pytest.raises(ValueError, match="'name' is a value, not a table"):
        load_scene(write(tmp_path, GOOD), ["name.law=1"])


def test_the_final_growth_is_always_a_stage(tmp_path):
    assert load_scene(write(tmp_path, GOOD)).stages == (1.5, 1.8)


def test_finer_levels_have_more_cells():
    cells = [load_scene("fig5", [f"accuracy.level={level}"]) for level in LEVELS]
    assert [s.cells for s in cells] == sorted(s.cells for s in cells)
    assert all(s.cells % 2 == 0 for s in cells)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("final = 1.8", "finale = 1.8"), r"mine.toml, line 7: unknown key growth.finale. Did you mean final\?"),
        (("[effects.contact]", "[effects.contct]"), r"line 8: unknown key effects.contct. Did you mean contact\?"),
        (("hole_radius = 25.0", "hole_radius = 60.0"), r"line 5: geometry: hole_radius 60 .* core of radius 47"),
        (("cortex_thickness = 3.0", "cortex_thickness = 70.0"), r"line 4: geometry: .* 70 leaves no core"),
        (("final = 1.8", "final = -1"), r"line 7: growth.final: .*greater than or equal to 1 \(got -1\)"),
        (("final = 1.8", "final = nan"), r"line 7: growth.final"),
        (("final = 1.8", 'law = "radial"'), r"line 7: growth.law: .*'isotropic' or 'tangential' \(got 'radial'\)"),
        (("stages = [1.5]", "stages = [1.9]"), r"line 10: .*1.9 lies beyond growth.final = 1.8"),
        (("stages = [1.5]", "stages = [1.501, 1.504]"), r"must differ by 0.01"),
        (('name = "mine"', 'name = "../mine"'), r"line 2: name"),
        (('name = "mine"', 'name = "mine'), r"mine.toml: not a TOML file"),
        (("[growth]", "[accuracy]\nedge = 0\n[growth]"), r"line 7: accuracy.edge: .*greater than 0"),
        (("[growth]", "[accuracy]\nedge = 0.01\n[growth]"), r"more than 5e\+06"),
        (("[geometry]", '[geometry]\nshape = "cube"'), r"line 4: geometry.*shape must be one of sphere, ellipsoid"),
        (("[geometry]", '[geometry]\nshape = "patch"'), r"line 6: unknown key geometry.hole_radius"),
        (("hole_radius = 25.0", 'shape = "radial"'), r"line 8: .*effects.contact makes no sense with .*'radial'"),
    ],
)
def test_a_bad_scene_is_refused_with_its_line(tmp_path, change, message):
    text = GOOD.replace(*change)
    assert text != GOOD
    with pytest.raises(ValueError, match=message):
        load_scene(write(tmp_path, text))


@pytest.mark.parametrize("setting", ["accuracy.level=draft", "accuracy.edge=1.0"])
def test_a_body_from_a_file_has_the_mesh_of_the_file(setting):
    with pytest.raises(ValueError, match=r"accuracy makes no sense .* = 'mesh': the mesh is the file's; drop it"):
        load_scene("mesh", [setting])
    assert load_scene(load_scene("mesh")) == load_scene("mesh")


def test_all_problems_are_told_at_once(tmp_path):
    text = GOOD.replace("final = 1.8", 'final = 9\nlaw = "x"\nfoo = 1')
    with pytest.raises(ValueError) as told:
        load_scene(write(tmp_path, text))
    assert len(str(told.value).splitlines()) == 3


def test_an_unknown_scene_is_refused_with_the_nearest_name(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"Did you mean fig5\?"):
        load_scene("fig55")
    with pytest.raises(FileNotFoundError, match="no scene file"):
        load_scene(tmp_path / "none.toml")


def test_a_binary_file_is_no_scene(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_bytes(bytes(range(128, 256)))
    with pytest.raises(ValueError, match="not UTF-8 text"):
        load_scene(path)
