#!/usr/bin/env python3
"""Writes a variant of a bundled scene: the paper's grids, one active node, another law. Used by docs/figures/*.toml."""

import argparse
import re
from pathlib import Path

STVK = '[material]\nlaw = "st-venant-kirchhoff"\nyoung_pa = 15480.0\npoisson = {poisson}\n'


def without(text, name):
    """The scene without its tables of this name."""
    return re.sub(rf"^\[+{name}\]+\n(?:(?!\[).*\n)*", "", text, flags=re.MULTILINE)


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scene", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--points", type=int, help="one of the paper's grids, to 50 mm, without a force limit")
    parser.add_argument("--active", help="keep this active node only")
    parser.add_argument("--stvk", type=float, nargs="?", const=0.49, metavar="POISSON", help="St. Venant-Kirchhoff")
    parser.add_argument("--unfelt", action="store_true", help="adaptive sampling with cannot_be_felt")
    parser.add_argument("--order", type=int, help="order of the elements")
    parser.add_argument("--fingertip-mm", type=float, metavar="RADIUS", help="touched by a fingertip")
    parser.add_argument("--round", nargs=3, metavar=("SHAPE", "RADIUS", "LENGTH"), help="touched by a sphere or capsule, mm, anywhere")
    args = parser.parse_args()
    text = args.scene.read_text(encoding="utf-8")
    mesh = re.search(r'^file = "(.*)"', text, re.MULTILINE)[1]
    text = text.replace(f'"{mesh}"', f'"{(args.scene.parent / mesh).resolve()}"')
    if args.points:
        text = without(without(text, "device"), "grid") + f"\n[grid]\nradius_m = 0.05\npoints = {args.points}\n"
    if args.order:
        text = re.sub(r"^order = .*$", f"order = {args.order}", text, flags=re.MULTILINE)
    if args.stvk:
        text = without(text, "material") + "\n" + STVK.format(poisson=args.stvk)
    if args.unfelt:
        text = re.sub(r"^(points|spacing_m) = .*\n", "cannot_be_felt = true\n", text, flags=re.MULTILINE)
    if args.active:
        blocks = re.findall(r"^\[\[active\]\]\n(?:(?!\[).*\n)*", text, flags=re.MULTILINE)
        kept = [block for block in blocks if f'"{args.active}"' in block]
        text = without(text, r"active") + "\n" + "".join(kept)
    if args.fingertip_mm:
        text += f'\n[tool]\nshape = "fingertip"\nradius_m = {1e-3 * args.fingertip_mm:g}\n'
    if args.round:
        shape, radius, length = args.round[0], *(1e-3 * float(size) for size in args.round[1:])
        text = without(without(text, "active"), "grid") + f'\n[tool]\nshape = "{shape}"\nradius_m = {radius:g}\n'
        text += f"length_m = {length:g}\n" if length else ""
    args.out.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
