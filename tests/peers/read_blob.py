#!/usr/bin/env python3
"""Reads a .blob with numpy alone, by docs/formats.md, section 4: an example for readers in other languages.

    read_blob.py FILE.blob                                    prints the contents
    read_blob.py FILE.blob --points IN.csv --csv OUT.csv [--active A1] [--method energy] [--displacements]
        forces at displacements of the active node; the columns are those of `palpate query`

Methods: trilinear, hermite, energy, kernel. Arithmetic is f64 here and f32 in the core: they differ by about
1e-5 N for forces of newtons. Exit code 0, or 2 with one line on standard error.
"""

import argparse
import json
import struct
import sys
import zlib

import numpy as np

MAGIC = b"PALPATE\0"
VERSION = 6
ALIGNMENT = 64
SOLVED, TERMINATING, INVERTED, CELL, SUPERCELL, INTERIOR, BRANCH_JUMP, SMOOTH = (1 << n for n in range(8))


class Refused(Exception):
    pass


class Header:
    """Postcard: varints of seven bits per byte, low bits first; f32 in four bytes; options are 0, or 1 and the
    value."""

    def __init__(self, data):
        self.data, self.at = data, 0

    def take(self, count):
        if self.at + count > len(self.data):
            raise Refused("the header is truncated")
        self.at += count
        return self.data[self.at - count : self.at]

    def varint(self):
        value, shift = 0, 0
        while True:
            byte = self.take(1)[0]
            value |= (byte & 127) << shift
            shift += 7
            if byte < 128:
                return value
            if shift > 63:
                raise Refused("a varint in the header is too long")

    def text(self):
        return self.take(self.varint()).decode()

    def f32(self):
        return struct.unpack("<f", self.take(4))[0]

    def f32s(self, count):
        return [self.f32() for _ in range(count)]

    def optional(self, read):
        flag = self.take(1)[0]
        if flag > 1:
            raise Refused("an option in the header is neither 0 nor 1")
        return read() if flag else None

    def plane(self):
        """Offset in bytes from the start of the plane area, and length in elements."""
        return self.varint(), self.varint()

    def planes(self, count):
        return [self.plane() for _ in range(count)]


