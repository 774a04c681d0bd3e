"""Tetrahedra inside the surface: Gmsh fills it, our own vertex optimisation removes what slivers are left."""

import numpy as np

from . import shape

TET, TRIANGLE = 4, 2  # Gmsh's element types
GOOD_ENOUGH = 36.0  # degrees: a vertex whose tets all reach this is left where it is
# Edges of a tet as corner pairs (i, j), each with the two other corners (k, l): the dihedral angle at ij lies between ijk and ijl.
EDGES = np.array([(0, 1, 2, 3), (0, 2, 1, 3), (0, 3, 1, 2), (1, 2, 0, 3), (1, 3, 0, 2), (2, 3, 0, 1)])


def signed_volumes(x, tets):
    a, b, c, d = (x[tets[:, n]] for n in range(4))
    return np.einsum("ij,ij->i", b - a, np.cross(c - a, d - a)) / 6.0


def dihedral_angles(corners):
    """Angles in degrees, shape (..., 6), of tets given as corner positions (..., 4, 3). Inverted tets get negative angles."""
    i, j, k, l = (corners[..., EDGES[:, n], :] for n in range(4))
    along = j - i
    m, n = np.cross(along, k - i), np.cross(along, l - i)
    cosine = np.sum(m * n, axis=-1) / np.sqrt(np.sum(m * m, axis=-1) * np.sum(n * n, axis=-1) + 1e-60)
    angle = np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))
    ab, ac, ad = (corners[..., n, :] - corners[..., 0, :] for n in (1, 2, 3))
    inside_out = np.sum(ab * np.cross(ac, ad), axis=-1) <= 0.0
    return np.where(inside_out[..., None], -angle, angle)


def fill(surface_x, triangles, size):
    """Tets of the volume inside the closed surface, by Gmsh's Delaunay mesher and its optimisers. The surface stays as given.

    `size((x, y, z))` is the wanted edge length inside. Returns positions (surface vertices first, in order) and tets.
    """
    import gmsh  # here, so that checking the files needs numpy only

    gmsh.initialize(interruptible=False)
    try:
        for option, value in (("General.Terminal", 0), ("General.NumThreads", 1), ("Mesh.RandomSeed", 1), ("Mesh.Algorithm3D", 1)):
            gmsh.option.setNumber(option, value)
        gmsh.option.setNumber("Mesh.MeshSizeExtendFromBoundary", 0)
        gmsh.option.setNumber("Mesh.OptimizeThreshold", 0.5)
        gmsh.model.add("phantom")
        gmsh.model.addDiscreteEntity(2, 1)
        count = len(surface_x)
        gmsh.model.mesh.addNodes(2, 1, list(range(1, count + 1)), surface_x.ravel())
        gmsh.model.mesh.addElementsByType(1, TRIANGLE, [], (triangles + 1).ravel())
        gmsh.model.geo.addSurfaceLoop([1], 1)
        gmsh.model.geo.addVolume([1], 1)
        gmsh.model.geo.synchronize()
        gmsh.model.mesh.setSizeCallback(lambda dim, tag, x, y, z, lc: size((x, y, z)))
        gmsh.model.mesh.generate(3)
        for _ in range(3):
            gmsh.model.mesh.optimize("")
            gmsh.model.mesh.optimize("Netgen")
        tags, coordinates, _ = gmsh.model.mesh.getNodes()
        _, corners = gmsh.model.mesh.getElementsByType(TET)
    finally:
        gmsh.finalize()
    x = dict(zip(tags.tolist(), coordinates.reshape(-1, 3)))
    inside = sorted((t for t in x if t > count), key=lambda t: tuple(np.round(x[t], 6)))
    order = list(range(1, count + 1)) + inside
    rank = {t: n for n, t in enumerate(order)}
    tets = np.array([rank[t] for t in corners.tolist()]).reshape(-1, 4)
    x = np.array([x[t] for t in order])
    tets[signed_volumes(x, tets) < 0.0] = tets[signed_volumes(x, tets) < 0.0][:, [0, 1, 3, 2]]
    return x, tets


def badness(corners, softness=3.0):
    """Sum over a star of tets, dominated by its smallest dihedral angle (and, more weakly, by its largest)."""
    angle = dihedral_angles(corners)
    return np.sum(np.exp(-angle / softness) + 0.1 * np.exp((angle - 180.0) / softness), axis=(-1, -2))


def optimise(x, q, tets, pinned, passes, seed=20100315, tries=24):
    """Moves vertices, interior ones in space and surface ones along the formula, by seeded random search: the sum of `badness`
    over the mesh never grows. `q` holds the unit vectors of the first len(q) vertices, the surface; those in `pinned` stay."""
    random = np.random.default_rng(seed)
    x, q = x.copy(), q.copy()
    star = [[] for _ in x]
    for t, corners in enumerate(tets):
        for v in corners:
            star[v].append(t)
    for sweep in range(passes):
        reach = 0.25 * 0.9**sweep + 0.01
        smallest = dihedral_angles(x[tets]).min(axis=1)
        for v in range(len(x)):
            mine = np.array(star[v])
            if v in pinned or smallest[mine].min() > GOOD_ENOUGH:
                continue
            around = tets[mine]
            span = np.sqrt(np.mean(np.sum((x[around].reshape(-1, 3) - x[v]) ** 2, axis=1)))
            step = reach * span * random.standard_normal((tries, 3)) * random.random((tries, 1))
            if v < len(q):
                new_q = shape.slide(np.broadcast_to(q[v], (tries, 3)), step)
                candidate = shape.point(new_q)
            else:
                candidate = x[v] + step
            corners = np.repeat(x[around][None], tries + 1, axis=0)
            corners[1:][:, around == v] = candidate[:, None]
            score = badness(corners)
            best = int(np.argmin(score))
            if best > 0:
                x[v] = candidate[best - 1]
                if v < len(q):
                    q[v] = new_q[best - 1]
                smallest[mine] = dihedral_angles(x[around]).min(axis=1)
    return x, q
