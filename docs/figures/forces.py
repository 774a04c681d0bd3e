#!/usr/bin/env python3
"""Draws the forces of two `palpate bench live --csv` as SVG: over time, and over the displacement where a body folds.

    forces.py PRESS.csv FOLD.csv OUT.svg
"""

import csv
import math
import sys
from pathlib import Path

WIDTH, HEIGHT, LEFT, TOP = 550, 396, 52, 34
RIGHT, BOTTOM = 16, 48
TRUE = ("#9a9a9a", 5)


def columns(path, until_ms=math.inf):
    """Time in s, displacement in mm, felt and true force in N."""
    found = []
    with open(path, encoding="utf-8") as file:
        for row in csv.DictReader(file):
            length = [math.hypot(*(float(row[f"{key}{axis}_{unit}"]) for axis in "xyz"))
                      for key, unit in (("d", "m"), ("felt_f", "n"), ("true_f", "n"))]
            found.append((float(row["t_ms"]) * 1e-3, 1e3 * length[0], length[1], length[2]))
    return [row for row in found if row[0] <= until_ms * 1e-3]


def ticks(low, high):
    step = 10 ** math.floor(math.log10((high - low) / 4))
    step *= next(k for k in (1, 2, 5, 10) if (high - low) / (k * step) <= 8)
    return [round(k * step, 6) for k in range(math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9) + 1)]


class Panel:
    """One plot: title, its axes, and where its points lie."""

    def __init__(self, left, title, axes, x, y):
        self.left, self.x, self.y = left + LEFT, x, y
        self.parts = [f'<text x="{self.left}" y="20" class="title">{title}</text>']
        bottom = HEIGHT - BOTTOM
        for value in ticks(*x):
            at = self.at(value, y[0])[0]
            self.parts.append(f'<line x1="{at:.1f}" x2="{at:.1f}" y1="{TOP}" y2="{bottom}"/>'
                              f'<text x="{at:.1f}" y="{bottom + 18}" text-anchor="middle">{value:g}</text>')
        for value in ticks(*y):
            at = self.at(x[0], value)[1]
            self.parts.append(f'<line x1="{self.left}" x2="{left + WIDTH - RIGHT}" y1="{at:.1f}" y2="{at:.1f}"/>'
                              f'<text x="{self.left - 6}" y="{at + 4:.1f}" text-anchor="end">{value:g}</text>')
        middle = self.left + (WIDTH - LEFT - RIGHT) / 2
        self.parts.append(f'<text x="{middle}" y="{HEIGHT - 8}" text-anchor="middle">{axes[0]}</text>')
        up = (TOP + bottom) / 2
        self.parts.append(f'<text transform="translate({left + 14} {up}) rotate(-90)" text-anchor="middle">{axes[1]}</text>')

    def at(self, x, y):
        (x0, x1), (y0, y1) = self.x, self.y
        return (self.left + (x - x0) / (x1 - x0) * (WIDTH - LEFT - RIGHT),
                HEIGHT - BOTTOM - (y - y0) / (y1 - y0) * (HEIGHT - TOP - BOTTOM))

    def line(self, points, colour, width, name, place):
        runs, style = [[]], f'fill="none" stroke="{colour}" stroke-width="{width}" stroke-linejoin="round"'
        for point in points:
            is_inside = self.x[0] <= point[0] <= self.x[1] and self.y[0] <= point[1] <= self.y[1]
            runs += [] if is_inside or not runs[-1] else [[]]
            runs[-1] += [point] if is_inside else []
        for run in runs:
            path = " ".join("{:.1f},{:.1f}".format(*self.at(*point)) for point in run)
            self.parts.append(f'<polyline {style} points="{path}"/>')
        x, y = self.left + 12, TOP + 14 + 18 * place
        self.parts.append(f'<path d="M{x} {y - 4}h26" {style}/><text x="{x + 34}" y="{y}">{name}</text>')


def drawn(press, fold):
    high = max(row[3] for row in press)
    time = Panel(0, "large organ, presses to 27 mm at 200 mm/s", ("time, s", "force on the body, N"),
                 (0, press[-1][0]), (0, math.ceil(high * 1.05)))
    time.line([(row[0], row[3]) for row in press], *TRUE, "full solution", 0)
    time.line([(row[0], row[2]) for row in press], "#0072b2", 1.6, "felt", 1)
    near = [row for row in fold if row[1] >= 30]
    low, high = min(min(row[2:]) for row in near), max(max(row[2:]) for row in near)
    folds = Panel(WIDTH, "folds of St. Venant-Kirchhoff, there and back at 50 mm/s", ("displacement, mm", "force on the body, N"),
                  (30, max(row[1] for row in near) + 0.3), (low - 0.05, high + 0.2))
    folds.line([row[1::2] for row in fold], *TRUE, "full solution", 0)
    folds.line([row[1:3] for row in fold], "#d55e00", 1.6, "felt", 1)
    style = ("text{font:13px Helvetica,Arial,'Liberation Sans',sans-serif;fill:#1b1b1b}"
             ".title{font-size:14px;font-weight:600}line{stroke:#e4e4e4}")
    head = f'<svg xmlns="http://www.w3.org/2000/svg" width="{2 * WIDTH}" height="{HEIGHT}" viewBox="0 0 {2 * WIDTH} {HEIGHT}">'
    background = '<rect width="100%" height="100%" fill="#ffffff"/>'
    return f"{head}<style>{style}</style>{background}{''.join(time.parts + folds.parts)}</svg>\n"


def main():
    press, fold, out = sys.argv[1:]
    Path(out).write_text(drawn(columns(press, 1600), columns(fold)), encoding="utf-8")


if __name__ == "__main__":
    main()
