"""The modes of a blade from the matrices of its finite elements, and what they leave out of its shroud's flexibility.

    K Phi = M Phi diag(omega^2),    Phi' M Phi = 1,    R = K^-1 B - Phi diag(1 / omega^2) Phi' B

The forces on the shroud act on the unknowns by B, whose transpose makes of these the motion of the shroud. What the
modes Phi leave out of the flexibility B' K^-1 B is A = R' K R = B' R; the pair (A, R' M R) has at most three residual
vectors, which are modes like all others: statics at the shroud are exact with them.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from jaxshroud.model.linear_system import spring_stiffness
from jaxshroud.scene.checks import InputError
from jaxshroud.scene.layout import COORDINATES
from jaxshroud.scene.typed import FloatArray

DENSE = 1500  # unknowns up to which all eigenvalues are computed
ASYMMETRY = 1e-8  # of a matrix over its largest entry, beyond which it is not symmetric
SINGULAR = 1e-13  # pivots, or eigenvalues, of a stiffness over the largest, with a diagonal of 1
RIGID_SHARE = 1e-9  # of the energy of a rigid motion over that of its unknowns alone
NO_FLEXIBILITY = 1e-12  # of the residual flexibility over the whole: rounding
NO_MASS = 1e-9  # of residual vectors over the largest, by (omega_highest / omega)^2
LEAST_ALIKE = 0.9  # modal assurance criterion of a mode at rest and at speed
FILL_BYTES = 372  # of a factor, times n^(4/3): that of solids, of 31 n^(4/3) numbers with their places
NOWHERE = (np.nan,) * 3  # the place of a node without coordinates
RIGID_NAMES = ("x", "y", "z", "turns about x", "turns about y", "turns about z")


class Reduced(NamedTuple):
    """The modes of a blade, residual vectors last."""

    omega: FloatArray  # (n,) [rad/s]
    zeta: FloatArray  # (n,)
    shapes: FloatArray  # (unknowns, kept modes) of all unknowns
    at_shroud: FloatArray  # (coordinates, n)
    residual: np.ndarray  # (n,) whether it is a residual vector
    left_out: FloatArray  # (coordinates,) share of the flexibility that the kept modes leave out
    own_omega: FloatArray  # (n,) before residual vectors were given another frequency


def symmetric(matrix: Any, name: str) -> Any:
    """A sparse symmetric matrix, also from one of which one triangle alone is stored.

    Raises:
        InputError: It is not square, not of real numbers, not finite, or not symmetric.
    """
    from scipy.sparse import csc_array, issparse, tril, triu

    given = matrix if issparse(matrix) else np.asarray(matrix)
    if given.dtype.kind not in "iuf" or given.ndim != 2 or given.shape[0] != given.shape[1]:
        kind = f"{given.dtype} of the shape {given.shape}"
        raise InputError(f"{name} must be a square matrix of real numbers, but is {kind}.")
    a: Any = csc_array(given, dtype=float)
    if not np.isfinite(a.data).all():
        raise InputError(f"{name} has entries that are no finite numbers.")
    lower = tril(a, -1)
    upper = triu(a, 1)
    if min(abs(lower).sum(), abs(upper).sum()) == 0:
        return csc_array(a + (lower + upper).T)
    if abs(a - a.T).max() > ASYMMETRY * abs(a).max():
        raise InputError(f"{name} is not symmetric, as those of rotating frames or of friction are not.")
    return csc_array((a + a.T) / 2)


def require_memory(unknowns: int) -> None:
    """Raise an InputError unless a factor of a stiffness of so many unknowns is likely to fit into the free memory."""
    import psutil

    needed = FILL_BYTES * unknowns ** (4 / 3)
    free = psutil.virtual_memory().available
    if needed > free:
        raise InputError(
            f"{unknowns} unknowns would take some {needed / 2**30:.0f} GiB, but {free / 2**30:.1f} GiB are free; "
            "reduce the model where it was made (modes and their shapes), or take a coarser mesh."
        )


class Factor(NamedTuple):
    """A stiffness that is regular, and how to solve with it."""

    K: Any  # the stiffness
    root: Any  # diagonal, by which it is scaled from both sides
    scaled: Any  # the scaled stiffness, with a diagonal of 1
    solved: Any  # (right sides) -> the solutions with the scaled stiffness

    def solve(self, right: FloatArray) -> FloatArray:
        """The displacements under forces, refined once by residuals in long double.

        Scaling rounds: without the refinement the error is that of a double times the condition, 1e11 of thin plates.
        """
        y = self._rough(right)
        return y + self._rough((right - self.K.astype(np.longdouble) @ y).astype(float))

    def _rough(self, right: FloatArray) -> FloatArray:
        return self.root @ self.solved(self.root @ right)


def stiffness_factor(K: Any, rigid: FloatArray) -> Factor:
    """The factor of a stiffness.

    Args:
        K: The stiffness.
        rigid: What rigid motions make of the unknowns (unknowns, 6), by which a singular stiffness is explained.

    Raises:
        InputError: It is singular or not positive definite.
    """
    from scipy.sparse import diags_array
    from scipy.sparse.linalg import splu

    diagonal = K.diagonal()
    if np.any(diagonal < 0):
        raise InputError("K has a negative entry on its diagonal: it is not positive definite.")
    root = diags_array(1 / np.sqrt(np.where(diagonal > 0, diagonal, 1.0)))
    scaled = (root @ K @ root).tocsc()
    try:
        lu = splu(scaled, "MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
        pivots = lu.U.diagonal()
    except RuntimeError:  # a pivot of exactly 0
        pivots = np.zeros(1)
        lu = None
    if lu is None or np.min(np.abs(pivots)) < SINGULAR * np.max(np.abs(pivots)):
        raise InputError(f"K is singular{_named_rigid(K, rigid)}; hold nodes by `fixed`.")
    if np.any(pivots < 0):
        raise InputError("K is not positive definite: it has a negative eigenvalue.")
    return Factor(K, root, scaled, lu.solve)


def _named_rigid(K: Any, rigid: FloatArray) -> str:
    """The rigid motions that a stiffness leaves free, in words."""
    energy, own = (np.sum(rigid * (matrix @ rigid), axis=0) for matrix in (K, abs(K)))
    free = [name for name, share in zip(RIGID_NAMES, abs(energy) <= RIGID_SHARE * own, strict=True) if share]
    return f": the model is free to move as a whole ({', '.join(free)})" if free else ": some motion has no stiffness"


def lowest_modes(factor: Factor, M: Any, count: int) -> tuple[FloatArray, FloatArray]:
    """The lowest modes, and the next one if there is any: omega (n,) and mass-normalised shapes (unknowns, n).

    Raises:
        InputError: M is not positive semidefinite, or has fewer modes.
    """
    size = M.shape[0]
    inertia = factor.root @ M @ factor.root
    if size <= DENSE:
        from scipy.linalg import eigh

        squares, shapes = eigh(inertia.toarray(), factor.scaled.toarray())  # of 1 / omega^2: M may be singular
    else:
        from scipy.sparse.linalg import LinearOperator, eigsh

        inverse: Any = LinearOperator(dtype=float, shape=(size, size), matvec=factor.solved)  # pyright: ignore[reportCallIssue]
        squares, shapes = eigsh(inertia, min(count + 1, size - 1), M=factor.scaled, Minv=inverse, which="LA")
    order = np.argsort(-squares)
    squares = squares[order]
    shapes = factor.root @ shapes[:, order]
    if squares[-1] < -1e-9 * squares[0]:
        raise InputError("M is not positive semidefinite: some motion has a negative mass.")
    found = int(np.sum(squares > 1e-14 * squares[0]))
    if found < count:
        raise InputError(f"The model has {found} modes, fewer than the {count} requested; keep fewer.")
    told = min(found, count + 1)
    omega = 1 / np.sqrt(squares[:told])
    shapes = shapes[:, :told]
    return omega, shapes / np.sqrt(np.sum(shapes * (M @ shapes), axis=0))


def reduced(
    M: Any,
    C: Any,
    B: FloatArray,
    K_inverse_B: FloatArray,
    omega: FloatArray,
    shapes: FloatArray,
    zeta: float,
    limit: float | None,
    least: FloatArray,
) -> Reduced:
    """Modes and residual vectors.

    Args:
        M: The mass.
        C: The damping; None: `zeta` for all.
        B: What forces on the shroud are to the unknowns, (unknowns, coordinates).
        K_inverse_B: The displacements under them.
        omega: Those of the modes (n,).
        shapes: Those of the modes (unknowns, n).
        zeta: Damping ratio where there is no C.
        limit: The circular frequency that residual vectors above it, and those without mass, are given; None: eight
            times that of the highest mode; inf: none.
        least: The flexibility (coordinates,) below which a residual vector is left out.
    """
    count = len(omega)
    whole = B.T @ K_inverse_B
    R = K_inverse_B - shapes @ (shapes.T @ B / omega[:, None] ** 2)
    A = B.T @ R
    A = (A + A.T) / 2
    scale = 1 / np.sqrt(np.diag(whole))
    values, vectors = np.linalg.eigh(A * np.outer(scale, scale))
    kept = values > NO_FLEXIBILITY
    half = scale[:, None] * vectors[:, kept] / np.sqrt(values[kept])  # half' A half = 1
    V = R @ half
    inverse_squares, turned = np.linalg.eigh(V.T @ (M @ V))
    ceiling = float(8 * omega[-1]) if limit is None else limit
    massless = inverse_squares < NO_MASS / omega[-1] ** 2
    if np.any(massless) and np.isinf(ceiling):
        raise InputError("A residual vector has no mass: give `residual_frequency` a finite value, or leave it out.")
    own = 1 / np.sqrt(np.where(massless, np.finfo(float).tiny, inverse_squares))
    given = np.where(massless | (own > ceiling), ceiling, own)
    W = V @ turned  # the residual vectors, of circular frequencies `own`
    counts = np.any(least[:, None] < (B.T @ W) ** 2, axis=0)
    order = np.flatnonzero(counts)[np.argsort(given[counts], kind="stable")]
    omegas = np.concatenate([omega, given[order]])
    every = np.hstack([shapes, W[:, order] * given[order]])
    damping = np.full(len(omegas), zeta)
    if C is not None:
        damping = np.sum(every * (C @ every), axis=0) / (2 * omegas)
        damping[count:] = np.minimum(damping[count:], 1.0)
    return Reduced(
        omega=omegas,
        zeta=damping,
        shapes=shapes,
        at_shroud=B.T @ every,
        residual=np.arange(len(omegas)) >= count,
        left_out=np.diag(A) / np.diag(whole),
        own_omega=np.concatenate([omega, own[order]]),
    )


def stuck_frequencies(of: Reduced, stiffness: FloatArray) -> FloatArray:
    """The natural frequencies [rad/s] of the shroud on springs along its coordinates."""
    return np.sqrt(np.linalg.eigvalsh(np.diag(of.omega**2) + spring_stiffness(stiffness, of.at_shroud)))


def growth_with_speed(
    M: Any, rest: tuple[FloatArray, FloatArray], running: tuple[FloatArray, FloatArray], speed: float
) -> FloatArray:
    """The growth B of omega^2 of modes at rest, (n,), by the modes at a speed that are most like them.

    Raises:
        InputError: A mode is like none.

    Source:
        B = (omega_speed^2 - omega^2) / Omega^2 of pairs by MAC = (phi' M phi_speed)^2: shapes that turn are not in it.
    """
    alike = (rest[1].T @ (M @ running[1])) ** 2
    if np.any(lost := alike.max(axis=1) < LEAST_ALIKE):
        j = int(np.argmax(lost))
        raise InputError(f"Mode {j} is like none at speed (MAC = {alike[j].max():.2g} < {LEAST_ALIKE}): shapes turn.")
    return (running[0][np.argmax(alike, axis=1)] ** 2 - rest[0] ** 2) / speed**2


def real_shapes(shapes: Any) -> tuple[FloatArray, FloatArray]:
    """Complex shapes (unknowns, n) turned to their largest real part, and how collinear each is, (n,).

    Source:
        |sum phi^2| / sum |phi|^2, which is 1 of a real shape in any phase; its phase is half that of sum phi^2.
    """
    squares = np.sum(shapes**2, axis=0)
    sizes = np.maximum(np.sum(np.abs(shapes) ** 2, axis=0), np.finfo(float).tiny)
    return (shapes * np.exp(-0.5j * np.angle(squares))).real, np.abs(squares) / sizes


class ShroudFit(NamedTuple):
    """The rigid motion (x, y, z and turns about them, in the shroud's frame) that fits the nodes of a shroud best."""

    unknowns: np.ndarray  # (m,) places of those of its nodes among all
    rigid: FloatArray  # (m, 6) what each motion makes of them, turns by the size of the shroud
    weight: FloatArray  # (m,) of each, in the fit: a length for turns
    length: float  # the size of the shroud

    @property
    def motion(self) -> FloatArray:
        """The rigid motion by the unknowns, (6, m)."""
        return np.linalg.pinv(self.weight[:, None] * self.rigid) * self.weight

    def plane_forces(self, size: int) -> FloatArray:
        """What forces along x and y and a clockwise moment on the shroud are to all unknowns, (size, 3)."""
        B = np.zeros((size, 3))
        x, y, turn = self.motion[[0, 1, 5]]
        B[self.unknowns] = np.stack([x, y, -turn / self.length], axis=-1)
        return B

    def shares(self, shapes: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Of shapes (unknowns, n): what of the motion of the nodes is not rigid, and not seen in a plane, (n,) each."""
        own = self.weight[:, None] * shapes[self.unknowns]
        motion = self.motion @ shapes[self.unknowns]
        fitted, unseen = (self.weight[:, None] * self.rigid[:, of] @ motion[of] for of in (range(6), [2, 3, 4]))
        whole = np.maximum(np.linalg.norm(own, axis=0), np.finfo(float).tiny)
        return np.linalg.norm(own - fitted, axis=0) / whole, np.linalg.norm(unseen, axis=0) / whole


def rigid_motions(
    unknowns: Sequence[tuple[str, int]], nodes: Mapping[str, Any], origin: FloatArray, axes: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """What rigid motions in a frame make of unknowns, (m, 6), and the places of these from its origin, (m, 3).

    Unknowns without coordinates, such as amplitudes of modes, do not move and are at NaN.

    Args:
        unknowns: The node and the direction of each: from 1 to 3 it moves along, from 4 to 6 it turns about its axes.
        nodes: Coordinates of nodes, perhaps with the x and the y axis of their unknowns, see `reduce`.
        origin: That of the frame.
        axes: The unit vectors of the frame (3, 3), in rows.
    """
    numbers = [np.asarray(nodes.get(node, NOWHERE), float) for node, _ in unknowns]
    frames = [frame_of(a[3:6].tolist(), a[6:].tolist()) if len(a) > 3 else np.eye(3) for a in numbers]
    along = np.array([own[(i - 1) % 3] for own, (_, i) in zip(frames, unknowns, strict=True)])
    turns = np.array([[i > 3] for _, i in unknowns])
    arms = np.array([a[:3] for a in numbers]) - origin
    own = along @ axes.T
    swept = np.sum(np.cross(axes, arms[:, None]) * along[:, None], axis=-1)
    moved = np.where(turns, np.hstack([0 * own, own]), np.hstack([own, swept]))
    return np.where(np.isnan(arms[:, :1]), 0.0, moved), arms


def shroud_fit(unknowns: np.ndarray, rigid: FloatArray, turns: np.ndarray, arms: FloatArray) -> ShroudFit:
    """The fit of the unknowns of a shroud's nodes.

    Turns of nodes count only where displacements do not determine how the shroud moves, as those of one node.

    Args:
        unknowns: Their places among all (m,).
        rigid: What rigid motions about the shroud's centre make of them (m, 6).
        turns: Whether each is a turn (m,).
        arms: The places of their nodes from that centre (m, 3).

    Raises:
        InputError: The nodes do not determine how the shroud moves in its plane.
    """
    length = float(np.sqrt(np.mean(np.sum(arms**2, axis=1)))) or 1.0
    rigid = rigid / np.repeat([1.0, length], 3)
    weight = np.where(turns, length, 1.0)
    lost: list[str] = []
    for counts in (~turns, turns | True):
        own = weight[counts, None] * rigid[counts]
        told = np.diag(np.linalg.pinv(own, rtol=1e-9) @ own)[[0, 1, 5]]  # 1 of what they determine
        lost = [name for name, share in zip(COORDINATES, told, strict=True) if share < 1 - 1e-9]
        if not lost:
            return ShroudFit(unknowns[counts], rigid[counts], weight[counts], length)
    raise InputError(
        f"The nodes of the shroud do not determine its {' and '.join(lost)}: they are too few, or on one line; "
        "name at least three that are not."
    )


def frame_of(x_axis: Sequence[float], y_axis: Sequence[float]) -> FloatArray:
    """The unit vectors (3, 3) along l_oa, along y and at right angles to both, in rows.

    Raises:
        InputError: The two directions are no directions, or one.
    """
    x, y = (np.asarray(a, float) for a in (x_axis, y_axis))
    z = np.cross(x, y) if x.shape == y.shape == (3,) else np.zeros(3)
    if not np.linalg.norm(z) > 1e-6 * np.linalg.norm(x) * np.linalg.norm(y):
        raise InputError(f"`x_axis` and `y_axis` must be two directions of space, but are {[*x_axis]} and {[*y_axis]}.")
    frame = np.stack([x, np.cross(z, x), z])
    return frame / np.linalg.norm(frame, axis=1, keepdims=True)
