"""The tables of commands and options are of one piece with the verbs and with the modules that run them."""

from collections import Counter
from importlib import import_module

import pytest

import jaxshroud as js
from jaxshroud.cli.command_table import COMMANDS, GROUPS
from jaxshroud.cli.option_table import SHARED_OPTIONS


def destination(option):
    """The name under which an option is found."""
    shared = SHARED_OPTIONS[option] if isinstance(option, str) else option
    return shared.dest or shared.name.lstrip("-").replace("-", "_")


@pytest.mark.parametrize("name", COMMANDS)
def test_a_command_is_a_verb_or_has_a_function_of_its_own(name):
    module = COMMANDS[name].module
    assert hasattr(import_module(f"jaxshroud.cli.{module}"), f"{name}_command") if module else hasattr(js, name)


def test_every_command_is_in_one_group():
    assert sorted(name for names in GROUPS.values() for name in names) == sorted(COMMANDS)


@pytest.mark.parametrize("name", COMMANDS)
def test_every_option_says_what_it_does(name):
    options = [SHARED_OPTIONS[one] if isinstance(one, str) else one for one in COMMANDS[name].options]
    assert not [option.name for option in options if not option.help]


@pytest.mark.parametrize("name", COMMANDS)
def test_no_option_is_there_twice(name):
    assert not [option for option, n in Counter(map(destination, COMMANDS[name].options)).items() if n > 1]


def test_a_shared_option_is_shared():
    used = Counter(
        option if isinstance(option, str) else option.name
        for command in COMMANDS.values()
        for option in command.options
    )
    assert not [name for name in SHARED_OPTIONS if used[name] < 2]
