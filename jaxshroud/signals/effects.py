"""Numbers with the digits that their intervals justify, and effects: derivatives per 1 % of each number."""

import math
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

from jaxshroud.scene.keys import parse_key
from jaxshroud.signals.period import MIN_APERIODIC_PERIODS

TOLD_DIFFERENCE = 1.0  # percentage points: where P_d and P_d_vibration differ by more, both are given
ROUND_PERIODS = 16  # multiples of which are advised
NEGLIGIBLE_WIDTH = 1e-6  # over the number: a smaller half width is rounding
EXACT_DIGITS = 6  # digits of an exact number
FLAT_QUANTILES = (0.05, 0.95)  # between which P_d moves: single windows do not count
NOT_RESOLVED, STUCK_SLIDER = "not resolved", "in permanent stick"  # what is said of Lyapunov exponents
PLAIN_POWERS = (-4, 7)  # powers of ten without an exponent


def with_interval(value: float | None, half: float | None, unit: str = "") -> str:
    """A number with the half width of its interval: two digits of the width, and as many decimals of the number.

    Args:
        value: The number; None, as summaries have it, like NaN where it is unknown.
        half: Half width of its interval; likewise where it is unknown, 0 where the number is exact.
        unit: Of both; the half width of a percentage is in percentage points.
    """
    value, half = (math.nan if number is None else number for number in (value, half))
    is_known = math.isfinite(value) and math.isfinite(half)
    if not is_known or half <= NEGLIGIBLE_WIDTH * abs(value):
        text = f"{value:.{EXACT_DIGITS}g}{_with_unit(unit)}"
        return f"{text} (interval unknown)" if math.isfinite(value) and not is_known else text
    power, decimals = _power_and_decimals(value, half)
    number, width = (_fixed(x, power, decimals) for x in (value, half))
    if unit == "%":
        return f"{number} % +- {width} percentage points"
    return f"{number} +- {width}{_with_unit(unit)}"


def exponent_text(value: float, half: float, stuck: bool) -> str:
    """A Lyapunov exponent with its interval, or what it is if it has none.

    Args:
        value: The exponent; -inf, or NaN where rounding hides it.
        half: Half width of its interval; NaN where there is none.
        stuck: Whether an exponent of exactly 0 is that of a slider which sticks for good.
    """
    if stuck and value == 0:
        return f"0 (slider {STUCK_SLIDER})"
    return NOT_RESOLVED if math.isnan(value) else with_interval(value, half)


def between(value: float | None, low: float | None, high: float | None) -> str:
    """A number with the ends of its interval, all with as many decimals as two digits of the half width have.

    None, as summaries have it, is an unknown number.
    """
    value, low, high = (math.nan if number is None else number for number in (value, low, high))
    half = (high - low) / 2
    if not (math.isfinite(half) and half > 0):
        return f"{value:.{EXACT_DIGITS}g} ({low:.{EXACT_DIGITS}g} to {high:.{EXACT_DIGITS}g})"
    power, decimals = _power_and_decimals(value, half)
    number, *ends = (_fixed(x, power, decimals) for x in (value, low, high))
    return f"{number} ({' to '.join(ends)})"


def _with_unit(unit: str) -> str:
    return f" {unit}" if unit else ""


def _power_and_decimals(value: float, half: float) -> tuple[int, int]:
    """The common power of ten, and the decimals that two digits of the half width need."""
    last = math.floor(math.log10(float(f"{half:.1e}"))) - 1
    largest = math.floor(math.log10(max(abs(value), half)))
    power = 0 if PLAIN_POWERS[0] <= largest < PLAIN_POWERS[1] else largest
    return power, power - last


def _fixed(number: float, power: int, decimals: int) -> str:
    digits = f"{round(number / 10.0**power, decimals):.{max(decimals, 0)}f}"
    return f"{digits}e{power:+03d}" if power else digits


