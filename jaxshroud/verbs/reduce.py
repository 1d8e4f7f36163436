"""The table of the modes of a blade, from the matrices of its finite elements or from shapes of a solver or a test."""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from jaxshroud.io.finite_element import Unknown, unknown_of
from jaxshroud.linear.reduction import (
    Reduced,
    ShroudFit,
    frame_of,
    growth_with_speed,
    lowest_modes,
    real_shapes,
    reduced,
    require_memory,
    rigid_motions,
    shroud_fit,
    stiffness_factor,
    stuck_frequencies,
    symmetric,
)
from jaxshroud.scene.checks import InputError, count_argument, word_argument
from jaxshroud.scene.keys import MAX_MODES
from jaxshroud.scene.layout import COORDINATES
from jaxshroud.scene.mode_table import NOTES, highest_rigid
from jaxshroud.scene.modes import SHAPES, ModalBlades, modal_blades
from jaxshroud.scene.typed import FloatArray, typed
from jaxshroud.whole_file import write_whole

Units = Literal["si", "mm-t-s", "mm-kg-s"]
LENGTH_AND_MASS: dict[str, tuple[float, float]] = {"si": (1.0, 1.0), "mm-t-s": (1e-3, 1e3), "mm-kg-s": (1e-3, 1.0)}
USUAL_FREQUENCIES = (1.0, 1e5)  # of the first mode of a blade [Hz], beyond which units are doubted
USUAL_SIZES = (1e-3, 1.0)  # of a shroud [m], likewise
LARGE_MISFIT = 0.05  # of a mode's motion of the shroud, beyond which that is hardly rigid


@dataclass(frozen=True)
class ReducedBlade:
    """The modes of a blade, residual vectors last, in SI units."""

    f: FloatArray  # (n,) natural frequencies [Hz]
    zeta: FloatArray  # (n,) damping ratios
    phi: FloatArray  # (3, n) shapes at the shroud, see `BladeMode`
    kind: tuple[str, ...]  # (n,) "mode" or "residual"
    misfit: FloatArray  # (n,) share of the motion of the shroud's nodes that is not rigid; NaN of residual vectors
    unseen: FloatArray  # (n,) share that is out of the plane
    left_out: FloatArray  # (3,) share of the static flexibility that the modes without residual vectors leave out
    notes: tuple[str, ...]
    B: FloatArray | None = None  # (n,) growth of omega^2 with the square of the speed
    kappa: FloatArray | None = None  # (n,) coupling with the same mode of neighbours [1/s^2]

    def blades(self, count: int = 2) -> ModalBlades:
        """So many alike blades of these modes: a pair, or those of a ring."""
        kappa = None if self.kappa is None else np.tile(self.kappa[:, None], count) if count > 2 else self.kappa
        return modal_blades(self.f, self.zeta, self.phi, blades=count, B=self.B, kappa=kappa)

    def in_ring(self, diameters: ArrayLike, f: ArrayLike, blades: int) -> "ReducedBlade":
        """The blade on the disk of a ring, by the frequencies of each family of modes over nodal diameters.

        Args:
            diameters: The nodal diameters (m,).
            f: The frequencies of the family of each mode there (m, modes) [Hz].
            blades: The number of blades of the ring.

        Raises:
            InputError: There are not as many families as modes, nodal diameters do not determine both numbers, a
                frequency is not above 0, or the ring has fewer than three blades.

        Source:
            (2 pi f)^2 = omega^2 + 4 kappa sin^2(pi h / N), by least squares. Residual vectors are not coupled.
        """
        count_argument("blades", blades, 3)
        swept = 4 * np.sin(math.pi * np.asarray(diameters, float) / blades) ** 2
        squares = (math.tau * np.asarray(f, float)) ** 2
        kept = self.kind.count("mode")
        by = np.stack([np.ones_like(swept), swept], axis=-1)
        sound = np.all(squares > 0) and np.isfinite(swept).all()
        if squares.shape != (len(by), kept) or not sound or np.linalg.matrix_rank(by) < 2:
            raise InputError(
                f"{kept} modes need the frequencies, above 0, of as many families at two nodal diameters or more, "
                f"but the shape of these is {squares.shape}."
            )
        fitted = np.linalg.lstsq(by, squares)[0]
        worst = np.max(np.abs(np.sqrt(np.maximum(by @ fitted, 0.0) / squares) - 1))
        return replace(
            self,
            f=np.concatenate([np.sqrt(np.maximum(fitted[0], 0.0)) / math.tau, self.f[kept:]]),
            kappa=np.concatenate([fitted[1], 0 * self.f[kept:]]),
            notes=(*self.notes, f"One kappa a mode meets frequencies over nodal diameters to {100 * worst:.2g} %."),
        )

    def _lines(self, text: Callable[[float], str]) -> list[Iterable[str]]:
        """The head of the table and a line of each mode, with the text of a number."""
        phi = dict(zip(SHAPES, self.phi, strict=True))
        numbers = {"f [Hz]": self.f, "zeta": self.zeta, **phi, "B": self.B, "kappa": self.kappa}
        columns: dict[str, Sequence[str]] = {
            name: [*map(text, a.tolist())] for name, a in numbers.items() if a is not None
        }
        columns["kind"] = self.kind
        for name in NOTES:
            columns[name] = ["" if math.isnan(x) else f"{x:.3g}" for x in getattr(self, name)]
        return [columns, *zip(*columns.values(), strict=True)]

    @property
    def csv(self) -> str:
        """The table, as `[blades] modes` names it."""
        return "".join(f"{','.join(line)}\n" for line in self._lines(repr))

    def save(self, path: str | Path) -> None:
        """Write the table."""
        write_whole(Path(path), self.csv.encode())

    def __str__(self) -> str:
        """The modes in a table, and what is to be said of them."""
        lines = ("".join(f"{cell:>12}" for cell in line) for line in self._lines("{:.5g}".format))
        return "\n".join([*lines, *self.notes])


