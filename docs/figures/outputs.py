"""Numbers in what a command writes: JSON, CSV and text. tests/src/figures.rs reads in the same way."""

import csv
import json

from documents import Missing, pattern


def read(path):
    text = path.read_text(encoding="utf-8", errors="replace")
    if path.suffix == ".json":
        return json.loads(text)
    if path.suffix == ".csv":
        return list(csv.DictReader(text.splitlines()))
    return text


def is_value(of, key, wanted):
    found = of.get(key) if isinstance(of, dict) else None
    if isinstance(found, (int, float)) and not isinstance(found, bool):
        return str(found) == wanted or float(found) == number(wanted)
    return found is not None and str(found) == wanted


def number(text):
    try:
        return float(text)
    except ValueError:
        return None


def at(content, path):
    """The number at a path, for example `cases/name=demo&law=stvk/error_n/0`; `#` counts; `a : b` is a quotient."""
    if " : " in path:
        left, right = path.split(" : ", 1)
        return at(content, left) / at(content, right)
    found = content
    for part in path.split("/"):
        if "=" in part:
            pairs = [pair.split("=", 1) for pair in part.split("&")]
            those = [item for item in found if all(is_value(item, *pair) for pair in pairs)]
            if len(those) != 1:
                raise Missing(f"{len(those)} of `{part}` in `{path}`")
            found = those[0]
        elif part == "#":
            found = len(found)
        elif isinstance(found, list) and part.isdigit() and int(part) < len(found):
            found = found[int(part)]
        elif isinstance(found, dict) and part in found:
            found = found[part]
        else:
            raise Missing(f"no `{part}` of `{path}`")
    if found is None or found == "":
        raise Missing(f"no value at `{path}`")
    return float(found)


def value(folder, file, path):
    """The number at a path of a file, or of the one that it names: `other.json > cases/0`."""
    if " > " in path:
        file, path = path.split(" > ", 1)
    return at(read(folder / file), path)


def find(text, words):
    match = pattern(words).search(text)
    if not match:
        raise Missing(f"the output has no `{words}`")
    return [float(group.replace(",", "")) for group in match.groups()]
