"""What every verb answers for every kind of scene is what docs/verbs_and_scenes.md says."""

import pytest
import verbs_and_scenes as asked

import jaxshroud as js


def test_every_pair_of_properties_is_in_a_scene(tmp_path):
    assert not asked.missing_pairs()
    for name, kind in asked.SCENES.items():
        file = tmp_path / f"{name}.toml"
        file.write_text(asked.scene_text(kind), "utf-8")
        scene = js.load(file).scene
        assert list(scene.parts.motion) == kind.motion.split(", ")


def test_the_page_is_that_of_the_answers():
    answers = asked.stored_answers()
    assert answers.keys() == asked.SCENES.keys()
    assert asked.PAGE.read_text("utf-8") == asked.page(answers)


def test_trade_refuses_blades_by_modes(tmp_path):
    file = tmp_path / "scene.toml"
    file.write_text(asked.scene_text(asked.SCENES["P9"]), "utf-8")
    for scene in (js.load(file), js.load(file).scene):
        with pytest.raises(js.InputError, match="blades by modes"):
            js.trade(scene, lanes=2)


@pytest.mark.full
@pytest.mark.by_parameter
@pytest.mark.parametrize("name", asked.SCENES)
def test_answers_are_those_of_the_page(name):
    stored = asked.stored_answers()[name]
    assert dict(asked.answers_of(name, stored)) == stored
