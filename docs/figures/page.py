#!/usr/bin/env python3
"""Takes plots out of the page of `palpate report`: the legend and the first two plots of a section, as one SVG.

    page.py report.html SECTION OUT.svg
"""

import re
import sys
from pathlib import Path

WIDTH, HEIGHT, LEGEND = 460, 330, 52


def placed(svg, x, y, width, height):
    return re.sub(r"<svg", f'<svg x="{x:.0f}" y="{y}" width="{width}" height="{height}"', svg, count=1)


def legend(keys):
    """The entries in a row, and below them the note, which has no line."""
    x, parts = 10.0, []
    for swatch, name in re.findall(r"<span>(<svg.*?</svg>)?(.*?)</span>", keys, re.DOTALL):
        if swatch:
            parts.append(placed(swatch, x, 7, 34, 16))
            x += 40
        place = f'x="{x:.0f}" y="19"' if swatch else 'x="12" y="42"'
        parts.append(f'<text class="tick" {place}>{name}</text>')
        x += 6.1 * len(name) + 14
    return parts


def main():
    page, section, out = sys.argv[1:]
    text = Path(page).read_text(encoding="utf-8")
    text = text[text.index(f'id="{section}"'):]
    keys = text[text.index('<div class="keys">'):text.index('<div class="plots">')]
    plots = re.findall(r"<svg viewBox.*?</svg>", text[text.index('<div class="plots">'):], re.DOTALL)[:2]
    style = (Path(__file__).resolve().parents[2] / "tools/src/plot/style.css").read_text(encoding="utf-8")
    width, height = 2 * WIDTH, LEGEND + HEIGHT
    parts = legend(keys) + [placed(plot, k * WIDTH, LEGEND, WIDTH, HEIGHT) for k, plot in enumerate(plots)]
    size = f'width="{width}" height="{height}" viewBox="0 0 {width} {height}"'
    head = f'<svg xmlns="http://www.w3.org/2000/svg" {size}><style>\n{style}</style>'
    background = '<rect width="100%" height="100%" fill="#ffffff"/>'
    Path(out).write_text(f"{head}{background}{''.join(parts)}</svg>\n", encoding="utf-8")


if __name__ == "__main__":
    main()
