"""How large the numbers of a scene file may be."""

MOST_VALUES = 10**7  # of one axis
MOST_AUTO = 10**7  # steps per period
