"""A static hyperelastic body in FElupe, with the interface and conventions of getfem_model.py.

Laws `st-venant-kirchhoff` and `mooney-rivlin`, orders 1 and 2. The stresses and elasticities are written by hand,
because FElupe's automatic differentiation is slower. The matrix is factorised by PARDISO (pypardiso), which
FElupe's documentation recommends, as a symmetric indefinite one. pypardiso keeps no analysis.
"""

import sys

# First, because it limits the BLAS of numpy to one thread.
from newton import C01_PA, C10_PA, LAMBDA_PA, MU_PA, NewtonBody, clock, np

try:
    import felupe as fem
    from pypardiso import PyPardisoSolver
    from scipy.sparse import triu

    from organ_mesh import edges
except ImportError as error:
    sys.exit(f"FElupe is missing: install tests/peers/requirements.txt with pip ({error})")

IDENTITY = np.eye(3)[:, :, None, None]
SYMMETRIC_INDEFINITE = -2


def times(a, b):
    return np.einsum("ik...,kj...->ij...", a, b)


def ik_jl(a, b):
    return np.einsum("ik...,jl...->ijkl...", a, b)


def il_kj(a):
    return np.einsum("il...,kj...->ijkl...", a, a)


def dyad(a):
    return np.einsum("ij...,kl...->ijkl...", a, a)


class StVenantKirchhoff:
    """W = lambda/2 (tr E)^2 + mu E:E."""

    def second_piola(self, F):
        self.right = times(F.swapaxes(0, 1), F)
        strain = (self.right - IDENTITY) / 2
        return LAMBDA_PA * np.trace(strain) * IDENTITY + 2 * MU_PA * strain

    def gradient(self, x):
        return [times(x[0], self.second_piola(x[0])), x[-1]]

    def hessian(self, x):
        F = x[0]
        left = MU_PA * times(F, F.swapaxes(0, 1))
        elasticity = LAMBDA_PA * dyad(F) + MU_PA * il_kj(F)
        elasticity += ik_jl(left, IDENTITY) + ik_jl(IDENTITY, self.second_piola(F))
        return [elasticity]


class MooneyRivlin:
    """W = C10 (I1 - 3) + C01 (I2 - 3) + (p + p0) (1 - J)."""

    rest_pa = 2 * C10_PA + 4 * C01_PA

    def gradient(self, x):
        F, p = x[0], x[1][0] + self.rest_pa
        right = times(F.swapaxes(0, 1), F)
        J = fem.math.det(F)
        cofactor = J * fem.math.inv(F, determinant=J).swapaxes(0, 1)
        stress = 2 * (C10_PA + C01_PA * np.trace(right)) * F - 2 * C01_PA * times(F, right) - p * cofactor
        return [stress, (1 - J)[None], x[-1]]

    def hessian(self, x):
        F, p = x[0], x[1][0] + self.rest_pa
        right, left = times(F.swapaxes(0, 1), F), times(F, F.swapaxes(0, 1))
        J = fem.math.det(F)
        inverse = fem.math.inv(F, determinant=J).swapaxes(0, 1)
        diagonal = 2 * (C10_PA + C01_PA * np.trace(right)) * IDENTITY - 2 * C01_PA * left
        elasticity = ik_jl(diagonal, IDENTITY) - ik_jl(IDENTITY, 2 * C01_PA * right)
        elasticity += 4 * C01_PA * dyad(F) - 2 * C01_PA * il_kj(F)
        elasticity -= p * J * (dyad(inverse) - il_kj(inverse))
        # PARDISO requires every entry of the diagonal, also a zero.
        return [elasticity, -J * inverse, np.zeros_like(J)]


LAWS = {"st-venant-kirchhoff": StVenantKirchhoff, "mooney-rivlin": MooneyRivlin}


class Model(NewtonBody):
    """One body, held at `fixed` (0-based nodes) and moved at `active`, with a law of LAWS and order 1 or 2.

    The state is FElupe's vector of all unknowns: u of every point, then p of every vertex if incompressible.
    """

    def __init__(self, mesh, law, order, fixed, active):
        quadrature = fem.TetrahedronQuadrature(order=1 if order == 1 else 5)
        vertices = fem.RegionTetra(fem.Mesh(mesh.nodes, mesh.tets, "tetra"), quadrature=quadrature)
        region, held = vertices, list(fixed)
        if order == 2:
            pairs, middles = edges(mesh.tets)
            points = np.vstack([mesh.nodes, mesh.nodes[pairs].mean(axis=1)])
            cells = np.hstack([mesh.tets, len(mesh.nodes) + middles])
            region = fem.RegionQuadraticTetra(fem.Mesh(points, cells, "tetra10"), quadrature=quadrature)
            held += (len(mesh.nodes) + np.flatnonzero(np.isin(pairs, fixed).all(axis=1))).tolist()
        fields = [fem.Field(region, dim=3)]
        if law == "mooney-rivlin":
            fields.append(fem.Field(vertices, dim=1))
        self.field = fem.FieldContainer(fields)
        self.solid = fem.SolidBody(LAWS[law](), self.field)
        count = region.mesh.npoints
        self.u = np.arange(3 * count)
        self.rest = np.zeros(sum(field.values.size for field in fields))
        self.active = 3 * active + np.arange(3)
        prescribed = np.concatenate([(3 * np.array(held)[:, None] + np.arange(3)).ravel(), self.active])
        self.free = np.setdiff1d(np.arange(len(self.rest)), prescribed)
        self.scale_residual(mesh, np.arange(3 * count, len(self.rest)))
        self.solver = PyPardisoSolver(mtype=SYMMETRIC_INDEFINITE)

    def _set(self, state):
        self.field[0].values[:] = state[self.u].reshape(-1, 3)
        if len(self.field.fields) == 2:
            self.field[1].values[:] = state[len(self.u) :, None]

    def residual(self, state):
        self._set(state)
        start = clock()
        vector = self.solid.assemble.vector(self.field)
        seconds = clock() - start
        return vector.toarray().ravel(), seconds

    def tangent(self):
        start = clock()
        matrix = self.solid.assemble.matrix()
        return matrix, clock() - start

    def solve_linear(self, tangent, right):
        # Pressures in the unit of `weight`: in pascals PARDISO takes their small pivots for zeros.
        weight = self.weight[self.free]
        upper = triu(tangent[self.free][:, self.free], format="csr")
        upper.data *= np.repeat(weight, np.diff(upper.indptr)) * weight[upper.indices]
        right = weight * right
        start = clock()
        self.solver.factorize(upper)
        solution = self.solver.solve(upper, right)
        seconds = clock() - start
        return weight * solution.ravel(), seconds

    def coupling(self, tangent, direction):
        return tangent[self.free][:, self.active] @ direction

    def smallest_jacobian(self, state):
        self._set(state)
        return float(fem.math.det(self.field.extract()[0]).min())
