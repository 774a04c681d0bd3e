"""The entries of docs/figures/*.toml: which command makes which number of the documents. README.md describes them."""

import tomllib
from dataclasses import dataclass
from pathlib import Path

import documents
import outputs
from documents import Missing

ROOT = Path(__file__).resolve().parents[2]


@dataclass
class Place:
    """The numbers of one cell or sentence, and how their new values are read."""

    file: str
    heading: str
    what: str
    row: str | None
    column: str | None
    words: str | None
    rows: list
    columns: list
    how: dict

    def printed(self, text):
        if self.words is not None:
            return documents.sentence(text, self.heading, self.words)
        table = documents.table(text, self.heading, self.rows, self.columns, self.how.get("corner"))
        start, cell = table.cell(self.row, self.column)
        return documents.numbers(cell, start)

    def paths(self):
        at = self.how.get("at", [])
        return [at] if isinstance(at, str) else at

    def new(self, folder):
        """Values in the order of the printed ones; None where nothing is compared."""
        file = self.how.get("from", "output")
        if "find" in self.how:
            found = outputs.find(outputs.read(folder / file), self.how["find"])
        else:
            found = [None if path == "-" else outputs.value(folder, file, path) for path in self.paths()]
        scale = self.how.get("scale", 1)
        each = scale if isinstance(scale, list) else [scale] * len(found)
        return [None if value is None else value * by for value, by in zip(found, each)]


def filled(how, row, column):
    def fill(value):
        if isinstance(value, list):
            return [fill(item) for item in value]
        return value.replace("{row}", row).replace("{column}", column) if isinstance(value, str) else value

    return {key: fill(value) for key, value in how.items()}


class Figure:
    """One entry."""

    def __init__(self, entry, file):
        self.name = entry["name"]
        self.run = entry.get("run", "")
        self.seconds = entry.get("seconds")
        self.why = entry.get("why")
        self.file = entry.get("file", file)
        self.heading = entry.get("heading")
        self.pictures = entry.get("picture", [])
        self.places = [place for table in entry.get("table", []) for place in self.of_table(table)]
        self.places += [self.of_text(text) for text in entry.get("text", [])]

    def of_table(self, table):
        own = {key: table[key] for key in ("from", "at", "find", "scale", "tolerance", "corner") if key in table}
        rows, columns = table["rows"], table["columns"]
        rows = {row: row for row in rows} if isinstance(rows, list) else rows
        for row, row_value in rows.items():
            for column, value in columns.items():
                how, key = ({**own, **value}, "") if isinstance(value, dict) else (own, value)
                yield Place(
                    table.get("file", self.file), table.get("heading", self.heading), f"{row}, {column}", row, column,
                    None, list(rows), list(columns), filled(how, row_value, key),
                )

    def of_text(self, text):
        file, heading = text.get("file", self.file), text.get("heading", self.heading)
        return Place(file, heading, text["words"], None, None, text["words"], [], [], text)


def all_figures():
    found = []
    for path in sorted(Path(__file__).parent.glob("*.toml")):
        content = tomllib.loads(path.read_text(encoding="utf-8"))
        found += [Figure(entry, content.get("file")) for entry in content["figure"]]
    return found


def is_same(printed, new, tolerance):
    """A tolerance above 1 is a factor, below 1 a share; without one, all printed digits are compared."""
    old = printed.value
    if tolerance > 1:
        return old * new > 0 and 1 / tolerance <= new / old <= tolerance
    if tolerance > 0:
        return abs(new - old) <= tolerance * abs(old) + 0.5 * printed.step()
    return abs(new - old) <= 0.5000001 * printed.step()


def compared(place, text, folder):
    """Pairs (printed, new, is the same) of the numbers that are compared."""
    printed, new = place.printed(text), place.new(folder)
    if len(printed) != len(new):
        raise Missing(f"{len(printed)} numbers in the document, {len(new)} in the entry")
    tolerance = place.how.get("tolerance", 0)
    each = tolerance if isinstance(tolerance, list) else [tolerance] * len(new)
    return [(old, value, is_same(old, value, of)) for old, value, of in zip(printed, new, each) if value is not None]