@typed
def reduce(
    K: Any,
    M: Any,
    *,
    C: Any = None,
    dofs: Sequence[str],
    nodes: Mapping[str, ArrayLike],
    shroud: Sequence[str],
    fixed: Sequence[str] = (),
    origin: Sequence[float] | None = None,
    x_axis: Sequence[float] = (1.0, 0.0, 0.0),
    y_axis: Sequence[float] = (0.0, 1.0, 0.0),
    n_modes: int = 6,
    zeta: float = 0.0,
    residuals: bool = True,
    residual_frequency: float | None = None,
    contact_stiffness: float | None = None,
    K_at_speed: Any = None,
    speed: float = 0.0,
    units: Units = "si",
) -> ReducedBlade:
    """The modes of a blade, with residual vectors, from the matrices of its finite elements.

    Residual vectors are up to three further modes, which carry what the modes leave out of the flexibility of the
    shroud: with them a static force on it bends the blade as all finite elements do.

    Args:
        K: The stiffness, dense or sparse, of all unknowns or of those that are not held; one triangle is enough.
        M: The mass, likewise; it may be singular.
        C: The damping, likewise; None: `zeta` for all modes.
        dofs: What each row is: "node.direction", with directions 1 to 3 along x, y and z of the model and 4 to 6 for
            turns about them.
        nodes: Coordinates (3,) of nodes by their labels; those of the shroud at least. With them may stand (9,) the x
            and the y axis of a node whose unknowns are not along those of the model.
        shroud: The labels of the shroud's nodes. Its motion is the rigid one that fits them best.
        fixed: Nodes, or unknowns such as "12.3", that are held.
        origin: The centre of the shroud; by default the mean of its nodes.
        x_axis: The direction along l_oa in the model's coordinates.
        y_axis: The direction of y; theta is a clockwise turn in the plane of both.
        n_modes: How many modes are kept.
        zeta: Damping ratio of all modes where there is no C.
        residuals: Whether residual vectors are added.
        residual_frequency: The frequency [Hz] that residual vectors above it are given, with the same flexibility; by
            default eight times that of the highest mode, and `inf` keeps their own.
        contact_stiffness: That of contact [N/m]; residual vectors of less than 1 % of its flexibility are left out.
        K_at_speed: The stiffness at a speed of the rotor, from which `B` follows by pairs of modes that are alike.
        speed: That speed [rad/s].
        units: Of the model: "si", "mm-t-s" (N and mm), or "mm-kg-s".

    Returns:
        The modes, in SI units. `save` writes the table that `[blades] modes` of a scene names.

    Raises:
        InputError: A matrix is not symmetric, K is singular or indefinite, a mode is damped above critical, the nodes
            do not determine how the shroud moves, or the unknowns do not fit into the memory.

    Source:
        R = K^-1 B - Phi diag(1 / omega^2) Phi' B, and the eigenvectors of (R' K R, R' M R) times R.
    """
    unknowns, nodes = _unknowns_and_nodes(dofs, nodes, n_modes, units)
    length, mass = LENGTH_AND_MASS[units]
    if K_at_speed is not None and not speed > 0:
        raise InputError("`K_at_speed` needs its `speed`, above 0.")
    matrices = _matrices(len(unknowns), K=K, M=M, C=C, K_at_speed=K_at_speed)
    require_memory(len(unknowns))
    free = _free_unknowns(unknowns, fixed)
    matrices = {name: matrix[free][:, free] for name, matrix in matrices.items()}
    inertia, damping, running = (matrices.get(name) for name in ("M", "C", "K_at_speed"))
    unknowns = [unknowns[i] for i in free]
    fit, rigid = _shroud_and_rigid(unknowns, nodes, shroud, origin, frame_of(x_axis, y_axis))
    factor = stiffness_factor(matrices["K"], rigid)
    omega, shapes = lowest_modes(factor, inertia, n_modes)
    highest = omega[n_modes - 1] / math.tau
    if residual_frequency is not None and not residual_frequency > highest:
        raise InputError(f"`residual_frequency` must be above that of the highest mode, {highest:.5g} Hz.")
    B = fit.plane_forces(len(unknowns))
    K_inverse_B = factor.solve(B)
    least = 0.01 * mass / contact_stiffness if contact_stiffness else 0.0
    found, more = (
        reduced(
            inertia,
            damping,
            B,
            K_inverse_B,
            omega=omega[:count],
            shapes=shapes[:, :count],
            zeta=zeta,
            limit=None if residual_frequency is None else math.tau * residual_frequency,
            least=(least if residuals else np.inf) * np.array([1.0, 1.0, fit.length**-2]),
        )
        for count in (n_modes, len(omega))
    )
    blade = _in_si(found, fit, length, mass)
    blade = replace(blade, notes=(*blade.notes, *_notes_on_more(found, more)))
    if running is None:
        return blade
    at_speed = lowest_modes(stiffness_factor(running, rigid), inertia, n_modes)
    growth = growth_with_speed(inertia, (found.omega[:n_modes], found.shapes), at_speed, speed)
    return replace(blade, B=np.concatenate([growth, np.zeros(len(blade.f) - n_modes)]))


