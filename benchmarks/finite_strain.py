"""How far neo-Hookean rubber departs from Hertz's law and from the sphere's at a contact radius.

    python benchmarks/run.py finite_strain.table --count 30    # elements along the contact radius

A rigid sphere is pressed without friction into a block of nearly incompressible neo-Hookean rubber, wide
against the contact. Axisymmetric finite elements of the total Lagrangian form: bilinear, the dilatation
averaged over each element, the bulk modulus `BULK` shear moduli. The sphere acts on the nodes of the surface
by a penalty. The radius of the contact is where the square of the pressure, which falls to zero linearly
there, vanishes. Lengths are in units of the sphere's radius, pressures of the shear modulus.
"""

import numpy as np
from scipy.sparse import coo_matrix, diags
from scipy.sparse.linalg import splu

from contactimg.mechanics import sphere

BULK, PENALTY = 500.0, 1e4
MODULUS = 4 * (BULK + 1 / 3) / (BULK + 4 / 3)
SIZE = 14.0
"""Side of the block in contact radii: a layer of this thickness bears 1.0002 of the load."""

RATIOS = (0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7)
STEPS, SOFTER = 8, (30, 10, 4, 2, 1)
"""Steps of the depth, and by how much penalty and bulk modulus are lower on the way to a solution."""


def graded(fine, uniform, end, growth):
    """Places from 0 with equal steps up to ``uniform`` that grow beyond to ``end``."""
    places = list(np.arange(0, uniform, fine))
    while places[-1] < end:
        places.append(places[-1] + fine)
        fine *= growth
    return np.array(places)


