"""Commands for the tests, as one types them at a shell."""

import json
import shlex

from jaxshroud.cli.commands import main


def status_of(line):
    """The exit status of a command."""
    return main(shlex.split(line))


def run(line):
    """Run a command that succeeds."""
    assert status_of(line) == 0, line


def refused(capsys, line):
    """The one line that a wrong command leaves on standard error, with exit status 2."""
    capsys.readouterr()
    assert status_of(line) == 2, line
    told = capsys.readouterr().err.splitlines()
    assert len(told) == 1, told
    return told[0]


def sets(*changes):
    """The options that change a scene."""
    return shlex.join(word for change in changes for word in ("--set", change))


def read_json(path):
    """What a file of JSON holds."""
    return json.loads(path.read_text("utf-8"))