@typed
def reduce_shapes(
    f: ArrayLike,
    zeta: ArrayLike | float,
    phi: Any,
    *,
    dofs: Sequence[str],
    nodes: Mapping[str, ArrayLike],
    shroud: Sequence[str],
    mass: ArrayLike | float = 1.0,
    M: Any = None,
    residual: Any = False,
    origin: Sequence[float] | None = None,
    x_axis: Sequence[float] = (1.0, 0.0, 0.0),
    y_axis: Sequence[float] = (0.0, 1.0, 0.0),
    n_modes: int = 6,
    least_collinearity: float = 0.8,
    units: Units = "si",
) -> ReducedBlade:
    """The modes of a blade from the shapes of a solver or of a test.

    Complex shapes are turned by the phase that makes their real part largest, which is kept. Unknowns that move in no
    mode count as not measured.

    Args:
        f: Natural frequencies (n,) [Hz]; those below 1e-3 of the next one are rigid motions, 0.
        zeta: Damping ratios (n,), or one for all.
        phi: Shapes (unknowns, n), real or complex.
        dofs: What each row of `phi` is, see `reduce`, as are the arguments that are not named here.
        nodes: Coordinates of nodes by their labels.
        shroud: The labels of the shroud's nodes.
        mass: Modal masses (n,), by whose roots shapes are divided; 1: they are mass-normalised.
        M: The mass, by which it is checked that shapes are mass-normalised.
        residual: Whether a shape is a residual vector (n,), which is no mode: it is kept beside `n_modes`.
        origin: The centre of the shroud.
        x_axis: The direction along l_oa.
        y_axis: The direction of y.
        n_modes: How many modes are kept, the lowest.
        least_collinearity: The least |sum phi^2| / sum |phi|^2 of a kept shape, which is 1 of a real one.
        units: Of places and shapes.

    Raises:
        InputError: Arrays are not of the same modes, a kept shape is too complex or not mass-normalised, or a kept mode
            damped above critical.
    """
    unknowns, nodes = _unknowns_and_nodes(dofs, nodes, n_modes, units)
    shapes = np.asarray(phi, complex)
    numbers = [np.ravel(np.asarray(a, float)) for a in (f, zeta, mass, residual)]
    count = shapes.shape[-1]
    if shapes.shape != (len(unknowns), count) or not {a.size for a in numbers} <= {1, count}:
        raise InputError(
            f"`phi` has the shape {shapes.shape}, but must have {len(unknowns)} rows, as `dofs`, and as many columns "
            "as there are `f`, `zeta`, `mass` and `residual`."
        )
    own_f, own_zeta, masses, added = (np.full(count, a) for a in numbers)
    if not (np.isfinite([shapes.sum(), own_f.sum()]).all() and masses.min() > 0):
        raise InputError("Shapes and frequencies must be finite, and modal masses above 0.")
    own_f[np.abs(own_f) <= highest_rigid(own_f[added == 0])] = 0.0
    _refuse(own_f < 0, own_f, "has a negative omega^2: its blade is unstable, or the stiffness has a wrong sign")
    order = np.lexsort((own_f, added))
    kept = order[(np.arange(len(order)) < n_modes) | (added[order] > 0)]
    own_f = own_f[kept]
    shapes = shapes[:, kept] / np.sqrt(masses[kept])
    for matrix in _matrices(len(unknowns), M=M).values():
        modal = np.sum(shapes.conj() * (matrix @ shapes), axis=0)
        _refuse(np.abs(modal - 1) > 1e-3, own_f, "is not mass-normalised by M; give its modal mass, `mass`")
    measured = np.any(shapes != 0, axis=1)
    shapes, collinear = real_shapes(shapes[measured])
    worst = (
        f"is no real mode: the least collinearity is {min(collinear):.3g}; keep fewer, or lower `least_collinearity`"
    )
    _refuse(collinear < least_collinearity, own_f, worst)
    unknowns = [one for one, told in zip(unknowns, measured, strict=True) if told]
    fit, _ = _shroud_and_rigid(unknowns, nodes, shroud, origin, frame_of(x_axis, y_axis))
    omega = math.tau * own_f
    found = Reduced(
        omega=omega,
        zeta=own_zeta[kept],
        shapes=shapes,
        at_shroud=fit.plane_forces(len(unknowns)).T @ shapes,
        residual=added[kept] > 0,
        left_out=np.full(3, np.nan),
        own_omega=omega,
    )
    blade = _in_si(found, fit, *LENGTH_AND_MASS[units])
    told = ", ".join(f"{a:.3f}" for a in collinear)
    return replace(blade, notes=(*blade.notes, f"Collinearity of the shapes (1: real): {told}."))


