#!/usr/bin/env python3
"""One PNG of several of the same size, each at half its size, three in a row.

    sheet.py OUT.png IN.png ...
"""

import struct
import sys
import zlib
from pathlib import Path

COLUMNS = 3


def read(path):
    """Width, height and rows of an RGB picture of 8 bits, as palpate writes it."""
    data, at, packed = Path(path).read_bytes(), 8, b""
    while at < len(data):
        (length,), kind = struct.unpack(">I", data[at:at + 4]), data[at + 4:at + 8]
        content = data[at + 8:at + 8 + length]
        if kind == b"IHDR":
            width, height, depth, colour, *_ = struct.unpack(">IIBBBBB", content)
            if (depth, colour) != (8, 2):
                sys.exit(f"sheet: {path}: not RGB of 8 bits")
        packed += content if kind == b"IDAT" else b""
        at += 12 + length
    raw, stride = zlib.decompress(packed), 3 * width
    rows, above = [], bytes(stride)
    for y in range(height):
        start = y * (stride + 1)
        above = unfiltered(raw[start], raw[start + 1:start + 1 + stride], above)
        rows.append(above)
    return width, height, rows


def paeth(a, b, c):
    p = a + b - c
    return min((abs(p - a), 0, a), (abs(p - b), 1, b), (abs(p - c), 2, c))[2]


def unfiltered(kind, line, above):
    if kind == 0:
        return line
    if kind == 2:
        return bytes((x + b) & 255 for x, b in zip(line, above))
    out = bytearray(line)
    for k, b in enumerate(above):
        a, c = (out[k - 3], above[k - 3]) if k > 2 else (0, 0)
        add = {1: a, 3: (a + b) // 2}.get(kind)
        out[k] = (line[k] + (paeth(a, b, c) if add is None else add)) & 255
    return bytes(out)


def halved(picture):
    width, height, rows = picture
    small = []
    for upper, lower in zip(rows[0::2], rows[1::2]):
        row = bytearray(3 * (width // 2))
        for c in range(3):
            four = zip(upper[c::6], upper[c + 3::6], lower[c::6], lower[c + 3::6])
            row[c::3] = bytes(sum(each) // 4 for each in four)
        small.append(bytes(row))
    return width // 2, height // 2, small


def chunk(kind, content):
    return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))


def main():
    out, *paths = sys.argv[1:]
    pictures = [halved(read(path)) for path in paths]
    width, height, _ = pictures[0]
    rows = []
    for first in range(0, len(pictures), COLUMNS):
        line = [picture[2] for picture in pictures[first:first + COLUMNS]]
        rows += [b"\0" + b"".join(parts) for parts in zip(*line)]
    size = struct.pack(">IIBBBBB", COLUMNS * width, len(rows), 8, 2, 0, 0, 0)
    data = zlib.compress(b"".join(rows), 9)
    Path(out).write_bytes(b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", size) + chunk(b"IDAT", data) + chunk(b"IEND", b""))


if __name__ == "__main__":
    main()
