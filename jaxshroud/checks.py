"""Checks of arguments at the door."""


def count_argument(name: str, value: int, least: int) -> None:
    """Raise ValueError unless `value` is a whole number of at least `least`."""
    if not isinstance(value, int) or isinstance(value, bool) or value < least:
        kind = "positive" if least == 1 else "a whole number of at least 0"
        raise ValueError(f"Argument `{name}` must be {kind}, but is {value}.")
