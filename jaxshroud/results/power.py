"""What a convergence of P_d gives."""

from typing import NamedTuple

import numpy as np

from jaxshroud.model.modes import Status


class PowerResult(NamedTuple):
    """P_d of the left blade against the number of averaged periods."""

    n: np.ndarray  # (m,) numbers of periods
    P_d: np.ndarray  # (m,) average over the first n kept periods [%]
    P_d_ci: np.ndarray  # (m,) half width of its 95 % interval [percentage points]; NaN below two batches
    final: dict  # the answer: n, P_d, ci, settled, settling, stable, period_number, P, P_0, status, method and more

    def __repr__(self) -> str:
        end = self.final
        motion = f"period {end['period_number']}" if end["period_number"] else "aperiodic"
        return (
            f"PowerResult: P_d {end['P_d']:.6g} +- {end['ci']:.2g} % over {end['n']} periods, {motion}, "
            f"{'' if end['stable'] else 'not '}stable; {Status(end['status']).name}; {end['method']}"
        )
