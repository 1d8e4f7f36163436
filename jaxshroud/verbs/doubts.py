"""The doubts of a data sheet: numbers that are unlike those of a blade, or beyond what the model describes."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from jaxshroud.batch.xla import one_lane
from jaxshroud.results.data_sheet import MOTION_NAMES, DataSheet, NaturalMode
from jaxshroud.scene.scene import Scene, without_given
from jaxshroud.scene.sector import asks_for_sector, sector_blades
from jaxshroud.verbs.settled import settling_advice, settling_periods

MAX_CORNER_GAPS = 10.0  # displacement of a free block's corner by its moment alone, over the gap
MAX_APPROACH_GAPS = 100.0  # of the free faces: the gap is then 1 % of the motion, and contact lasts as without one
MAX_INERTIA_RATIO = 10.0  # inertia over that of a uniform block of the same mass
OVERDAMPED = 1.0  # damping ratio
# The blocks are rigid, shift on linear springs and touch with whole faces. A tenth of a side at the drive's frequency
# is a bend that blades with such blocks do not take; at resonance, which contact is there to prevent, half a side is.
MAX_AMPLITUDE_SIDES, MAX_RESONANT_SIDES = 0.1, 0.5
MAX_SLIDE_FACES = 0.5  # slide of the free faces over their length: corners then pass the other face's ends
MAX_PARALLEL = 0.1  # displacement of a corner by the free rotation, over the approach of the free faces
MIN_IN_PHASE = 0.95  # share of the motion of free blades that both have: contact works on the rest alone
MAX_PRESSED = 0.1  # displacement of a block by interference alone, over its free amplitude
MAX_ANGLE = np.radians(10.0)  # of a free block; the springs of torsion are linear, and runs end at 45 degrees
MIN_MARGIN = (
    0.05  # of the drive from a natural frequency: computed frequencies of blades are seldom closer to true ones
)
SAME_FREQUENCY = 1e-6  # relative difference of frequencies below which a mode in contact is one of free blades
LEAST_DRIVEN = 1e-3  # share of the drive below which a mode is not excited


def doubts_of(sheet: DataSheet, scene: Scene) -> Iterator[str]:
    """The doubts, one line each, with their numbers and what they mean."""
    yield from _torsion_doubts(sheet, scene)
    yield from _amplitude_doubts(sheet, float(scene.shroud.l_oa))
    yield from _damping_doubts(sheet)
    yield from _flow_doubts(sheet)
    yield from _resonance_doubts(sheet)
    if scene.parts.contact != "none":
        yield from _phase_doubts(sheet)
        yield from _mean_load_doubts(sheet)
        yield from _interference_doubts(sheet)
        yield from _doubts_of_interfaces(sheet, float(scene.shroud.l_ab))


def _torsion_doubts(sheet: DataSheet, scene: Scene) -> Iterator[str]:
    if "theta" not in sheet.coordinates:
        return
    gap = abs(sheet.gap)
    corner = max(sheet.corner)
    angle = max(sheet.coordinates["theta"].amplitude)
    inertia = max(sheet.inertia, key=lambda ratio: abs(np.log(ratio)))
    if scene.parts.contact != "none" and gap and corner > MAX_CORNER_GAPS * gap:
        turned = f"{corner * 1e3:.3g} mm, {corner / gap:.0f} gaps"
        yield f"M_0 turns a free block's corners by {turned}: check the unit of drive.M_0"
    if angle > MAX_ANGLE:
        yield f"M_0 turns a free block by {np.degrees(angle):.3g} degrees: its spring is hardly linear there"
    if not 1 / MAX_INERTIA_RATIO < inertia < MAX_INERTIA_RATIO:
        ratio = f"{inertia:.3g} times that of a uniform block of its mass and sides"
        cure = "check phi_theta and its unit" if scene.mode_numbers else 'I = "block" in a file gives that'
        yield f"I is {ratio}; {cure}"


def advice_on(sheet: DataSheet, scene: Scene) -> Iterator[str]:
    """What may do better, and what a march does not see."""
    yield from _advice_on_points(sheet, scene)
    if asks_for_sector(scene):
        n = sector_blades(scene)
        N = scene.layout.blades
        unseen = f"motions in which blade i + {n} does not move as blade i are not seen, such as localised ones"
        yield f'row.sector = "auto" marches {n} of the {N} blades: {unseen}'
    slow = settling_advice(settling_periods(one_lane(without_given(scene))), scene.parts.contact != "none")
    if slow:
        yield slow


def _advice_on_points(sheet: DataSheet, scene: Scene) -> Iterator[str]:
    """Points for nearly parallel faces of light blocks, where a corner switches from end to end."""
    touches_at_corner = scene.parts.contact == "spring" and scene.contact.points is None
    if not touches_at_corner or "theta" not in sheet.coordinates or max(sheet.inertia) > MAX_INERTIA_RATIO:
        return
    corner, approach = max(sheet.corner), max([sheet.approach, *sheet.approaches])
    if corner < MAX_PARALLEL * approach < np.inf:
        turned = f"M_0 turns corners by {corner * 1e3:.3g} mm where the free faces approach by {approach * 1e3:.3g} mm"
        cure = "[contact] points = 2, or more, lets them touch at both ends"
        yield f"the faces stay nearly parallel, and a single corner switches from end to end: {turned}; {cure}"


def _amplitude_doubts(sheet: DataSheet, side: float) -> Iterator[str]:
    for name, coordinate in sheet.coordinates.items():
        moved, resonant = max(coordinate.amplitude), max(coordinate.resonant)
        if np.isinf(moved):
            yield f"{MOTION_NAMES[name]}, free, is driven at resonance without damping: its amplitude is infinite"
            continue
        if name == "theta" or not (moved > MAX_AMPLITUDE_SIDES * side or MAX_RESONANT_SIDES * side < resonant < np.inf):
            continue
        at_resonance = f", {resonant * 1e3:.3g} mm at resonance" if resonant < np.inf else ""
        reach = f"{moved * 1e3:.3g} mm{at_resonance}, and its side is {side * 1e3:.3g} mm"
        yield f"{MOTION_NAMES[name]}: a free block moves by {reach}: check F_0 and the damping"


def _phase_doubts(sheet: DataSheet) -> Iterator[str]:
    """A pair whose blades move alike, which contact does not feel unless they turn."""
    moved = max(max(sheet.coordinates[name].amplitude) for name in ("x", "y") if name in sheet.coordinates)
    if sheet.in_phase >= MIN_IN_PHASE and max(sheet.corner) < MAX_PARALLEL * moved:
        share = f"{100 * sheet.in_phase:.3g} % of the motion of the free blades is in phase"
        meaning = "blades in phase do not feel each other, so that contact hardly acts, and a pair is no wheel"
        yield f"{share}: {meaning}; give drive.phase, or a table [row] with an engine order"


def _mean_load_doubts(sheet: DataSheet) -> Iterator[str]:
    """Mean loads that part the faces of every interface."""
    reach = sheet.approach + 2 * max(sheet.corner)
    if sheet.static_gaps and min(sheet.static_gaps) > reach:
        opened = f"{min(sheet.static_gaps) * 1e3:.3g} mm, and the free faces approach by {reach * 1e3:.3g} mm"
        yield f"under the mean loads every contact is open: the least gap is {opened}; check their signs"


def _interference_doubts(sheet: DataSheet) -> Iterator[str]:
    """Interference that displaces a block by more than a tenth of its free amplitude."""
    bent = [sheet.coordinates[name].amplitude for name in ("x", "y") if name in sheet.coordinates]
    free = np.sqrt(np.sum(np.square(bent), axis=0))
    pressed = np.array(sheet.pressed)
    beyond = pressed > MAX_PRESSED * free
    if np.any(beyond):
        at = int(np.argmax(np.where(beyond, pressed, 0.0)))
        share = f"{100 * pressed[at] / free[at]:.3g} % of its free amplitude" if free[at] else "which nothing drives"
        yield (
            f"{'mean loads press' if sheet.static_gaps else 'interference alone displaces'} a block "
            f"{'aside ' if sheet.static_gaps else ''}by {pressed[at] * 1e3:.3g} mm, {share}: P_d counts that as "
            "vibration, P_d_vibration does not"
        )


def _flow_doubts(sheet: DataSheet) -> Iterator[str]:
    """Waves that the flow makes grow."""
    growing = [mode for mode in sheet.flow_modes if mode.zeta < 0]
    if growing:
        worst = min(growing, key=lambda mode: mode.zeta)
        where = "" if worst.nodal_diameter is None else f" at nodal diameter {worst.nodal_diameter}"
        count = f"{len(growing)} of {len(sheet.flow_modes)} waves grow without contact"
        yield f"the flow feeds the blades: {count}, the fastest one{where} with a damping ratio of {worst.zeta:.3g}"


def _damping_doubts(sheet: DataSheet) -> Iterator[str]:
    for name, coordinate in sheet.coordinates.items():
        if max(coordinate.zeta) >= OVERDAMPED:
            yield f"{MOTION_NAMES[name]} is overdamped, zeta = {max(coordinate.zeta):.3g}: it creeps instead of ringing"
        if min(coordinate.zeta) == 0:
            yield f"{MOTION_NAMES[name]} has no damping: its transients never end"


def _resonance_doubts(sheet: DataSheet) -> Iterator[str]:
    """The drive is next to a natural frequency of blades apart, or stuck, in a mode that it excites."""
    apart, stuck = (
        [mode for mode in sheet.modes if mode.contact == contact and mode.driven > LEAST_DRIVEN]
        for contact in ("apart", "stuck")
    )

    def is_free(mode):
        return any(np.isclose(mode.frequency, other.frequency, SAME_FREQUENCY, 0) for other in apart)

    for modes in (apart, [mode for mode in stuck if not is_free(mode)]):
        for order in sheet.harmonics:
            name = "the drive" if order == 1 else f"harmonic {order} of the drive"
            yield from _resonance_doubt(name, order * sheet.drive, modes)


def _resonance_doubt(which: str, drive: float, modes: Sequence[NaturalMode]) -> Iterator[str]:
    nearest = min(modes, key=lambda mode: abs(np.log(drive / mode.frequency)), default=None)
    if nearest is None:
        return
    margin = drive / nearest.frequency - 1
    name = f"{nearest.name}, {nearest.contact} ({nearest.frequency:.5g} Hz)"
    if abs(margin) <= nearest.zeta < OVERDAMPED:
        band = f"half-power band, {2 * nearest.zeta:.2g} of the frequency"
        limit = "damping alone limits" if nearest.zeta else "nothing but contact limits"
        yield f"{which} is at the resonance of {name}, within its {band}: {limit} the motion"
    elif abs(margin) < MIN_MARGIN:
        side = "above" if margin > 0 else "below"
        yield f"{which} is {100 * abs(margin):.2g} % {side} {name}: small changes of either decide the motion"


def _doubts_of_interfaces(sheet: DataSheet, face: float) -> Iterator[str]:
    """The doubts on contact: of a pair, or of each interface of a row, once where all have the same."""
    if not sheet.gaps:
        yield from _contact_doubts(sheet, face)
        return
    where: dict[str, list[str]] = {}
    for j, (gap, approach, slide) in enumerate(zip(sheet.gaps, sheet.approaches, sheet.slides, strict=True)):
        corner = sheet.corner[j], sheet.corner[(j + 1) % len(sheet.corner)]
        for text in _contact_doubts(replace(sheet, gap=gap, approach=approach, slide=slide, corner=corner), face):
            where.setdefault(text, []).append(str(j))
    for text, places in where.items():
        yield text if len(places) == len(sheet.gaps) else f"interface {', '.join(places)}: {text}"


def _contact_doubts(sheet: DataSheet, face: float) -> Iterator[str]:
    gap = abs(sheet.gap)
    if gap and MAX_APPROACH_GAPS * gap < sheet.approach < np.inf:
        meaning = "impacts are hard, and last as without a gap"
        yield f"the free faces approach by {sheet.approach / gap:.0f} gaps: {meaning}; check the unit of shroud.gap"
    if MAX_SLIDE_FACES * face < sheet.slide < np.inf:
        slid = f"{sheet.slide * 1e3:.3g} mm, {sheet.slide / face:.2g} of their length"
        yield f"the free faces slide by {slid}: they pass each other's ends, where contact is taken to go on"
    if sheet.static_gaps or any(mode.zeta < 0 for mode in sheet.flow_modes):
        return
    if sheet.gap > sheet.approach + sum(sheet.corner):
        yield "the free blades do not come near enough to touch: contact, if any, comes from the start alone"