class Blob:
    def __init__(self, data):
        if len(data) < 28 or data[:8] != MAGIC:
            raise Refused("not a blob")
        version, header_len, total_len = struct.unpack_from("<IIQ", data, 8)
        if total_len != len(data):
            raise Refused(f"the file has {len(data)} bytes, its header states {total_len}")
        if struct.unpack("<I", data[-4:])[0] != zlib.crc32(data[:-4]):
            raise Refused("checksum mismatch: the file is damaged")
        if version != VERSION:
            raise Refused(f"layout version {version} is not supported; supported: {VERSION}")
        start = -(-(24 + header_len) // ALIGNMENT) * ALIGNMENT
        self.area = data[start:-4]
        self.bytes = len(data)
        header = Header(data[24 : 24 + header_len])

        self.scene, self.law = header.text(), header.text()
        self.max_force_n = header.f32()
        self.mesh_hash = header.take(32).hex()
        node, x, y, z, triangles, fixed = header.planes(6)
        self.node = self.plane(node, "<u4")
        self.position_m = np.stack([self.plane(p, "<f4") for p in (x, y, z)], axis=1)
        self.triangles = self.plane(triangles, "<u4", 3)
        self.fixed = self.plane(fixed, "u1")
        # Contact points of a tool with a size: the space of each vertex, and triangles between them.
        space, x, y, z, triangles, _ = header.planes(6)
        self.contact_space = self.plane(space, "<u4")
        self.contact_m = np.stack([self.plane(p, "<f4") for p in (x, y, z)], axis=1)
        self.contact_triangles = self.plane(triangles, "<u4", 3)
        self.fingertip = header.optional(lambda: header.f32s(2))
        certificate = header.optional(header.plane)
        self.certificate = certificate and json.loads(self.plane(certificate, "u1").tobytes())
        self.spaces = [Space(self, header) for _ in range(header.varint())]
        if header.at != len(header.data):
            raise Refused("the header has data after its last space")

    def plane(self, reference, kind, width=1):
        """A plane as an array; an element has `width` numbers."""
        offset, length = reference
        kind = np.dtype(kind)
        end = offset + length * width * kind.itemsize
        if offset % ALIGNMENT or end > len(self.area):
            raise Refused("a plane exceeds the file")
        plane = np.frombuffer(self.area[offset:end], kind)
        return plane.reshape(-1, width) if width > 1 else plane


class Space:
    def __init__(self, blob, header):
        self.name, self.node = header.text(), header.varint()
        self.rest_position_m, self.outward_normal = header.f32s(3), header.f32s(3)
        self.spacing_m, self.radius_m = header.f32s(2)
        self.flags = blob.plane(header.plane(), "u1")
        force = header.optional(header.plane)
        self.force = force and blob.plane(force, "<f4", 3).astype(float)
        linear = header.optional(lambda: header.planes(6))
        self.rbf_linear = linear and [blob.plane(p, "<f4") for p in linear]
        cubic = header.optional(lambda: header.planes(6))
        self.rbf_cubic = cubic and [blob.plane(p, "<f8") for p in cubic]
        hermite = header.optional(lambda: header.planes(2))
        self.hermite = None
        if hermite:
            row, nodes = blob.plane(hermite[0], "<u4"), blob.plane(hermite[1], "<f4", 36)
            # [slot][a][b][c]; every fourth number is padding.
            self.hermite = nodes.reshape(-1, 3, 3, 4)[row, :, :, :3].astype(float)
        self.displacement = header.optional(lambda: Displacement(blob, header))
        self.kernel = header.optional(lambda: Kernel(blob, header, self.radius_m))

        # Slots: the integer points of the box -E..E, z fastest. R is the radius in cells, rounded up with a
        # tolerance.
        cells = self.radius_m / self.spacing_m
        self.reach = int(np.ceil(cells * (1.0 - 1e-6)))
        self.side = 2 * self.reach + 3
        if len(self.flags) != self.side**3:
            raise Refused(f"space {self.name}: {len(self.flags)} flags, expected {self.side}^3")

    def methods(self):
        found = []
        if self.force is not None:
            found += ["trilinear", "tricubic", "hybrid"]
        found += ["rbf-linear"] * (self.rbf_linear is not None) + ["rbf-cubic"] * (self.rbf_cubic is not None)
        found += ["hermite", "energy"] * (self.hermite is not None)
        return found + ["kernel"] * (self.kernel is not None)

    def slot(self, ijk):
        i, j, k = (n + self.reach + 1 for n in ijk)
        return (i * self.side + j) * self.side + k

    def corners(self, low):
        """Slots of a cell's corners as [x][y][z]."""
        ends = ((a, b, c) for a in (0, 1) for b in (0, 1) for c in (0, 1))
        return np.array([self.slot([n + e for n, e in zip(low, end)]) for end in ends]).reshape(2, 2, 2)

    def locate(self, at_m):
        """Low corner of the cell, position in it, outward direction, distance beyond the ball; rest for a NaN."""
        at = np.asarray(at_m, np.float32).astype(float)
        if not np.isfinite(at).all():
            at = np.zeros(3)
        length, outward, beyond = np.linalg.norm(at), np.zeros(3), 0.0
        if length > self.radius_m:
            outward, beyond = at / length, length - self.radius_m
            at = self.radius_m * outward
        cells = at / self.spacing_m
        low = np.clip(np.floor(cells), -self.reach, self.reach - 1).astype(int)
        return low, cells - low, outward, beyond

    def smooth_share(self, low, t):
        """1 away from branch jumps, 0 in a cell with one (flag BRANCH_JUMP), and a smooth step between."""
        slots = self.corners(low)
        if self.flags[slots[0, 0, 0]] & BRANCH_JUMP:
            return 0.0
        w = np.einsum("i,j,k,ijk", *linear(t), (self.flags[slots] & SMOOTH) != 0)
        return w * w * (3.0 - 2.0 * w)

    def tricubic_force(self, low, t):
        """Catmull-Rom interpolation of the 64 points around a cell."""
        ends = ((a, b, c) for a in range(-1, 3) for b in range(-1, 3) for c in range(-1, 3))
        slots = np.array([self.slot([n + e for n, e in zip(low, end)]) for end in ends]).reshape(4, 4, 4)
        return np.einsum("i,j,k,ijkn->n", *map(catmull_rom, t), self.force[slots])

    def cell_force(self, method, low, t, share):
        """h in a cell, N; t may be slightly outside. `share` is the weight of the energy interpolant."""
        slots = self.corners(low)
        if method == "trilinear":
            return np.einsum("i,j,k,ijkn->n", *linear(t), self.force[slots])
        derivatives = self.hermite[slots]
        if method == "hermite":
            return cubic_force(derivatives, t)
        return (1.0 - share) * cubic_force(derivatives, t) + share * energy_gradient(derivatives, t)

    def force_n(self, method, at_m):
        """h at any displacement, N, and whether the method has data on all sides."""
        if method not in self.methods() or method not in ("trilinear", "hermite", "energy", "kernel"):
            raise Refused(f"{method} is not in space {self.name} or not supported by this reader")
        if method == "kernel":
            return self.kernel.force_n(at_m, self.spacing_m)
        low, t, outward, beyond = self.locate(at_m)
        share = self.smooth_share(low, t)
        force = self.cell_force(method, low, t, share)
        if beyond > 0.0:
            # Linear at first, then constant, with a slope that is continuous along the rim.
            step = 1e-4
            steady = self.tricubic_force if method == "trilinear" else lambda low, t: self.cell_force(method, low, t, share)
            ends = (steady(low, t + sign * step * outward) for sign in (1, -1))
            slope = np.subtract(*ends) / (2.0 * step * self.spacing_m)
            rise = beyond - 0.5 * beyond**2 / self.spacing_m if beyond < self.spacing_m else 0.5 * self.spacing_m
            force = force + rise * slope
        inside = beyond == 0.0 and np.isfinite(at_m).all()
        return force, bool(inside and self.flags[self.slot(low)] & CELL)

    def displacement_m(self, at_m):
        """Displacement of every surface vertex, m."""
        low, t, _, _ = self.locate(at_m)
        slopes = self.smooth_share(low, t) if self.displacement.slopes else 0.0
        return self.displacement.at(self.corners(low), t, slopes)


class Kernel:
    def __init__(self, blob, header, radius_m):
        scalars, blocks, reach = header.planes(3)
        scalars = blob.plane(scalars, "<f8")
        self.length_m, (xx, xy, xz, yy, yz, zz) = scalars[0], scalars[1:]
        self.base = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        # One row per configuration: its position, then the derivatives of its polynomial.
        numbers = blob.plane(blocks, "<f8", 92).reshape(-1, 23, 4).transpose(0, 2, 1).reshape(-1, 23)
        self.at, self.numbers = numbers[:, :3], numbers[:, 3:]
        self.reach_m = blob.plane(reach, "u1").reshape(9, 9, 9) * (radius_m / 255.0)

    def sum(self, x):
        """Gradient of the sum of Gaussians times polynomials."""
        r = x - self.at
        power = [np.stack([np.ones(len(r)), r[:, i], r[:, i] ** 2 / 2, r[:, i] ** 3 / 6]) for i in range(3)]
        slope = [np.concatenate([np.zeros((1, len(r))), p[:3]]) for p in power]
        of = lambda along: [
            np.prod([(slope if i == along else power)[i][o[i]] for i in range(3)], axis=0) for o in KERNEL_ORDERS
        ]
        value = np.einsum("on,no->n", of(None), self.numbers)
        gaussian = np.exp(-0.5 * (r * r).sum(axis=1))
        return np.array([(gaussian * (np.einsum("on,no->n", of(i), self.numbers) - r[:, i] * value)).sum() for i in range(3)])

    def towards_m(self, at):
        if not at.any():
            return self.reach_m.max()
        cells = at / np.abs(at).max() * 4.0 + 4.0
        low = np.minimum(cells.astype(int), 7)
        i, j, k = low
        return np.einsum("i,j,k,ijk", *linear(cells - low), self.reach_m[i : i + 2, j : j + 2, k : k + 2])

    def force_n(self, at_m, spacing_m):
        at = np.asarray(at_m, np.float32).astype(float)
        if not np.isfinite(at).all():
            return np.zeros(3), False
        within = lambda at: self.base @ at / self.length_m + self.sum(at / self.length_m) - self.sum(np.zeros(3))
        length, reach = np.linalg.norm(at), self.towards_m(at)
        if length <= reach:
            return within(at), True
        outward, beyond, step = at / length, length - reach, 1e-6
        slope = (within((reach + step) * outward) - within((reach - step) * outward)) / (2.0 * step)
        rise = beyond - 0.5 * beyond**2 / spacing_m if beyond < spacing_m else 0.5 * spacing_m
        return within(reach * outward) + rise * slope, False


KERNEL_ORDERS = [
    (a, b, n - a - b) for n in range(4) for a in range(n, -1, -1) for b in range(n - a, -1, -1)
]


class Displacement:
    def __init__(self, blob, header):
        self.slopes = header.varint()
        row, modes, scale, coefficients, outlier_row, outlier_scale, outliers = header.planes(7)
        vertices = len(blob.node)
        self.row = blob.plane(row, "<u4")
        scale = blob.plane(scale, "<f4").astype(float)
        self.modes = blob.plane(modes, "<i2").reshape(len(scale), vertices, 3) * scale[:, None, None]
        self.coefficients = blob.plane(coefficients, "<i2").reshape(-1, len(scale) + 3 * self.slopes).astype(float)
        scale = blob.plane(outlier_scale, "<f4").astype(float)
        outliers = blob.plane(outliers, "<i2").reshape(len(scale), vertices, 3) * scale[:, None, None]
        self.outliers = dict(zip(blob.plane(outlier_row, "<u4").tolist(), outliers))

    def at(self, slots, t, share):
        """Displacements; `share` is the weight of the slopes, 0 to 1."""
        rows = self.row[slots]
        (lx, ly, lz), (hx, hy, hz), (gx, gy, gz) = linear(t), *zip(*map(cubic, t))
        weight = lambda a, b, c: np.einsum("i,j,k->ijk", a, b, c)
        tri = weight(lx, ly, lz)
        value = weight(hx, ly, lz) + weight(lx, hy, lz) + weight(lx, ly, hz) - 2.0 * tri
        value = tri + share * (value - tri)
        along = [share * weight(*w) for w in ((gx, ly, lz), (lx, gy, lz), (lx, ly, gz))]
        numbers, count, n = self.coefficients[rows], len(self.modes), self.slopes
        factors = np.einsum("ijk,ijkm->m", tri, numbers[..., :count])
        if n:
            factors[:n] = np.einsum("ijk,ijkm->m", value, numbers[..., :n])
            for axis, weights in enumerate(along):
                first = count + axis * n
                factors[:n] += np.einsum("ijk,ijkm->m", weights, numbers[..., first : first + n])
        moved = np.einsum("m,mvx->vx", factors, self.modes)
        for row, w in zip(rows.flat, tri.flat):
            if int(row) in self.outliers:
                moved = moved + w * self.outliers[int(row)]
        return moved


def linear(t):
    """Weights of the two ends of each axis."""
    return [np.array([1.0 - x, x]) for x in t]


def catmull_rom(t):
    """Weights of four neighbours."""
    s = 1.0 - t
    inner = lambda x: 1.0 + x * x * (1.5 * x - 2.5)
    return np.array([-0.5 * t * s * s, inner(t), inner(s), -0.5 * s * t * t])


def cubic(t):
    """Cubic Hermite: weights of the values and of the slopes at both ends."""
    s = 1.0 - t
    return np.array([(1.0 + 2.0 * t) * s * s, (3.0 - 2.0 * t) * t * t]), np.array([t * s * s, -s * t * t])


def cubic_force(w, t):
    """Each component of h from its value and mixed first derivatives at the corners: W_(a + [i = 0], ...)."""
    axes = [np.stack(cubic(x), axis=1) for x in t]  # [end][order]
    pick = lambda i: w[(...,) + tuple(slice(1, 3) if axis == i else slice(0, 2) for axis in range(3))]
    return np.array([np.einsum("ia,jb,kc,ijkabc", *axes, pick(i)) for i in range(3)])


# Quintic Hermite in powers of t: value, slope and curvature at 0, then at 1.
QUINTIC = np.array(
    [
        [1.0, 0.0, 0.0, -10.0, 15.0, -6.0],
        [0.0, 1.0, 0.0, -6.0, 8.0, -3.0],
        [0.0, 0.0, 0.5, -1.5, 1.5, -0.5],
        [0.0, 0.0, 0.0, 10.0, -15.0, 6.0],
        [0.0, 0.0, 0.0, -4.0, 7.0, -3.0],
        [0.0, 0.0, 0.0, 0.5, -1.0, 0.5],
    ]
)


def energy_gradient(w, t):
    """h = dW/dt of the quintic Hermite interpolant of W, with all 27 derivatives at each corner."""
    powers = np.arange(6)
    values = [(QUINTIC @ x**powers).reshape(2, 3) for x in t]
    slopes = [(QUINTIC[:, 1:] @ (powers[1:] * x ** powers[:5])).reshape(2, 3) for x in t]
    along = lambda i: [slopes[axis] if axis == i else values[axis] for axis in range(3)]
    return np.array([np.einsum("ia,jb,kc,ijkabc", *along(i), w) for i in range(3)])


def show(blob):
    print(f"scene {blob.scene}, law {blob.law}, f_max {blob.max_force_n:g} N, {blob.bytes} bytes")
    print(f"mesh {blob.mesh_hash[:16]}, surface of {len(blob.node)} vertices and {len(blob.triangles)} triangles")
    for space in blob.spaces:
        solved = np.count_nonzero(space.flags & SOLVED)
        print(f"space {space.name} (node {space.node}): r_G {space.radius_m:g} m, spacing {space.spacing_m:g} m, ", end="")
        print(f"{solved} solved, {np.count_nonzero(space.flags & BRANCH_JUMP)} cells with a branch jump; {', '.join(space.methods())}")
        if space.displacement:
            d = space.displacement
            print(f"  displacements: {len(d.modes)} modes, {d.slopes} with slopes, {len(d.outliers)} outliers")
    print("no certificate" if blob.certificate is None else f"certificate of {len(blob.certificate['spaces'])} spaces")


def query(blob, options):
    spaces = [s for s in blob.spaces if options.active in (None, s.name)]
    if not spaces:
        raise Refused(f"unknown active node {options.active}; known: {', '.join(s.name for s in blob.spaces)}")
    space = spaces[0]
    points = np.genfromtxt(options.points, delimiter=",", names=True, ndmin=1)
    columns = ["x_m", "y_m", "z_m", "fx_n", "fy_n", "fz_n", "coverage"]
    if options.displacements:
        if space.displacement is None:
            raise Refused(f"space {space.name} has no displacements")
        columns += [f"u{node}_{axis}_m" for node in blob.node for axis in "xyz"]
    with open(options.csv, "w") as out:
        print(",".join(columns), file=out)
        for point in points:
            at = np.array([point["x_m"], point["y_m"], point["z_m"]])
            force, covered = space.force_n(options.method, at)
            cells = [*map(repr, map(float, (*at, *force))), "cell" if covered else "extrapolated"]
            if options.displacements:
                cells += [repr(float(x)) for x in space.displacement_m(at).flat]
            print(",".join(cells), file=out)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("blob")
    parser.add_argument("--points")
    parser.add_argument("--csv")
    parser.add_argument("--active")
    parser.add_argument("--method", default="energy")
    parser.add_argument("--displacements", action="store_true")
    options = parser.parse_args()
    if (options.points is None) != (options.csv is None):
        parser.error("--points and --csv must be given together")
    try:
        with open(options.blob, "rb") as file:
            blob = Blob(file.read())
        query(blob, options) if options.points else show(blob)
    except (OSError, Refused, ValueError) as error:
        print(f"read_blob: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
