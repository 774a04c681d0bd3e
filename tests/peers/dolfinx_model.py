"""A static hyperelastic body in DOLFINx, with the interface and conventions of getfem_model.py.

Laws `st-venant-kirchhoff` and `mooney-rivlin`, orders 1 and 2. Residual and tangent are derived from the energy and
compiled by FFCx, with the C compiler's optimisation for this processor. PETSc calls MUMPS for a symmetric
indefinite matrix and keeps its analysis, which is counted in the first iteration only. MUMPS gets its BLAS from MKL:
it calls GEMMT, for which the wheel's OpenBLAS multiplies vectors.

Run it with tests/peers/dolfinx-python.
"""

import ctypes
import glob
import logging
import os
import sys

# First, because it limits the BLAS of numpy to one thread.
from newton import C01_PA, C10_PA, LAMBDA_PA, MU_PA, NewtonBody, clock, np

os.environ["MKL_THREADING_LAYER"] = "SEQUENTIAL"
try:
    [mkl] = glob.glob(f"{sys.prefix}/lib/libmkl_rt.so*")
    ctypes.CDLL(mkl, ctypes.RTLD_GLOBAL)  # before the libraries that shall find their BLAS in it
    import dolfinx_solver  # noqa: F401 - the wheel loads its MPI first
    import ufl
    from basix import CellType, make_quadrature
    from basix.ufl import element, mixed_element
    from dolfinx import fem
    from dolfinx.fem import petsc
    from dolfinx.mesh import create_mesh
    from mpi4py import MPI
    from petsc4py import PETSc

    from organ_mesh import edges
except (ImportError, ValueError) as error:
    sys.exit(f"DOLFINx is missing: run tests/peers/install dolfinx, then use tests/peers/dolfinx-python ({error})")

logging.disable(logging.INFO)  # the compiler's command lines
COMPILER = {"cffi_extra_compile_args": ["-O3", "-march=native", "-ffast-math"], "cffi_libraries": ["m"]}
PETSc.Options()["mat_mumps_icntl_7"] = 5  # METIS's order of elimination
# Decimals of coordinates in m by which nodes are found.
DECIMALS = 10


def energy_density(law, u, p):
    """W of the laws of getfem_model.py, with the pressure's term, J/m3."""
    F = ufl.Identity(3) + ufl.grad(u)
    C = F.T * F
    if law == "st-venant-kirchhoff":
        E = (C - ufl.Identity(3)) / 2
        return LAMBDA_PA / 2 * ufl.tr(E) ** 2 + MU_PA * ufl.inner(E, E)
    first, second = ufl.tr(C), (ufl.tr(C) ** 2 - ufl.inner(C, C)) / 2
    rest_pa = 2 * C10_PA + 4 * C01_PA
    return C10_PA * (first - 3) + C01_PA * (second - 3) + (p + rest_pa) * (1 - ufl.det(F))


def key(place):
    """A place as a key: the same for both signs of zero."""
    return tuple(np.round(place, DECIMALS) + 0.0)


