"""Corners, penetration and slide against Eqs. (3)-(6) with their half angles."""

from functools import partial

import exact
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import reference
from batch import moving, rates_of, touches
from exact import CASES, CONSISTENT, furthest

from jaxshroud.geometry import corners
from jaxshroud.scene import Shroud
