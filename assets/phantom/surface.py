"""Isotropic triangulation of the phantom's surface with a wanted edge length (split, collapse, flip, relax).

The vertices live on the unit sphere (see `shape`), the lengths are measured on the organ. Start: a subdivided icosahedron.
"""

import math

import numpy as np

from . import shape


# Plain tuples: for one vector at a time they are ten times faster than arrays.
def minus(a, b):
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2])


def dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def cross(a, b):
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def norm(a):
    return math.sqrt(dot(a, a))


def normal(a, b, c):
    return cross(minus(b, a), minus(c, a))


def between(a, b):
    return tuple(0.5 * (u + v) for u, v in zip(a, b))


def point(q):
    return tuple(shape.point(q).tolist())


def icosphere(level):
    """Unit icosahedron, each triangle cut in four `level` times; outward orientation."""
    g = (1.0 + 5.0**0.5) / 2.0
    q = [(-1, g, 0), (1, g, 0), (-1, -g, 0), (1, -g, 0), (0, -1, g), (0, 1, g), (0, -1, -g), (0, 1, -g)]
    q += [(g, 0, -1), (g, 0, 1), (-g, 0, -1), (-g, 0, 1)]
    tri = [(0, 11, 5), (0, 5, 1), (0, 1, 7), (0, 7, 10), (0, 10, 11), (1, 5, 9), (5, 11, 4), (11, 10, 2), (10, 7, 6), (7, 1, 8)]
    tri += [(3, 9, 4), (3, 4, 2), (3, 2, 6), (3, 6, 8), (3, 8, 9), (4, 9, 5), (2, 4, 11), (6, 2, 10), (8, 6, 7), (9, 8, 1)]
    q = [np.array(p, float) / np.linalg.norm(p) for p in q]
    for _ in range(level):
        middle, finer = {}, []

        def mid(i, j):
            key = (min(i, j), max(i, j))
            if key not in middle:
                middle[key] = len(q)
                q.append(shape.unit(q[i] + q[j]))
            return middle[key]

        for i, j, k in tri:
            a, b, c = mid(i, j), mid(j, k), mid(k, i)
            finer += [(i, a, c), (a, j, b), (c, b, k), (a, b, c)]
        tri = finer
    return np.array(q), [tuple(t) for t in tri]


