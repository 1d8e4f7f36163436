"""Patterns of mistuning: the relative deviations of the stiffnesses of the blades of a row.

An intentional pattern is part of a design: `alternate:A` is A, -A, A, ... and `harmonic:h:A` is A cos(2 pi h i / N) at
blade i. A random pattern is sigma times independent standard normal numbers: the first one of a seed is that of a
scene's `mistuning = { sigma = ..., seed = ... }`.
"""

from collections.abc import Sequence

import numpy as np

from jaxshroud.scene.checks import InputError
from jaxshroud.scene.keys import ROW_KEYS
from jaxshroud.scene.layout import Layout
from jaxshroud.scene.typed import FloatArray
from jaxshroud.scene.valid import check_values

NO_PATTERN = "none"  # the design without intentional mistuning
PATTERN_FORMS = '"none", "alternate:0.02" or "harmonic:3:0.02"'


def design_pattern(text: str, layout: Layout) -> FloatArray:
    """The deviations (N,) of an intentional pattern.

    Raises:
        InputError: There is no such pattern, or it does not fit the row.
    """
    word, *numbers = text.split(":")
    try:
        sizes = [float(number) for number in numbers]
    except ValueError:
        sizes = []
    counts = {NO_PATTERN: 0, "alternate": 1, "harmonic": 2}
    if counts.get(word) != len(numbers) or len(sizes) != len(numbers) or not np.isfinite(sizes).all():
        raise InputError(f"There is no pattern {text!r}: give {PATTERN_FORMS}.")
    blade = np.arange(layout.blades)
    if word == "alternate":
        if layout.closed and layout.blades % 2:
            raise InputError(f"{text!r} does not close in a ring of {layout.blades} blades; their number must be even.")
        return sizes[0] * np.where(blade % 2, -1.0, 1.0)
    if word == "harmonic":
        if sizes[0] != round(sizes[0]) or not 0 <= 2 * sizes[0] <= layout.blades:
            raise InputError(f"{text!r}: the harmonic must be a whole number from 0 to {layout.blades // 2}.")
        return sizes[1] * np.cos(2 * np.pi * sizes[0] * blade / layout.blades)
    return np.zeros(layout.blades)


def random_patterns(count: int, blades: int, seed: int) -> FloatArray:
    """Independent standard normal numbers, (count, blades)."""
    return np.random.default_rng(seed).standard_normal((count, blades))


def mistuned_designs(designs: Sequence[str], sigmas: Sequence[float], drawn: FloatArray, layout: Layout) -> FloatArray:
    """Random patterns about intentional ones, (designs, sigmas, patterns, N).

    Args:
        designs: Intentional patterns, see `design_pattern`.
        sigmas: Standard deviations of the random part.
        drawn: Standard normal numbers (patterns, N): the same for all designs and deviations.
        layout: The layout of the row.

    Raises:
        InputError: There is no such pattern, or a stiffness would not be positive.
    """
    about = np.stack([design_pattern(text, layout) for text in designs])
    patterns = about[:, None, None] + np.asarray(sigmas, float)[None, :, None, None] * drawn
    check_values(ROW_KEYS["row.mistuning"], patterns.ravel(), "the mistuning of a blade")
    return patterns
