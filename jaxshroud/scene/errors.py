"""All errors of the package: one line each, with what is wrong and the cure.

They are `Error`s, and of the built-in kind that such a mistake has in Python. Ctrl-C is none: `Interrupted` is a
KeyboardInterrupt.
"""


class Error(Exception):
    """What the package raises."""


class InputError(Error, ValueError):
    """What was given is wrong."""


class SceneError(InputError):
    """A scene file, an override or a number of a scene is wrong."""


class KeyNameError(SceneError, KeyError):
    """A key names no number of a scene, or not just one."""

    __str__ = ValueError.__str__  # KeyError's own puts the message into quotes


class StepTooLongError(InputError):
    """The march would be unstable, or the message of a warning that it will be inaccurate."""


class NumericalError(Error, ValueError):
    """What was asked for is in order, but the numbers do not bear it."""


class StoreError(InputError):
    """A result cannot be written or read; the message is one line with the place and the cure."""


class WriteError(StoreError, OSError):
    """A file cannot be written there."""


class MachineError(WriteError):
    """What was asked for was right, but the machine failed: a disk is full or broken, a scheduler not there."""
