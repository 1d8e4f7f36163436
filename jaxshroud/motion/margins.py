"""How far an orbit is from grazing."""

from typing import NamedTuple

import numpy as np

from jaxshroud.batch.runs import Plan, run_lanes
from jaxshroud.batch.xla import alone
from jaxshroud.model.absent import filled
from jaxshroud.motion.orbit import Cycle


class Margins(NamedTuple):
    """How far an orbit is from grazing, where its derivatives would be infinite."""

    counters: dict[str, int]  # events on the orbit
    slowest_onset: float  # closing speed at the gentlest onset, over the largest on the orbit; NaN without contact
    nearest_miss: float  # least distance that the corners come to without touching [m]; NaN where there is none


def contact_margins(found: Cycle) -> Margins:
    """Grazing margins of an orbit, from its onsets and from between the ends of its steps."""
    method = found.method._replace(ledger=False, within=True)
    plan = Plan(0, found.q, found.steps_per_period, 0.0, method)
    log = run_lanes(alone(found.scene), alone(found.start), plan, lambda _: None).last.tally.log
    counters = {name: int(n[0]) for name, n in vars(filled(log.counters, log.time_apart)).items()}
    fastest, gentlest, miss = (float(a[0]) for a in log.within[1:])
    slowest = gentlest / fastest if np.isfinite(gentlest) else np.nan
    return Margins(counters, slowest, miss if np.isfinite(miss) else np.nan)
