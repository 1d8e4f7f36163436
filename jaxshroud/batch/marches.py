"""The three marches, and which of them scenes take."""

from operator import attrgetter

from jaxshroud.batch.blocks import PAIR_KERNELS
from jaxshroud.batch.closed_form import closed_form_runs, free_trajectories, no_steps, no_trial
from jaxshroud.batch.flows import PAIR_FLOWS
from jaxshroud.batch.linear_runs import settled_runs
from jaxshroud.batch.march_protocol import March
from jaxshroud.batch.operation_count import size_of_pair_trial, size_of_row_trial
from jaxshroud.batch.pair_samples import balance_of_pairs, motions_of_pairs, sampled_pairs
from jaxshroud.batch.periods import begin_lanes, pair_sample
from jaxshroud.batch.pure_functions import PURE_PAIRS, PURE_ROWS
from jaxshroud.batch.row_samples import motions_of_rows, sampled_rows
from jaxshroud.batch.rows import ROW_FLOWS, ROW_KERNELS, balance_of_rows, begin_rows, row_sample
from jaxshroud.batch.stepped_runs import stepped_runs, stepped_trajectories
from jaxshroud.linear.held_contact import is_linear
from jaxshroud.march.method import Choices
from jaxshroud.march.stepper import POWER_SERIES, RUNGE_KUTTA, stepper_for
from jaxshroud.model.prepared import law_type
from jaxshroud.model.spring_contact import NoContact
from jaxshroud.scene.checks import InputError
from jaxshroud.scene.layout import COUPLED_WITHOUT_CONTACT, LIMITED, PAIR, require_steps
from jaxshroud.scene.scene import Scene

PAIRS = March(
    begin=begin_lanes,
    kernels=PAIR_KERNELS,
    sample=pair_sample,
    run=stepped_runs,
    trajectories=stepped_trajectories,
    sampled=sampled_pairs,
    motions=motions_of_pairs,
    balance=balance_of_pairs,
    flows=PAIR_FLOWS,
    pure=PURE_PAIRS,
    trial_size=size_of_pair_trial,
    stepping=attrgetter("tableau"),
    knows=lambda law: law is not NoContact,
    steppers=(RUNGE_KUTTA, POWER_SERIES),
)
ROWS = March(
    begin=begin_rows,
    kernels=ROW_KERNELS,
    sample=row_sample,
    run=stepped_runs,
    trajectories=stepped_trajectories,
    sampled=sampled_rows,
    motions=motions_of_rows,
    balance=balance_of_rows,
    flows=ROW_FLOWS,
    pure=PURE_ROWS,
    trial_size=size_of_row_trial,
    stepping=attrgetter("tableau"),
    knows=lambda law: law.marches_in_rows,
    steppers=(RUNGE_KUTTA,),
)
# Blades that never touch have a closed form; where tangents or motions alone are wanted, they are marched as pairs.
WITHOUT_CONTACT = PAIRS._replace(
    run=closed_form_runs,
    trajectories=free_trajectories,
    trial_size=no_trial,
    stepping=no_steps,
    knows=lambda law: law is NoContact,
)
# Contact that is asked to stay in one state has a closed form too, of its settled motion.
LINEAR_PAIRS = PAIRS._replace(run=settled_runs, trial_size=no_trial, stepping=no_steps)
LINEAR_ROWS = ROWS._replace(run=settled_runs, trial_size=no_trial, stepping=no_steps)


def march_of(scenes: Scene) -> March:
    """The march of scenes, by their layout and their contact."""
    if is_linear(scenes):
        return LINEAR_PAIRS if scenes.layout == PAIR else LINEAR_ROWS
    if scenes.layout != PAIR:
        return ROWS
    return WITHOUT_CONTACT if scenes.parts.contact == "none" else PAIRS


def require_march(scenes: Scene, method: Choices) -> None:
    """Raise InputError unless the march of scenes and the stepper of the method know their contact and each other."""
    require_steps(scenes.parts.contact)
    march, stepper, law = march_of(scenes), stepper_for(method), law_type(scenes)
    if march is not ROWS and scenes.blade_matrices is not None:
        raise InputError("Blades with matrices march in rows so far: the pair's kernels know lumped blades.")
    if scenes.is_coupled and law is NoContact:
        raise InputError(COUPLED_WITHOUT_CONTACT)
    if not march.knows(law):
        raise InputError(LIMITED[f'`parts.contact` = "{scenes.parts.contact}"'].refusal())
    if stepper not in march.steppers:
        raise InputError(LIMITED["the method taylor"].refusal("The method taylor"))
    if not stepper.knows(law):
        raise InputError(f"The method taylor knows located contact, not {law.called}; take a Runge-Kutta method.")
