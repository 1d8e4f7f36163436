"""Finite elements of a blade in plain NumPy: a beam with bending, torsion and tension, and a block at its end.

The beam stands along z, is soft along x, and ends in a cross of thick beams whose four tips are nodes of the shroud.
"""

import numpy as np

E, NU, RHO = 2.1e11, 0.3, 7850.0  # of steel
SPAN, CHORD, THICKNESS = 0.2, 0.04, 0.008  # of the blade [m]
BLOCK, MASS = 0.02, 0.2  # half a side of the block [m] and its mass [kg]
ELEMENTS = 10
TIPS = ("101", "102", "103", "104")


def section(width, height):
    """Area, both moments of area (against bending along x, and along y), and the torsion constant of a rectangle."""
    a, b = max(width, height), min(width, height)
    torsion = a * b**3 * (1 / 3 - 0.21 * b / a * (1 - b**4 / (12 * a**4)))
    return width * height, height * width**3 / 12, width * height**3 / 12, torsion


def element(ends, across, of, density=RHO):
    """The stiffness and the mass (12, 12) of a beam between two places; `across` is its first direction of bending."""
    area, I_1, I_2, J = of
    axis = ends[1] - ends[0]
    L = np.linalg.norm(axis)
    G, m = E / (2 * (1 + NU)), density * area * L
    k, M = np.zeros((12, 12)), np.zeros((12, 12))
    bend = np.array([[12, 6, -12, 6], [6, 4, -6, 2], [-12, -6, 12, -6], [6, 2, -6, 4]])
    inert = np.array([[156, 22, 54, -13], [22, 4, 13, -3], [54, 13, 156, -22], [-13, -3, -22, 4]]) / 420
    bar, bar_mass = np.array([[1, -1], [-1, 1]]), np.array([[2, 1], [1, 2]]) / 6
    for places, sign, I in (((0, 4, 6, 10), 1, I_1), ((1, 3, 7, 9), -1, I_2)):
        scale = np.array([1, sign * L, 1, sign * L])
        k[np.ix_(places, places)] += E * I / L**3 * bend * np.outer(scale, scale)
        M[np.ix_(places, places)] += m * inert * np.outer(scale, scale)
    k[np.ix_((2, 8), (2, 8))] += E * area / L * bar
    M[np.ix_((2, 8), (2, 8))] += m * bar_mass
    k[np.ix_((5, 11), (5, 11))] += G * J / L * bar
    M[np.ix_((5, 11), (5, 11))] += m * (I_1 + I_2) / area * bar_mass
    frame = np.stack([across, np.cross(axis / L, across), axis / L])
    turn = np.kron(np.eye(4), frame)
    return turn.T @ k @ turn, turn.T @ M @ turn


class Model:
    """K and M of all unknowns, six at each node, their labels, and where the nodes are; node 0 is the root."""

    def __init__(self):
        z = np.linspace(0, SPAN, ELEMENTS + 1)
        self.nodes = {str(i): np.array([0, 0, one]) for i, one in enumerate(z)}
        corners = [(1, 1), (1, -1), (-1, 1), (-1, -1)]
        self.nodes |= {tip: np.array([BLOCK * x, BLOCK * y, SPAN]) for tip, (x, y) in zip(TIPS, corners, strict=True)}
        self.labels = [f"{node}.{direction}" for node in self.nodes for direction in range(1, 7)]
        names = [*self.nodes]
        self.K, self.M = np.zeros((2, len(self.labels), len(self.labels)))
        blade, arm = section(THICKNESS, CHORD), section(0.02, 0.02)
        for i in range(ELEMENTS):
            self._add(
                names, str(i), str(i + 1), element((self.nodes[str(i)], self.nodes[str(i + 1)]), [1, 0, 0], blade)
            )
        hub = str(ELEMENTS)
        for tip in TIPS:
            ends = self.nodes[hub], self.nodes[tip]
            self._add(names, hub, tip, element(ends, np.array([0.0, 0.0, 1.0]), arm, 1.0))
        at = 6 * names.index(hub) + np.arange(6)
        tilt, turn = MASS * ((2 * BLOCK) ** 2 + 0.01**2) / 12, MASS * (2 * BLOCK) ** 2 / 6
        self.M[at, at] += [MASS, MASS, MASS, tilt, tilt, turn]
        at = 6 * names.index(TIPS[0]) + np.arange(3)
        self.M[at, at] += MASS / 40  # which couples bending and torsion

    def _add(self, names, first, second, matrices):
        at = [6 * names.index(node) + i for node in (first, second) for i in range(6)]
        self.K[np.ix_(at, at)] += matrices[0]
        self.M[np.ix_(at, at)] += matrices[1]

    @property
    def free(self):
        """The places of the unknowns that are not of the root."""
        return np.arange(6, len(self.labels))

    def shroud(self):
        """The motion of the shroud by the unknowns, (3, n): the means of its nodes, and the clockwise turn."""
        rows = np.zeros((3, len(self.labels)))
        turns = sum(np.sum(self.nodes[tip][:2] ** 2) for tip in TIPS)
        for tip in TIPS:
            at = self.labels.index(f"{tip}.1")
            x, y, _ = self.nodes[tip]
            rows[0, at] += 1 / 4
            rows[1, at + 1] += 1 / 4
            rows[2, at] += y / turns
            rows[2, at + 1] -= x / turns
        return rows

    def save(self, path):
        """Write all as `jaxshroud reduce` reads it."""
        nodes = np.array([[float(node), *place] for node, place in self.nodes.items()])
        np.savez(path, K=self.K, M=self.M, dofs=np.array(self.labels), nodes=nodes)
