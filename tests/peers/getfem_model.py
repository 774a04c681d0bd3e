"""A static hyperelastic body in GetFEM on one of the project's meshes, for comparison with the project.

    u = 0 on the fixed nodes,   u = d on the active node,   find u (and p) with   dW/du = 0 elsewhere

Force: by the tool ON the body at the active node, dW/dd, N. The hand receives the opposite force.
Energy: strain energy relative to rest, J; the constraint p (1 - J) adds nothing at a solution.
SI units throughout. p is the excess over the pressure at rest p0, which each region has from its own
parameters; p > 0 is compression.

Both Dirichlet conditions are eliminated: GetFEM assembles the whole body, the rows and columns of prescribed
displacements are removed before MUMPS, and the reaction is the assembled residual in those rows. MUMPS
factorises the system as symmetric. Both choices are GetFEM's fastest (README.md lists the others).

Needs Debian's python3-getfem (see `install`), run with /usr/bin/python3.
"""

import sys

MISSING = "GetFEM is missing: run tests/peers/install (Debian's python3-getfem), then use /usr/bin/python3"
try:
    # First, because it limits the BLAS of numpy to one thread.
    from newton import PARAMETERS_PA, Failed, NewtonBody, clock  # noqa: F401: scripts import Failed from here

    import getfem as gf
    import numpy as np

    from organ_mesh import read_scene  # noqa: F401: the scripts import it from here
except ImportError as error:
    sys.exit(f"{MISSING} ({error})")

gf.util_trace_level(0)
gf.util_warning_level(0)


def lame(young_pa, poisson):
    """Parameters for `Model`: lambda = E nu / ((1 + nu) (1 - 2 nu)) and mu = E / (2 (1 + nu)), Pa."""
    mu_pa = young_pa / (2 * (1 + poisson))
    return {"lambda": 2 * mu_pa * poisson / (1 - 2 * poisson), "mu": mu_pa}


# First Piola stress P (Pa) and strain energy density W (J/m3) in GetFEM's language; F = I + grad u, E = (F'F
# - I)/2. The stresses are written by hand, because GetFEM assembles derived potentials 2 to 7 times slower.
F = "(Id(3)+Grad_u)"
E = f"Green_Lagrangian({F})"
C = f"Right_Cauchy_Green({F})"
J = f"Det({F})"
F_INV_T = f"(Inv({F})')"  # transposed
STRAIN = "Sym(Grad_u)"
I1 = f"Trace({C})"
I2 = f"(0.5*(sqr({I1})-{C}:{C}))"
PRESSURE_STRESS = f"{J}*{F_INV_T}"

ST_VENANT_STRESS = f"{F}*(lambda*Trace({E})*Id(3)+2*mu*{E})"
ST_VENANT_ENERGY = f"0.5*lambda*sqr(Trace({E}))+mu*({E}:{E})"

# dJbar1/dF = 2 J^-2/3 (F - I1/3 F^-T),   dJbar2/dF = 2 J^-4/3 (I1 F - F C - 2/3 I2 F^-T)
REDUCED_STRESS = (
    f"2*c10*pow({J},-2/3)*({F}-({I1}/3)*{F_INV_T})"
    f"+2*c01*pow({J},-4/3)*({I1}*{F}-{F}*{C}-(2/3*{I2})*{F_INV_T})"
)

# law: (P without the pressure, W, incompressible, pressure at rest p0 / Pa of the parameters c)
LAWS = {
    "linear": (
        f"lambda*Trace({STRAIN})*Id(3)+2*mu*{STRAIN}",
        f"0.5*lambda*sqr(Trace({STRAIN}))+mu*({STRAIN}:{STRAIN})",
        False,
        lambda c: 0.0,
    ),
    "st-venant-kirchhoff": (ST_VENANT_STRESS, ST_VENANT_ENERGY, False, lambda c: 0.0),
    # lambda is kept in addition to the constraint.
    "modified-st-venant-kirchhoff": (ST_VENANT_STRESS, ST_VENANT_ENERGY, True, lambda c: 0.0),
    # W = C10 (I1 - 3) + C01 (I2 - 3), unreduced invariants: stress at rest 2 C10 + 4 C01, which p takes up.
    "mooney-rivlin": (
        f"{F}*(2*(c10+c01*{I1})*Id(3)-2*c01*{C})",
        f"c10*({I1}-3)+c01*({I2}-3)",
        True,
        lambda c: 2 * c["c10"] + 4 * c["c01"],
    ),
    # W = C10 (J^-2/3 I1 - 3) + C01 (J^-4/3 I2 - 3)
    "mooney-rivlin-reduced": (
        REDUCED_STRESS,
        f"c10*(pow({J},-2/3)*{I1}-3)+c01*(pow({J},-4/3)*{I2}-3)",
        True,
        lambda c: 0.0,
    ),
    # W = mu/2 (I1 - 3) - mu ln J + lambda/2 (ln J)^2, compressible
    "neo-hookean": (
        f"mu*{F}+(lambda*log({J})-mu)*{F_INV_T}",
        f"0.5*mu*({I1}-3)-mu*log({J})+0.5*lambda*sqr(log({J}))",
        False,
        lambda c: 0.0,
    ),
}


