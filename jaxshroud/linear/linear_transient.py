"""What dies out beside a settled linear motion: how fast, and whether contact keeps its state until then, too.

From the static start the way is known in closed form: each number that must stay positive, a gap, a normal force or
what friction has to spare, is a sum of exponentials in time, of what dies out and of the harmonics that stay.
"""

from typing import Any, NamedTuple

import jax
import numpy as np

from jaxshroud.linear.equilibrium import in_pieces, with_float64
from jaxshroud.linear.held_contact import HeldContact, sprung
from jaxshroud.linear.linear_motion import NUMBERS_OF_MOTIONS, LinearMotion, Margins
from jaxshroud.linear.linear_swing import HeldRest, SwingWaves, steady_swings
from jaxshroud.model.linear_system import rate_matrix
from jaxshroud.scene.scene import Scene, without_given
from jaxshroud.scene.typed import FloatArray

ROUNDING = 1e-6  # of the start, to which its modes must sum up, and of the modes of a number
INTERVALS = 64  # in which numbers are looked at together
MOST_STRETCHES = 256  # of as many intervals, by whose end what dies out must be less than what is to spare
MOST_SPLITS = 10  # of an interval


class SumOfModes(NamedTuple):
    """Numbers over time, mean + Re(shares exp(rates t)), of modes that die out or stay as they are."""

    mean: FloatArray  # (numbers,)
    shares: Any  # (numbers, modes) complex
    rates: Any  # (modes,) complex [1/s]
    least: FloatArray  # (numbers,) the least values of the modes that stay and the mean, or less

    def at(self, times: np.ndarray) -> FloatArray:
        """The numbers (numbers, times)."""
        return self.mean[:, None] + np.real(self.shares @ np.exp(self.rates[:, None] * times))

    def later(self, time: float) -> "SumOfModes":
        """The same numbers from a later time on."""
        return self._replace(shares=self.shares * np.exp(self.rates * time))

    @property
    def most_lost(self) -> FloatArray:
        """The most that all that dies out takes from each number, from now on."""
        return np.abs(self.shares[:, self.rates.real < 0]).sum(axis=1)

    @property
    def undecided(self) -> "SumOfModes":
        """The numbers from which all that dies out could still take what is to spare."""
        some = ~(self.most_lost < self.least)  # NaN too
        return self._replace(mean=self.mean[some], shares=self.shares[some], least=self.least[some])


def stays_positive(numbers: SumOfModes) -> bool:
    """Whether numbers are positive at all times from 0 on; it is said of none of which this is not certain.

    They are looked at stretch by stretch until all that dies out cannot take from them what is to spare. Over an
    interval h a number is below the lower one of both ends by max|g''| h^2 / 8 at most, and |g''| is no more than the
    sum of |share| |rate|^2. Where that does not decide the interval is halved.
    """
    numbers = numbers.undecided
    if not len(numbers.mean):
        return True
    bend = np.abs(numbers.shares) @ np.abs(numbers.rates) ** 2
    step = float(np.min(np.sqrt(np.abs(numbers.shares).sum(axis=1) / bend)))
    if len(numbers.later(MOST_STRETCHES * INTERVALS * step).undecided.mean):
        return False
    while len(numbers.mean):
        if not _is_positive(numbers, step):
            return False
        numbers = numbers.later(INTERVALS * step).undecided
    return True


def _is_positive(numbers: SumOfModes, step: float) -> bool:
    """Whether numbers are positive for certain over one stretch from 0 on."""
    size = np.abs(numbers.shares)
    floor = ROUNDING * (np.abs(numbers.mean) + size.sum(axis=1))[:, None]
    bend = (size @ np.abs(numbers.rates) ** 2)[:, None]
    begin = step * np.arange(INTERVALS + 1)
    values = numbers.at(begin)
    begin, low, high = begin[:-1], values[:, :-1], values[:, 1:]
    for _ in range(MOST_SPLITS):
        least = np.minimum(low, high) - floor
        if np.any(least <= 0):
            return False
        doubtful = np.any(least <= bend * step**2 / 8, axis=0)
        if not doubtful.any():
            return True
        step /= 2
        begin, low, high = begin[doubtful], low[:, doubtful], high[:, doubtful]
        middle = numbers.at(begin + step)
        begin = np.concatenate([begin, begin + step])
        low, high = np.hstack([low, middle]), np.hstack([middle, high])
    return False


