"""The shape of the phantom, as one smooth map from the unit sphere.

Every surface point is `point(q)` for a unit vector q = (a, b, c):
    a runs from the big lobe (-1, smallest x) to the thin tip (+1, largest x),
    b from the inferior border (-1) to the diaphragm side (+1, largest y),
    c from the visceral side at the back (-1) to the front (+1, largest z).
Because the surface is the image of a sphere it is closed, smooth and of genus 0 by construction, and a mesh vertex that is moved
in q never leaves it. All lengths in this module are millimetres until the last line; `point` returns metres.

The numbers were chosen by eye for this project. Nothing is derived from a scan or from another mesh.
"""

import numpy as np

HALF_LENGTH = 100.0  # the body is 0.2 m across, exactly: x = +-100 mm at a = +-1

# Sections across a: half-height, half-thickness and height of the middle, as polynomials in a (constant term first).
HALF_HEIGHT = (68.0, -30.0, -8.0, 7.0, 1.0)
HALF_THICKNESS = (52.0, -29.0, -8.0, 8.0, 4.0)
MIDDLE_HEIGHT = (6.0, 22.0, 4.0, -1.0)

WEDGE = 0.30  # the section is this much thicker at the top than in the middle, thinner at the inferior border
LEAN = 0.28  # the inferior border stands this much of the half-height in front of the middle
SPINE_BEND = 22.0  # both ends bend back around the spine

HOLLOW_DEPTH = 34.0  # the concave visceral side: centre and widths in (a, b)
HOLLOW_CENTRE = (0.00, -0.30)
HOLLOW_WIDTH = (0.50, 0.60)

NOTCH_X, NOTCH_WIDTH = 22.0, 19.0  # between the two lobes, in the inferior border ...
NOTCH_HEIGHT = 17.0
NOTCH_GROOVE = 5.0  # ... and as a groove that runs on over the visceral side

SADDLE_X, SADDLE_WIDTH, SADDLE_DEPTH = 35.0, 30.0, 10.0  # where the heart would lie, on the upper side of the thin lobe


def polynomial(coefficients, a):
    return sum(k * a**n for n, k in enumerate(coefficients))


def bell(t):
    return np.exp(-(t**2))


def point(q):
    """Surface point in metres for each unit vector in the last axis of `q` (smooth, and used, a little off the sphere too)."""
    a, b, c = q[..., 0], q[..., 1], q[..., 2]
    half_height = polynomial(HALF_HEIGHT, a)
    x = HALF_LENGTH * a
    y = polynomial(MIDDLE_HEIGHT, a) + half_height * b
    z = polynomial(HALF_THICKNESS, a) * c * (1.0 + WEDGE * b)
    z = z - LEAN * half_height * b - SPINE_BEND * a**2

    low, high, back = 0.5 * (1.0 - b), 0.5 * (1.0 + b), 0.5 * (1.0 - c)
    hollow = bell((a - HOLLOW_CENTRE[0]) / HOLLOW_WIDTH[0]) * bell((b - HOLLOW_CENTRE[1]) / HOLLOW_WIDTH[1])
    z = z + HOLLOW_DEPTH * hollow * back**2
    notch = bell((x - NOTCH_X) / NOTCH_WIDTH)
    y = y + NOTCH_HEIGHT * notch * low**4
    z = z + NOTCH_GROOVE * notch * low * back**2
    y = y - SADDLE_DEPTH * bell((x - SADDLE_X) / SADDLE_WIDTH) * high**3
    return 1e-3 * np.stack([x, y, z], axis=-1)


def unit(q):
    return q / np.linalg.norm(q, axis=-1, keepdims=True)


def slide(q, step):
    """Moves `q` on the sphere so that `point(q)` moves by about the tangential part of `step` (metres)."""
    h = 1e-5
    jacobian = np.stack([point(q + h * e) - point(q - h * e) for e in np.eye(3)], axis=-1) / (2.0 * h)
    return unit(q + np.linalg.solve(jacobian, step[..., None])[..., 0])