class Model(NewtonBody):
    """One body, held at `fixed` (0-based nodes) and moved at `active`, with a law and order 1 or 2.

    The state is DOLFINx's vector of all unknowns, in its own order.
    """

    def __init__(self, mesh, law, order, fixed, active):
        domain = ufl.Mesh(element("Lagrange", "tetrahedron", 1, shape=(3,)))
        self.mesh = create_mesh(MPI.COMM_SELF, mesh.tets, domain, mesh.nodes)
        fields = element("Lagrange", "tetrahedron", order, shape=(3,))
        if law == "mooney-rivlin":
            fields = mixed_element([fields, element("Lagrange", "tetrahedron", 1)])
        space = fem.functionspace(self.mesh, fields)
        self.function = fem.Function(space)
        u, p = ufl.split(self.function) if law == "mooney-rivlin" else (self.function, None)
        # One point is exact for linear tets, degree 4 for quadratic ones in both laws.
        degree = 1 if order == 1 else 4
        dx = ufl.dx(metadata={"quadrature_degree": degree})
        residual = ufl.derivative(energy_density(law, u, p) * dx, self.function, ufl.TestFunction(space))
        tangent = ufl.derivative(residual, self.function, ufl.TrialFunction(space))
        self.forms = [fem.form(form, jit_options=COMPILER) for form in (residual, tangent)]
        self.vector = petsc.create_vector(space)
        self.matrix = petsc.create_matrix(self.forms[1])
        points, _ = make_quadrature(CellType.tetrahedron, degree)
        self.determinant = fem.Expression(ufl.det(ufl.Identity(3) + ufl.grad(u)), points, jit_options=COMPILER)

        self.rest = np.zeros(self.function.x.array.size)
        dofs, points = self._displacement_dofs(space, law)
        self.u = dofs.ravel()
        node = {key(place): number for number, place in enumerate(points)}

        def of(place):
            return node[key(place)]

        held = [of(mesh.nodes[vertex]) for vertex in fixed]
        if order == 2:
            pairs, _ = edges(mesh.tets)
            held += [of(place) for place in mesh.nodes[pairs[np.isin(pairs, fixed).all(axis=1)]].mean(axis=1)]
        self.active = dofs[of(mesh.nodes[active])]
        prescribed = np.concatenate([dofs[held].ravel(), self.active])
        self.free = np.setdiff1d(np.arange(len(self.rest)), prescribed)
        self.rows = PETSc.IS().createGeneral(self.free.astype(np.int32), comm=MPI.COMM_SELF)
        self.columns = PETSc.IS().createGeneral(self.active.astype(np.int32), comm=MPI.COMM_SELF)
        self.scale_residual(mesh, np.setdiff1d(np.arange(len(self.rest)), self.u))
        self.solver = self.free_matrix = None

    def _displacement_dofs(self, space, law):
        """Unknowns of u at each of its nodes (n x 3), and the nodes' places."""
        if law == "st-venant-kirchhoff":
            points = space.tabulate_dof_coordinates()
            return 3 * np.arange(len(points))[:, None] + np.arange(3), points
        collapsed, to_parent = space.sub(0).collapse()
        return np.array(to_parent).reshape(-1, 3), collapsed.tabulate_dof_coordinates()

    def residual(self, state):
        self.function.x.array[:] = state
        start = clock()
        with self.vector.localForm() as local:
            local.set(0.0)
        petsc.assemble_vector(self.vector, self.forms[0])
        return self.vector.array.copy(), clock() - start

    def tangent(self):
        start = clock()
        self.matrix.zeroEntries()
        petsc.assemble_matrix(self.matrix, self.forms[1])
        self.matrix.assemble()
        return self.matrix, clock() - start

    def solve_linear(self, tangent, right):
        self.free_matrix = tangent.createSubMatrix(self.rows, self.rows, self.free_matrix)
        if self.solver is None:
            self.free_matrix.setOption(PETSc.Mat.Option.SYMMETRIC, True)
            self.solver = PETSc.KSP().create(MPI.COMM_SELF)
            self.solver.setType("preonly")
            self.solver.getPC().setType("cholesky")
            self.solver.getPC().setFactorSolverType("mumps")
        self.solver.setOperators(self.free_matrix)
        b = PETSc.Vec().createWithArray(right.copy(), comm=MPI.COMM_SELF)
        x = b.duplicate()
        start = clock()
        self.solver.setUp()
        self.solver.solve(b, x)
        return x.array.copy(), clock() - start

    def coupling(self, tangent, direction):
        part = tangent.createSubMatrix(self.rows, self.columns)
        result = part.createVecLeft()
        part.mult(PETSc.Vec().createWithArray(np.array(direction), comm=MPI.COMM_SELF), result)
        return result.array.copy()

    def smallest_jacobian(self, state):
        self.function.x.array[:] = state
        cells = np.arange(self.mesh.topology.index_map(3).size_local, dtype=np.int32)
        return float(self.determinant.eval(self.mesh, cells).min())