def flat_text(values: np.ndarray, half_widths: np.ndarray) -> str:
    """What to say of P_d that moves less than its intervals do over the range requested; empty where it moves more.

    Args:
        values: P_d at any number of places [percent]; those that are not finite do not count.
        half_widths: Of their 95 % intervals.
    """
    known = np.isfinite(values) & np.isfinite(half_widths)
    if known.sum() < 2:
        return ""
    low, high = np.quantile(values[known], FLAT_QUANTILES)
    width = float(np.sqrt(np.mean(half_widths[known] ** 2)))
    if high - low > 2 * width:
        return ""
    moves = f"nine values of P_d in ten are within {high - low:.2g} percentage points"
    return f"{moves}, less than the intervals of +- {width:.2g}: over this range it cannot be told from a constant"


def too_few_periods_text(unjudged: int, lanes: str, needed: float = MIN_APERIODIC_PERIODS) -> str:
    """What to say where so many `lanes` keep too few periods to judge an aperiodic motion; empty where none do.

    So many periods are `needed` at least.
    """
    if not unjudged:
        return ""
    keep = math.ceil(needed / ROUND_PERIODS) * ROUND_PERIODS
    advice = f"keep at least {keep} (--periods {keep})"
    return f"{unjudged} {lanes}: too few periods to judge an aperiodic motion; {advice}"


class Effect(NamedTuple):
    """The effect of one number of a scene on P_d [percentage points] or on P [m^4]."""

    key: str
    number: float  # [SI]
    per: str  # the change of the number
    change: float
    ci: float  # half width of the 95 % interval

    @property
    def cells(self) -> list[str]:
        """A row of a table: the key, the value in SI units, its change, and the effect."""
        return [self.key, f"{self.number:.6g}", self.per, with_interval(self.change, self.ci)]


def effect_step(key: str, number: float) -> tuple[float, str]:
    """The change of a number for which its effect is stated, in SI units and in words.

    It is 1 % of the number; 1 degree for angles; 0.01 of a mistuning, which is 1 % of the stiffnesses; and for a number
    that is 0 one unit of the pictures.
    """
    row, _ = parse_key(key)
    unit, per_si = row.shown
    if row.unit == "rad":
        return math.pi / 180, "1°"
    if row.name == "row.mistuning":
        return 0.01, "0.01"
    if number == 0:
        return 1 / per_si, f"1 {unit}".strip()
    return abs(number) / 100, "1 %"


def effects(value: Mapping[str, float], ci: Mapping[str, float], number: Mapping[str, float]) -> list[Effect]:
    """The effects of numbers from derivatives in SI units, the largest first and NaN last."""
    results = []
    for key, level in number.items():
        step, per = effect_step(key, level)
        results.append(Effect(key, level, per, value[key] * step, ci[key] * step))
    return sorted(results, key=lambda e: -abs(e.change) if math.isfinite(e.change) else math.inf)


def mean_shift_text(
    P_d: Any,
    P_d_vibration: Any,
    counted: str = "P_d",
    option: str = "",
    place: Callable[[int], str] = "run {}".format,
) -> str:
    """One sentence where contact shifts the mean position, which P_d counts as vibration; else empty.

    Args:
        P_d: By Eq. (22), of one run or of many [%].
        P_d_vibration: About the mean position [%]; None where it is not known.
        counted: Which of them counted: "P_d", "P_d_worst" or "P_d_vibration".
        option: The option that chooses it, with a blank; empty where there is none.
        place: Of many runs, where the one of an index is, in words.
    """
    if P_d_vibration is None:
        return ""
    with_shift, alone = (np.ravel(np.asarray(a, float)) for a in (P_d, P_d_vibration))
    apart = np.nan_to_num(np.abs(with_shift - alone), nan=0.0)
    at = int(np.argmax(apart))
    if apart[at] <= TOLD_DIFFERENCE:
        return ""
    where = f" (the largest difference, {place(at)})" if len(apart) > 1 else ""
    change = f"{'is reduced' if alone[at] >= 0 else 'grows'} by {abs(alone[at]):.1f} %"
    advice = "P_d_vibration counted" if counted == "P_d_vibration" else f"{option}P_d_vibration counts that"
    return (
        f"contact also shifts the mean position, which P_d counts as vibration: {with_shift[at]:.1f} % where "
        f"vibration alone {change}{where}; {advice}"
    )
