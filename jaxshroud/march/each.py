"""How a function of one lane is run on many."""

from collections.abc import Callable
from typing import Any

EachLane = Callable[..., Any]  # (f, *args): `f(*args)` of every lane; all arrays have a leading axis of lanes