def _unknowns_and_nodes(
    dofs: Sequence[str], nodes: Mapping[str, ArrayLike], n_modes: int, units: Units
) -> tuple[list[Unknown], dict[str, FloatArray]]:
    """What rows are and where nodes are, of arguments that are checked."""
    word_argument("units", units, Units)
    count_argument("n_modes", n_modes, 1)
    return [*map(unknown_of, dofs)], {str(node): np.asarray(place, float) for node, place in nodes.items()}


def _matrices(rows: int, **given: Any) -> dict[str, Any]:
    """Symmetric matrices of so many rows, without those that are None."""
    found = {name: symmetric(a, name) for name, a in given.items() if a is not None}
    for name, matrix in found.items():
        if matrix.shape[0] != rows:
            raise InputError(f"{name} has {matrix.shape[0]} rows, but `dofs` names {rows} unknowns.")
    return found


def _refuse(bad: Any, f: FloatArray, words: str) -> None:
    """Raise an InputError that names the first bad mode, if there is any."""
    if np.any(bad):
        j = int(np.argmax(bad))
        raise InputError(f"Mode {j} at {f[j]:.6g} Hz {words}.")


def _free_unknowns(unknowns: Sequence[Unknown], fixed: Sequence[str]) -> np.ndarray:
    """The places of the unknowns that are not held."""
    held = {*map(str, fixed)}
    named = {one.node for one in unknowns} | {str(one) for one in unknowns}
    if unknown := sorted(held - named):
        raise InputError(f"`fixed` names {unknown[0]}, but no row of the matrices is of it.")
    return np.array([i for i, one in enumerate(unknowns) if not {one.node, str(one)} & held])


