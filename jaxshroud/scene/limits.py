"""How large the numbers of a scene file may be, and what holds where it says nothing."""

MOST_VALUES = 10**7  # of one axis
MOST_AUTO = 10**7  # steps per period
TRANSIENT = 64  # periods discarded where nobody says how many: no average takes in the start-up