class Block:
    """A block of rubber under a sphere.

    Parameters
    ----------
    radius : float
        About the contact radius that it is meshed for.
    count : int
        Elements along it.
    """

    def __init__(self, radius, count):
        fine = radius / count
        across = graded(fine, 1.5 * radius, SIZE * radius, 1.15)
        down = -graded(fine, 0.3 * radius, SIZE * radius, 1.12)
        nr, nz = across.size, down.size
        self.place = np.stack(np.meshgrid(across, down), axis=-1).reshape(-1, 2)
        node = np.arange(nr * nz).reshape(nz, nr)
        corners = [node[1:, :-1], node[1:, 1:], node[:-1, 1:], node[:-1, :-1]]
        self.element = np.stack([c.ravel() for c in corners], axis=1)
        self.surface = node[0]
        edges = np.concatenate([[0.0], 0.5 * (across[1:] + across[:-1]), across[-1:]])
        self.shares = np.pi * np.diff(edges**2)
        self.radius, self.stiffness, self.bulk = radius, PENALTY / radius, BULK
        fixed = np.concatenate([2 * node[:, 0], 2 * node[:, -1], 2 * node[-1], 2 * node[-1] + 1])
        self.free = np.setdiff1d(np.arange(2 * self.place.shape[0]), fixed)
        dofs = np.stack([2 * self.element, 2 * self.element + 1], axis=-1).reshape(-1, 8)
        self.dofs = dofs
        self.rows, self.columns = np.repeat(dofs, 8, axis=1).ravel(), np.tile(dofs, (1, 8)).ravel()
        self._prepare()

    def _prepare(self):
        """Volumes and derivatives of F (rr, rz, zr, zz, tt) by the displacements at the Gauss points."""
        sign = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
        X = self.place[self.element]
        self.B, self.weight = [], []
        for point in sign / np.sqrt(3):
            shape = np.prod(1 + sign * point, axis=1) / 4
            slope = sign * (1 + sign[:, ::-1] * point[::-1]) / 4
            jacobian = np.einsum("na,enb->eab", slope, X)
            by_place = np.einsum("eab,nb->ena", np.linalg.inv(jacobian), slope)
            r = X[..., 0] @ shape
            B = np.zeros((len(X), 5, 8))
            B[:, 0, 0::2], B[:, 1, 0::2] = by_place[..., 0], by_place[..., 1]
            B[:, 2, 1::2], B[:, 3, 1::2] = by_place[..., 0], by_place[..., 1]
            B[:, 4, 0::2] = shape / r[:, None]
            self.B.append(B)
            self.weight.append(2 * np.pi * r * np.linalg.det(jacobian))
        self.B, self.weight = np.stack(self.B, axis=1), np.stack(self.weight, axis=1)

    def rubber(self, u):
        """Energy, forces and stiffness of the rubber; infinite energy where an element is turned over."""
        f = np.array([1, 0, 0, 1, 1.0]) + np.einsum("egij,ej->egi", self.B, u[self.dofs])
        rr, rz, zr, zz, tt = np.moveaxis(f, -1, 0)
        J = (rr * zz - rz * zr) * tt
        if np.any(J <= 0):
            return np.inf, None, None
        g = np.stack([zz * tt, -zr * tt, -rz * tt, rr * tt, rr * zz - rz * zr], axis=-1)
        H = np.zeros((*J.shape, 5, 5))
        for i, j, value in ((0, 3, tt), (1, 2, -tt), (0, 4, zz), (1, 4, -zr), (2, 4, -rz), (3, 4, rr)):
            H[..., i, j] = H[..., j, i] = value
        first, c = np.einsum("egi,egi->eg", f, f), J ** (-2 / 3)
        V = self.weight.sum(axis=1)
        swelling = np.einsum("eg,eg->e", self.weight, J) / V - 1
        energy = np.sum(self.weight * 0.5 * (first * c - 3)) + np.sum(0.5 * self.bulk * V * swelling**2)
        slope = (
            c[..., None] * f - (first * c / J / 3)[..., None] * g + self.bulk * swelling[:, None, None] * g
        )
        fg = np.einsum("egi,egj->egij", f, g)
        curve = c[..., None, None] * np.eye(5) - (2 / 3 * c / J)[..., None, None] * (fg + fg.swapaxes(-1, -2))
        curve += (5 / 9 * first * c / J**2)[..., None, None] * np.einsum("egi,egj->egij", g, g)
        curve += (self.bulk * swelling[:, None] - first * c / J / 3)[..., None, None] * H
        force = np.einsum("eg,egij,egi->ej", self.weight, self.B, slope, optimize=True)
        volume = np.einsum("eg,egij,egi->ej", self.weight, self.B, g, optimize=True)
        matrix = np.einsum(
            "egik,egij,egjl->ekl", self.B * self.weight[..., None, None], curve, self.B, optimize=True
        )
        matrix += (self.bulk / V)[:, None, None] * np.einsum("ei,ej->eij", volume, volume)
        return energy, np.bincount(self.dofs.ravel(), force.ravel(), u.size), matrix

    def sphere(self, u, depth):
        """Energy, forces, stiffness blocks of the penalty, overlaps and directions of the surface's nodes."""
        x = self.place[self.surface] + u.reshape(-1, 2)[self.surface] - np.array([0, 1 - depth])
        distance = np.hypot(*x.T)
        n, overlap = x / distance[:, None], np.maximum(1 - distance, 0)
        k = self.stiffness * self.shares
        outer = np.einsum("ni,nj->nij", n, n)
        # without the curvature of the sphere, which is small where the overlap is, and never positive
        block = k[:, None, None] * np.where((overlap > 0)[:, None, None], outer, 0)
        force = np.zeros((len(self.place), 2))
        force[self.surface] = -(k * overlap)[:, None] * n
        return 0.5 * np.sum(k * overlap**2), force.ravel(), block, overlap, n

    def press(self, u, depth):
        """Displacements at a depth of the sphere, by Newton's method with a line search on the energy."""
        for _ in range(60):
            energy, force, matrix = self.rubber(u)
            extra, pushed, block, _, _ = self.sphere(u, depth)
            d = np.stack([2 * self.surface, 2 * self.surface + 1], axis=1)
            rows = np.concatenate([self.rows, np.repeat(d, 2, axis=1).ravel()])
            columns = np.concatenate([self.columns, np.tile(d, (1, 2)).ravel()])
            values = np.concatenate([matrix.ravel(), block.ravel()])
            K = coo_matrix((values, (rows, columns)), shape=(u.size, u.size)).tocsc()
            residual = (force + pushed)[self.free]
            K = K[self.free][:, self.free] + diags(np.zeros(self.free.size), format="csc")
            step = np.zeros_like(u)
            step[self.free] = splu(K).solve(-residual)
            length = 1.0
            while length > 1e-4:
                trial = u + length * step
                now = self.rubber(trial)[0] + self.sphere(trial, depth)[0]
                if now <= energy + extra + 1e-9 * abs(energy + extra):
                    break
                length /= 2
            u = u + length * step
            if np.abs(length * step).max() < 1e-6 * depth:
                return u
        raise RuntimeError(f"Newton's method does not settle at a depth of {depth:g}")

    def contact(self, u, depth):
        """Load and contact radius."""
        _, _, _, overlap, n = self.sphere(u, depth)
        push = self.stiffness * self.shares * overlap * -n[:, 1]
        r = self.place[self.surface, 0] + u[2 * self.surface]
        edges = np.concatenate([[0.0], 0.5 * (r[1:] + r[:-1]), r[-1:]])
        pressure = push / (np.pi * np.diff(edges**2))
        last = int(np.flatnonzero(overlap).max())
        rows = np.arange(last // 2, last - 2)
        roots = np.roots(np.polyfit(r[rows] ** 2, pressure[rows] ** 2, 2))
        edge = roots[np.isreal(roots) & (roots.real > r[last - 3] ** 2)].real.min()
        return float(push.sum()), float(np.sqrt(edge))


def ratios(target, count):
    """Contact radius near a target, and the load over Hertz's and over the sphere's."""
    block, depth = Block(target, count), float(sphere.scaled_indentation(np.array([target]))[0])
    u, before = np.zeros(2 * len(block.place)), 1.0
    for part in np.linspace(0, 1, STEPS + 1)[1:]:
        u, before = u * part / before, part
        for softer in SOFTER:
            block.stiffness, block.bulk = PENALTY / softer / target, BULK / softer
            u = block.press(u, part * depth)
    load, a = block.contact(u, depth)
    return a, load / (4 / 3 * MODULUS * a**3), load / (MODULUS * float(sphere.scaled_load(np.array([a]))[0]))


def table(targets: tuple[float, ...] = RATIOS, count: int = 30) -> None:
    """Ratios near each a/R, with so many elements along the contact radius."""
    print("| a/R | over Hertz | over the sphere |\n|---|---|---|")
    for target in targets:
        a, hertz, exact = ratios(target, count)
        print(f"| {a:.3f} | {hertz:.4f} | {exact:.4f} |", flush=True)
