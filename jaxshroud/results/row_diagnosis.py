"""The kind of motion that a row of blades settles on."""

from jaxshroud.io.store import JSONValue, json_values
from jaxshroud.io.variable import Attribute, Variable
from jaxshroud.results.trajectory import Trajectory


class RowDiagnosis(Trajectory):
    """A run of settled motion of a row, and the verdict on it.

    The samples are those of the periods that follow the ones that gave the evidence; for a scene that stops they are
    those of its start.
    """

    stored_as = "row_diagnosis"

    verdict = Attribute(str)  # "travelling wave", "period 2", "chaotic", "transient not over", "undecided", "stopped"
    evidence = Attribute(str)  # the verdict with its reasons, a sentence
    period_number = Attribute(int)  # 0 where the motion is not periodic
    periods = Attribute(int)  # that were run before the samples
    largest_exponent = Attribute()  # per drive period, from a nearby run
    largest_exponent_ci = Attribute()
    P_d = Attribute()  # of the row [percent]
    P_d_ci = Attribute()
    P_d_vibration = Attribute()  # of the vibration about the mean position alone [percent]
    P_d_vibration_ci = Attribute()
    P_d_worst = Attribute()  # of the worst blade [percent]
    P = Variable("average power of each blade, Eq. (23)", "m4", ("blade",))
    P_0 = Variable("average power of each blade without contact, closed form", "m4", ("blade",))

    def summary(self) -> dict[str, JSONValue]:
        """Everything but the samples, in plain numbers, as `diagnosis.json` holds it."""
        names = ("verdict", "evidence", "period_number", "periods", "largest_exponent", "largest_exponent_ci")
        of_row = (
            "P_d",
            "P_d_ci",
            "P_d_vibration",
            "P_d_vibration_ci",
            "P_d_worst",
            "P",
            "P_0",
            "x_peak",
            "slip",
            "loss_friction",
            "energy_residual",
        )
        times = ("time_apart", "time_stick", "time_slip")
        numbers = {name: getattr(self, name) for name in (*names, *of_row, *times)}
        wave = self.wave
        waves = {"wave_distance": wave.distance.share, "wave": wave.words}
        waves |= {"participation_ratio": float(self.participation_ratio)}
        how = {"status": self.status, "method": str(self.method), "steps_per_period": self.steps_per_period}
        return json_values({**numbers, **waves, **how, **self.origin})

    @property
    def _repeats(self) -> int:
        return self.period_number

    def __repr__(self) -> str:
        return f"RowDiagnosis: {self.evidence}"
