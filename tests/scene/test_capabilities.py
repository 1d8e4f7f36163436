"""The table of what pairs or rows alone have: its lines are those of refusals and of the documentation."""

from pathlib import Path

import pytest

import jaxshroud as js
from jaxshroud import cli
from jaxshroud.cli.command_table import COMMANDS
from jaxshroud.scene.checks import InputError
from jaxshroud.scene.layout import CAPABILITIES, LIMITED, NO_CONTACT, PAIR, holders, require_capability, row_layout

LAYOUTS = {"pair": PAIR, "chain": row_layout(3, False), "ring": row_layout(3, True)}
SCENES = {"pair": "row_chain5", "pair so far": "row_chain5", "rows": "table1"}  # without what a holder has
PAGE = Path(__file__).parents[2] / "docs" / "row_measured.md"
NEEDS = {
    "fit": ["data.csv", "--over", "blades.c_x=1:9"],
    "mistune": ["--along", "drive.omega", "--start", "500", "--stop", "600"],
}  # without which a command is not understood


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("name", LIMITED)
def test_what_a_scene_lacks_is_refused_by_the_line_of_the_table(name, layout):
    capability = LIMITED[name]
    if capability.holder in holders(LAYOUTS[layout]):
        require_capability(name, LAYOUTS[layout])
        return
    with pytest.raises(InputError) as told:
        require_capability(name, LAYOUTS[layout], "scene.toml: ", "It")
    assert str(told.value) == f"scene.toml: {capability.refusal('It')}"


def test_what_the_table_does_not_name_all_scenes_have():
    for layout in LAYOUTS.values():
        require_capability("`simulate`", layout)


@pytest.mark.parametrize("verb", [verb for verb in COMMANDS if f"`{verb}`" in LIMITED])
def test_commands_refuse_scenes_by_the_line_of_the_table(verb, tmp_path, capsys):
    scene, limited = SCENES[LIMITED[f"`{verb}`"].holder], LIMITED[f"`{verb}`"]
    assert cli.main([verb, scene, *NEEDS.get(verb, []), "--out", str(tmp_path / "out")]) == 2
    assert capsys.readouterr().err.splitlines()[-1].endswith(limited.refusal())


def test_a_row_without_contact_is_refused_by_the_table():
    bare = js.load("row_chain5", ['parts.contact="none"'])
    for ask in ("explain", "check", "simulate"):
        with pytest.raises(InputError) as told:
            getattr(js, ask)(bare)
        assert str(told.value).endswith(LIMITED[NO_CONTACT].refusal())


def test_the_documentation_has_the_table():
    lines = [f"| {c.name} | {c.holder} | {c.reason} |" for c in CAPABILITIES]
    assert "\n".join(lines) in PAGE.read_text("utf-8")
