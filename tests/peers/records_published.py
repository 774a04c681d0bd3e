"""Part `published`: figures of programs that cannot be installed here, with their sources."""

import csv

COLUMNS = ("system", "quantity", "figure", "hardware", "source", "differs")


def rows(run):
    with open(run.here / "published.csv", encoding="ascii") as file:
        return list(csv.DictReader(file))


def read(_run, _rows):
    """No figure compares: the tables show them as published."""
    return []