class Model(NewtonBody):
    """One body, held at `fixed` (0-based nodes) and moved at `active`, with a law of LAWS and order 1 or 2.

    The state is GetFEM's vector of all unknowns: u of the whole body, then p on the vertices if
    incompressible. `parameters` replaces values of PARAMETERS_PA, Pa: numbers, or arrays over the tets.
    `regions` are the tets of each material. Each has a pressure field of its own, because the pressure is
    discontinuous where the material is.
    """

    def __init__(self, mesh, law, order, fixed, active, parameters=None, regions=None):
        stress, energy, self.incompressible, rest_pressure = LAWS[law]
        parameters = PARAMETERS_PA | (parameters or {})
        self.mesh, self.law, self.order = mesh, law, order
        self.energy_density = energy

        body = gf.Mesh("empty", 3)
        if list(body.add_point(mesh.nodes.T)) != list(range(len(mesh.nodes))):
            sys.exit("the mesh has coincident nodes")
        body.add_convex(gf.GeoTrans("GT_PK(3,1)"), np.ascontiguousarray(mesh.nodes[mesh.tets].transpose(2, 1, 0)))
        self.body = body

        self.mf = gf.MeshFem(body, 3)
        self.mf.set_fem(gf.Fem(f"FEM_PK(3,{order})"))
        # One point is exact for linear tets in every law; degree 5 for quadratic ones in the polynomial laws.
        self.mim = gf.MeshIm(body, gf.Integ(f"IM_TETRAHEDRON({1 if order == 1 else 5})"))

        model = gf.Model("real")
        model.add_fem_variable("u", self.mf)
        for name, value in (parameters | {"p0": rest_pressure(parameters)}).items():
            self._add_data(model, name, value)
        pressures = self._add_terms(model, stress, regions or [np.arange(len(mesh.tets))])
        self.model = model

        self.rest = np.array(model.from_variables(), dtype=float)
        start, count = model.interval_of_variable("u")
        self.u = np.arange(start, start + count)
        prescribed = self._displacement_dofs(fixed)
        self.active = self.u[self.vertex_dofs([active])[0]]
        intervals = [model.interval_of_variable(name) for name in pressures]
        self.p = np.concatenate([np.arange(0), *(np.arange(start, start + count) for start, count in intervals)])
        held = np.zeros(len(self.rest), dtype=bool)
        held[self.u[prescribed]] = True
        held[self.active] = True
        self.free = np.flatnonzero(~held)
        self.scale_residual(mesh, self.p)

    def _add_terms(self, model, stress, regions):
        """Adds the weak form and returns the names of the pressure fields, one a region."""
        if not self.incompressible:
            model.add_nonlinear_term(self.mim, f"({stress}):Grad_Test_u", -1, 1, 0)
            return []
        names = [f"p{number}" for number in range(1, len(regions) + 1)]
        for number, (name, tets) in enumerate(zip(names, regions), 1):
            self.body.set_region(number, np.vstack([tets, np.full(len(tets), -1)]))
            field = gf.MeshFem(self.body, 1)
            field.set_fem(gf.Fem("FEM_PK(3,1)"), tets)
            model.add_fem_variable(name, field)
            term = f"({stress}-({name}+p0)*{PRESSURE_STRESS}):Grad_Test_u+(1-{J})*Test_{name}"
            model.add_nonlinear_term(self.mim, term, number, 1, 0)
        return names

    def _add_data(self, model, name, value):
        """A number, or one value per tet as a piecewise constant field."""
        if np.ndim(value) == 0:
            model.add_initialized_data(name, value)
            return
        field = gf.MeshFem(self.body, 1)
        field.set_fem(gf.Fem("FEM_PK(3,0)"))
        values = np.empty(len(value))
        # The body's convexes are the tets in file order, each with one dof of this field.
        dofs, starts = field.basic_dof_from_cvid(np.arange(len(value)))
        if len(dofs) != len(value) or len(starts) != len(value) + 1:
            sys.exit("GetFEM has changed the elements")
        values[dofs] = value
        model.add_initialized_fem_data(name, field, values)

    def vertex_dofs(self, nodes):
        """Dofs of u (within u) at vertices, n x 3."""
        if not hasattr(self, "_dofs"):
            places = {point.tobytes(): node for node, point in enumerate(self.mesh.nodes)}
            points = np.ascontiguousarray(self.mf.basic_dof_nodes().T)
            self._points = points
            self._dofs = np.full((len(self.mesh.nodes), 3), -1)
            for dof in range(0, len(points), 3):  # the three dofs of a node are adjacent
                node = places.get(points[dof].tobytes())
                if node is not None:
                    self._dofs[node] = [dof, dof + 1, dof + 2]
            if (self._dofs < 0).any() or (points[0::3] != points[2::3]).any():
                sys.exit("GetFEM has changed the node positions")
        return self._dofs[np.asarray(nodes)]

    def _displacement_dofs(self, fixed):
        """Dofs of the fixed vertices and, with order 2, of the mid-edge nodes between two of them."""
        dofs = self.vertex_dofs(fixed).ravel().tolist()
        if self.order == 2:
            held = np.zeros(len(self.mesh.nodes), dtype=bool)
            held[np.asarray(fixed)] = True
            pairs = {
                (min(a, b), max(a, b))
                for tet in self.mesh.tets
                for i, a in enumerate(tet)
                for b in tet[:i]
                if held[a] and held[b]
            }
            middles = {}
            for dof in range(0, len(self._points), 3):
                middles[tuple(np.round(self._points[dof], 10))] = dof
            for a, b in pairs:
                dof = middles[tuple(np.round((self.mesh.nodes[a] + self.mesh.nodes[b]) / 2, 10))]
                dofs += [dof, dof + 1, dof + 2]
        return np.array(sorted(dofs))

    # One evaluation each. Timed functions return the seconds of GetFEM's own calls, without copies into
    # Python.

    def residual(self, state):
        """Assembles the residual: (values over all unknowns: N and m3, seconds)."""
        self.model.to_variables(state)
        start = clock()
        self.model.assembly("build_rhs")
        seconds = clock() - start
        return -np.array(self.model.rhs()), seconds

    def tangent(self):
        """Assembles the tangent at the state of the last residual: (matrix over all unknowns, seconds)."""
        start = clock()
        self.model.assembly("build_matrix")
        seconds = clock() - start
        return self.model.tangent_matrix(), seconds

    def solve_linear(self, tangent, right):
        """GetFEM's own choice of solver (MUMPS, symmetric) over the free unknowns: (solution, seconds).

        The system is passed as a separate linear model, because `gf.linsolve_mumps` ignores the symmetry and
        takes 1.3 to 1.9 times as long. Building that model is not counted, and its assembly inside `solve` is
        subtracted.
        """
        linear = gf.Model("real")
        linear.add_variable("x", len(right))
        linear.add_explicit_matrix("x", "x", gf.Spmat("copy", tangent, self.free, self.free), 1, 0)
        linear.add_explicit_rhs("x", right)
        linear.assembly()
        start = clock()
        linear.assembly()
        assembled = clock()
        linear.solve("lsolver", "auto")
        solved = clock()
        return np.array(linear.variable("x")), (solved - assembled) - (assembled - start)

    def coupling(self, tangent, direction):
        """K_fA direction."""
        columns = np.zeros(len(self.rest))
        columns[self.active] = direction
        return np.array(tangent.mult(columns)).ravel()[self.free]

    def energy(self, state):
        self.model.to_variables(state)
        return float(gf.asm_generic(self.mim, 0, self.energy_density, -1, self.model))

    def smallest_jacobian(self, state):
        """Smallest det F over the quadrature points."""
        self.model.to_variables(state)
        points = gf.MeshImData(self.mim, -1)
        return float(np.min(self.model.interpolation(J, points)))