class Surface:
    """A closed triangulation that is edited in place. `triangles` maps a serial number to a vertex triple."""

    def __init__(self, q, tri):
        self.q = {i: p for i, p in enumerate(q)}
        self.x = {i: point(p) for i, p in self.q.items()}
        self.triangles = dict(enumerate(tri))
        self.star = {i: set() for i in self.q}
        for t, corners in self.triangles.items():
            for v in corners:
                self.star[v].add(t)
        self.next_vertex, self.next_triangle = len(self.q), len(self.triangles)
        self.pinned = set()

    def length(self, i, j):
        return norm(minus(self.x[i], self.x[j]))

    def edges(self):
        return sorted({(min(a, b), max(a, b)) for i, j, k in self.triangles.values() for a, b in ((i, j), (j, k), (k, i))})

    def neighbours(self, v):
        return sorted({w for t in self.star[v] for w in self.triangles[t]} - {v})

    def add(self, *corners):
        t = self.next_triangle
        self.next_triangle += 1
        self.triangles[t] = corners
        for v in corners:
            self.star[v].add(t)

    def drop(self, t):
        for v in self.triangles.pop(t):
            self.star[v].discard(t)

    def wings(self, i, j):
        """The two triangles at the edge and the vertices opposite to it: (t, opposite) with i -> j in t first."""
        sides = []
        for t in sorted(self.star[i] & self.star[j]):
            corners = self.triangles[t]
            opposite = next(v for v in corners if v not in (i, j))
            forward = corners[(corners.index(i) + 1) % 3] == j
            sides.append((not forward, t, opposite))
        sides.sort()
        return [(t, o) for _, t, o in sides]

    def normal(self, corners):
        return normal(*(self.x[v] for v in corners))

    def pin(self, q):
        """Moves the nearest vertex to `q` and keeps it there."""
        x = point(q)
        v = min(sorted(set(self.q) - self.pinned), key=lambda v: norm(minus(self.x[v], x)))
        self.q[v], self.x[v] = q, x
        self.pinned.add(v)

    def split(self, i, j):
        (s, k), (t, l) = self.wings(i, j)
        m = self.next_vertex
        self.next_vertex += 1
        self.q[m] = shape.unit(self.q[i] + self.q[j])
        self.x[m], self.star[m] = point(self.q[m]), set()
        self.drop(s)
        self.drop(t)
        for corners in ((i, m, k), (m, j, k), (j, m, l), (m, i, l)):
            self.add(*corners)

    def collapse(self, i, j, longest):
        """Merges the edge into one vertex at its middle, or at its pinned end, unless that tangles, folds or makes an edge too long."""
        if j in self.pinned:
            i, j = j, i
        if j in self.pinned:
            return False
        ni, nj = self.neighbours(i), self.neighbours(j)
        if len(set(ni) & set(nj)) != 2 or min(len(self.neighbours(o)) for _, o in self.wings(i, j)) <= 4:
            return False
        q = self.q[i] if i in self.pinned else shape.unit(self.q[i] + self.q[j])
        x = point(q)
        if any(norm(minus(self.x[v], x)) > longest(between(self.x[v], x)) for v in set(ni + nj) - {i, j}):
            return False
        shared = self.star[i] & self.star[j]
        for v in (i, j):
            for t in self.star[v] - shared:
                corners = self.triangles[t]
                new = normal(*(x if w == v else self.x[w] for w in corners))
                old = self.normal(corners)
                if dot(new, old) <= 0.5 * norm(new) * norm(old):
                    return False
        for t in sorted(shared):
            self.drop(t)
        for t in sorted(self.star[j]):
            corners = tuple(i if v == j else v for v in self.triangles[t])
            self.drop(t)
            self.add(*corners)
        del self.q[j], self.x[j], self.star[j]
        self.q[i], self.x[i] = q, x
        return True

    def flip_if_better(self, i, j):
        """Flips the edge if that raises the smallest of the six angles and folds nothing."""
        (s, k), (t, l) = self.wings(i, j)
        if l in self.neighbours(k) or len(self.neighbours(i)) <= 4 or len(self.neighbours(j)) <= 4:
            return False
        old, new = ((i, j, k), (j, i, l)), ((i, l, k), (l, j, k))
        mean = minus(self.normal(old[0]), self.normal(old[1][::-1]))
        if any(dot(self.normal(c), mean) <= 0.3 * norm(self.normal(c)) * norm(mean) for c in new):
            return False
        if min(map(self.smallest_angle, new)) <= min(map(self.smallest_angle, old)) + 1e-9:
            return False
        self.drop(s)
        self.drop(t)
        for corners in new:
            self.add(*corners)
        return True

    def smallest_angle(self, corners):
        p = [self.x[v] for v in corners]
        cosines = []
        for n in range(3):
            u, v = minus(p[n - 1], p[n]), minus(p[n - 2], p[n])
            cosines.append(dot(u, v) / (norm(u) * norm(v)))
        return math.acos(min(1.0, max(cosines)))

    def relax(self, edge_length, strength):
        """Moves every free vertex along the surface: to the centre of its triangles, and away from neighbours that are too near."""
        order = sorted(set(self.q) - self.pinned)
        step = []
        for v in order:
            weight, centre = 0.0, np.zeros(3)
            for t in sorted(self.star[v]):
                corners = self.triangles[t]
                area = norm(self.normal(corners))
                weight += area
                centre += area * np.sum([self.x[w] for w in corners], axis=0) / 3.0
            move = centre / weight - self.x[v]
            around = self.neighbours(v)
            for w in around:
                apart = np.subtract(self.x[v], self.x[w])
                stretch = edge_length(self.x[v]) / norm(apart) - 1.0
                move += 1.5 * max(stretch, 0.0) / len(around) * apart
            step.append(move)
        q = shape.slide(np.array([self.q[v] for v in order]), strength * np.array(step))
        for v, p, x in zip(order, q, shape.point(q).tolist()):
            self.q[v], self.x[v] = p, tuple(x)


def triangulate(edge_length, pins, rounds=18, level=4):
    """Surface mesh whose edges are about `edge_length(x)` long at x, with a vertex exactly at each unit vector of `pins`.

    Returns unit vectors, outward triangles and the vertices at the pins."""
    surface = Surface(*icosphere(level))
    longest = lambda x: 4.0 / 3.0 * edge_length(x)
    for turn in range(rounds):
        if turn == 2:
            for q in pins:
                surface.pin(q)
        for i, j in surface.edges():
            if surface.length(i, j) > longest(between(surface.x[i], surface.x[j])):
                surface.split(i, j)
        for i, j in surface.edges():
            if i in surface.q and j in surface.q and surface.star[i] & surface.star[j]:
                if surface.length(i, j) < 0.8 * edge_length(between(surface.x[i], surface.x[j])):
                    surface.collapse(i, j, longest)
        for _ in range(3):
            for _ in range(5):
                flips = [surface.flip_if_better(i, j) for i, j in surface.edges() if surface.star[i] & surface.star[j]]
                if not any(flips):
                    break
            surface.relax(edge_length, 0.5)
    # Vertex order by x: neighbours in space are near in the file, and the order does not tell how the mesh was edited.
    order = sorted(surface.q, key=lambda v: tuple(np.round(surface.x[v], 6)))
    rank = {v: n for n, v in enumerate(order)}
    tri = []
    for corners in surface.triangles.values():
        r = [rank[v] for v in corners]
        n = r.index(min(r))
        tri.append((r[n], r[n - 2], r[n - 1]))
    return np.array([surface.q[v] for v in order]), np.array(sorted(tri)), sorted(rank[v] for v in surface.pinned)