def outlasts_transient(scenes: Scene, held: HeldContact, motion: LinearMotion) -> bool:
    """Whether all lanes (leading axis) keep their state from the start at rest in the static equilibrium on.

    The blades of the scenes do not turn. It is said of no motion that does not die out.
    """
    rest, waves = _swings(scenes, held)
    count = len(rest.q)
    lanes = np.reshape(scenes.friction.mu, (count, -1, 1)), scenes.drive.omega, rest, waves, held.rigid, motion.margins
    lanes = jax.tree.map(with_float64, lanes)
    numbers = [_from_rest(*jax.tree.map(lambda a, i=i: a[i], lanes)) for i in range(count)]
    certain = [one for one in numbers if one is not None]
    return len(certain) == count and all(map(stays_positive, sorted(certain, key=_doubt, reverse=True)))


def _doubt(numbers: SumOfModes) -> float:
    """How much of what is to spare could be lost at most, by which the lanes that fail soonest are looked at first."""
    return float(np.max(numbers.most_lost / numbers.least, initial=0.0))


def _from_rest(
    mu: FloatArray, omega: float, rest: HeldRest, waves: SwingWaves, free: FloatArray, margins: Margins
) -> SumOfModes | None:
    """The numbers of one lane that must stay positive, from the start on; None where its motion does not die out."""
    eigenvalues, modes = np.linalg.eig(rate_matrix(*rest.matrices))
    size = len(free.T)
    orders = 1j * omega * np.array([*waves], float)
    swing = -1j * np.array([*waves.values()]).reshape(-1, size).T  # each is Im[a exp(i n omega t)]
    start = -np.real(np.concatenate([swing.sum(axis=1), swing @ orders]))
    dying = modes * np.linalg.lstsq(modes, start.astype(complex), rcond=None)[0]
    lost = np.abs(dying.sum(axis=1) - start) > ROUNDING * np.abs(start).max()
    if lost.any() or np.real(eigenvalues).max() >= 0:
        return None

    def flat(number: FloatArray, by: FloatArray, least: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        return number.ravel(), by.reshape(number.size, -1), np.repeat(least, number.shape[1])

    to_spare = [
        flat(mu * rest.N + way * rest.F, mu[..., None] * rest.N_q + way * rest.F_q, margins.slip) for way in (1, -1)
    ]
    pressed, gaps = flat(rest.N, rest.N_q, margins.N), flat(-rest.open_v, -rest.open_v_q, margins.gap)
    mean, by, least = (np.concatenate(a) for a in zip(pressed, *to_spare, gaps, strict=True))
    counts = np.isfinite(least)
    return SumOfModes(
        mean=mean[counts],
        shares=by[counts] @ free @ np.hstack([dying[:size], swing]),
        rates=np.concatenate([eigenvalues, orders]),
        least=least[counts],
    )


def _swings(scenes: Scene, held: HeldContact) -> tuple[HeldRest, SwingWaves]:
    return in_pieces(steady_swings, (without_given(sprung(scenes)), held), NUMBERS_OF_MOTIONS)


def linear_multipliers(scenes: Scene, held: HeldContact) -> np.ndarray:
    """The Floquet multipliers of each linear motion (leading axis), largest first: those of places and rates."""
    rest, _ = _swings(scenes, held)
    period = 2 * np.pi / np.asarray(scenes.drive.omega, float)
    every = []
    for T, *own in zip(period, *rest.matrices, strict=True):
        multipliers = np.exp(T * np.linalg.eigvals(rate_matrix(*own)))
        multipliers = multipliers[np.argsort(-np.abs(multipliers), kind="stable")]
        every.append(np.pad(multipliers, (0, 2 * len(own[0]) - len(multipliers))))
    return np.array(every)
