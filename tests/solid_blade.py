"""Solid finite elements of a blade, 200 x 40 x 6 mm, with a block, 40 x 40 x 10 mm, at its end, by scikit-fem.

The blade stands along z, is soft along x, and is clamped at z = 0. Nodes of the shroud are the corners of the block.
"""

from functools import cache
from typing import Any, NamedTuple

import numpy as np
import skfem
from skfem.helpers import dot
from skfem.models.elasticity import lame_parameters, linear_elasticity

E, NU, RHO = 2.1e11, 0.3, 7850.0  # of steel
SPAN, HEIGHT = 0.2, 0.21  # of the blade, and to the top of the block [m]
HALF_THICKNESS, HALF_SIDE = 0.003, 0.02  # of the blade, and of the block [m]


class SolidBlade(NamedTuple):
    """The matrices of all unknowns, what each row is, and where the nodes are."""

    K: Any
    M: Any
    labels: list[str]
    nodes: dict[str, np.ndarray]
    tips: list[str]  # nodes of the shroud
    root: list[str]
    mesh: Any

    @property
    def free(self):
        """The places of the unknowns that are not of the root."""
        held = {*self.root}
        return np.array([i for i, label in enumerate(self.labels) if label.split(".")[0] not in held])

    def shroud(self):
        """The motion of the shroud by the unknowns, (3, n): the means of its nodes, and the clockwise turn."""
        rows = np.zeros((3, len(self.labels)))
        places = np.array([self.nodes[tip][:2] for tip in self.tips])
        arms = (places - places.mean(axis=0)) / np.sum((places - places.mean(axis=0)) ** 2)
        for tip, (x, y) in zip(self.tips, arms, strict=True):
            at = self.labels.index(f"{tip}.1")
            rows[:, at], rows[:, at + 1] = [1 / len(self.tips), 0, y], [0, 1 / len(self.tips), -x]
        return rows

    def save(self, path):
        """Write all as `jaxshroud reduce` reads it."""
        rows = np.array([[float(node), *place] for node, place in self.nodes.items()])
        np.savez_compressed(path, K=self.K, M=self.M, dofs=np.array(self.labels), nodes=rows)


@cache
def solid_blade(offset=0.0, elements=10):
    """The blade with so many elements along its span, bricks of 20 nodes, and its block off its axis along y [m]."""
    x = np.array([-HALF_SIDE, -0.0115, -HALF_THICKNESS, HALF_THICKNESS, 0.0115, HALF_SIDE])
    z = np.array([*np.linspace(0, SPAN, elements + 1), HEIGHT])
    chord = np.linspace(-HALF_SIDE, HALF_SIDE, 5)
    mesh = skfem.MeshHex.init_tensor(x, np.unique([*chord, offset - HALF_SIDE, offset + HALF_SIDE]), z)
    middle = mesh.p[:, mesh.t].mean(axis=1)
    of_blade = (np.abs(middle[0]) < HALF_THICKNESS) & (np.abs(middle[1]) < HALF_SIDE)
    of_block = np.abs(middle[1] - offset) < HALF_SIDE
    mesh = mesh.remove_elements(np.flatnonzero(~np.where(middle[2] < SPAN, of_blade, of_block)))
    basis = skfem.Basis(mesh, skfem.ElementVector(skfem.ElementHexS2()))
    K = linear_elasticity(*lame_parameters(E, NU)).assemble(basis)
    M = skfem.BilinearForm(lambda u, v, _: RHO * dot(u, v)).assemble(basis)
    dofs = np.hstack([basis.nodal_dofs, basis.edge_dofs])  # (directions, nodes)
    places = basis.doflocs[:, dofs[0]].T
    order = dofs.T.ravel()  # node by node
    K, M = (matrix[order][:, order].toarray() for matrix in (K, M))
    labels = [f"{node}.{direction}" for node in range(len(places)) for direction in (1, 2, 3)]
    block = places[:, 2] >= SPAN - 1e-9
    corners = block & np.isclose(np.abs(places[:, :2] - [0.0, offset]), HALF_SIDE).all(axis=1)

    def named(where):
        return [str(node) for node in np.flatnonzero(where)]

    nodes = {str(node): place for node, place in enumerate(places)}
    return SolidBlade(K, M, labels, nodes, named(corners), named(places[:, 2] < 1e-9), mesh)