def _shroud_and_rigid(
    unknowns: Sequence[Unknown],
    nodes: Mapping[str, FloatArray],
    shroud: Sequence[str],
    origin: Sequence[float] | None,
    axes: FloatArray,
) -> tuple[ShroudFit, FloatArray]:
    """The fit of the shroud's nodes, and what rigid motions about its centre make of all unknowns."""
    wanted = {*map(str, shroud)}
    if not wanted:
        raise InputError("Argument `shroud` must name the nodes of the shroud, at least three not on one line.")
    if lost := sorted(wanted - {one.node for one in unknowns}):
        raise InputError(f"`shroud` names node {lost[0]}, but no free row of the matrices is of it.")
    if lost := sorted(wanted - set(nodes)):
        raise InputError(f"Node {lost[0]} of the shroud has no coordinates in `nodes`.")
    mean = np.mean([nodes[node][:3] for node in wanted], axis=0)
    rigid, arms = rigid_motions(unknowns, nodes, mean if origin is None else np.asarray(origin), axes)
    own = np.array([i for i, one in enumerate(unknowns) if one.node in wanted])
    turns = np.array([unknowns[i].direction > 3 for i in own])
    return shroud_fit(own, rigid[own], turns, arms[own]), rigid


def _in_si(found: Reduced, fit: ShroudFit, length: float, mass: float) -> ReducedBlade:
    """The modes in SI units, with what is to be said of them."""
    f = found.omega / math.tau
    zeta = found.zeta
    words = f"is damped above critical, or driven (zeta from {min(zeta):.3g} to {max(zeta):.3g}); keep fewer"
    _refuse(~((zeta >= 0) & (zeta <= 1)), f, words)
    if len(f) > MAX_MODES:
        raise InputError(f"There are {len(f)} modes with residual vectors, but at most {MAX_MODES}; keep fewer.")
    none = np.full(len(f) - found.shapes.shape[1], np.nan)
    misfit, unseen = (np.concatenate([a, none]) for a in fit.shares(found.shapes))
    scale = np.sqrt(mass) * np.array([1.0, 1.0, length])[:, None]
    blade = ReducedBlade(
        f=f,
        zeta=zeta,
        phi=found.at_shroud / scale,
        kind=tuple("residual" if one else "mode" for one in found.residual),
        misfit=misfit,
        unseen=unseen,
        left_out=found.left_out,
        notes=(),
    )
    return replace(blade, notes=tuple(_notes_on(blade, found, fit.length * length)))


def _notes_on(blade: ReducedBlade, found: Reduced, size: float) -> Iterator[str]:
    if np.isnan(blade.left_out).all():
        yield "What the shapes leave out of the shroud's static flexibility is not known."
    else:
        carried = "which the residual vectors carry" if found.residual.any() else "which nothing carries"
        yield f"The modes leave out {_shares(found)} of the shroud's static flexibility, {carried}."
    own = found.own_omega / math.tau
    for j in np.flatnonzero(own > blade.f * (1 + 1e-9)):
        told = f"{own[j]:.4g} Hz" if own[j] < 1e30 else "that of no mass"
        yield f"Residual vector {j} has {blade.f[j]:.4g} Hz in the place of {told}: fewer steps, the same flexibility."
    if len(bent := np.flatnonzero(np.nan_to_num(blade.misfit) > LARGE_MISFIT)):
        most = 100 * np.max(blade.misfit[bent])
        which = ", ".join(map(str, bent))
        yield f"Up to {most:.2g} % of the motion of the shroud's nodes is not rigid, in modes {which}."
    low, high = USUAL_FREQUENCIES
    elastic = blade.f[blade.f > 0]
    if len(elastic) and not low <= elastic[0] <= high:
        yield f"A blade whose first mode is at {elastic[0]:.3g} Hz rings absurdly: are the units right?"
    low, high = USUAL_SIZES
    if not low <= size <= high:
        yield f"Nodes of a shroud at {size:.3g} m from its centre are absurd: are the units right?"


def _shares(of: Reduced) -> str:
    return ", ".join(f"{100 * a:.3g} % along {name}" for name, a in zip(COORDINATES, of.left_out, strict=True))


def _notes_on_more(found: Reduced, more: Reduced) -> Iterator[str]:
    """What one more mode would change, of stuck frequencies those up to that of the highest mode that is kept."""
    count = found.shapes.shape[1]
    if more.shapes.shape[1] > count:
        springs = 10 / np.sum((more.at_shroud / more.omega) ** 2, axis=1)
        now, then = (stuck_frequencies(one, springs) for one in (found, more))
        told = max(1, np.sum(then <= found.omega[count - 1]))
        change = 100 * np.max(np.abs(now[:told] / then[:told] - 1))
        of = "frequency" if told == 1 else f"{told} frequencies"
        yield (
            f"With one more mode, at {more.omega[count] / math.tau:.4g} Hz, modes leave out {_shares(more)}, "
            f"and on springs of ten times the shroud's stiffness the lowest {of} would change by {change:.2g} %."
        )
