"""Numbers in the documents: cells of tables and numbers in sentences. tests/src/figures.rs reads in the same way."""

import re
from dataclasses import dataclass

PLAIN = r"-?(?:\d+(?:,\d{3})*(?:\.\d+)?|\.\d+)(?:e[+-]?\d+)?"
NUMBER = re.compile(rf"(?<![\w.,]){PLAIN}")


class Missing(Exception):
    """Something that an entry names is not there."""


@dataclass
class Number:
    """A number as printed, and where."""

    start: int
    end: int
    text: str

    @property
    def value(self):
        return float(self.text.replace(",", ""))

    def step(self):
        """One unit of the last printed digit."""
        mantissa, _, exponent = self.text.replace(",", "").partition("e")
        decimals = len(mantissa.partition(".")[2])
        return 10.0 ** (int(exponent or 0) - decimals)

    def formatted(self, value):
        """Another value with as many digits, for --write."""
        mantissa, is_power, _ = self.text.replace(",", "").partition("e")
        decimals = len(mantissa.partition(".")[2])
        if is_power:
            base, _, power = f"{value:.{decimals}e}".partition("e")
            return f"{base}e{int(power)}"
        is_plain = len(mantissa.partition(".")[0]) > 3 and "," not in self.text
        text = f"{value:.{decimals}f}" if is_plain else f"{value:,.{decimals}f}"
        if mantissa.lstrip("-").startswith("."):
            text = re.sub(r"^(-?)0\.", r"\1.", text)
        return text


def numbers(text, offset=0):
    return [Number(offset + m.start(), offset + m.end(), m.group()) for m in NUMBER.finditer(text)]


def pattern(words):
    """`{}` is a number, `{_}` a number that is not wanted, `...` any text; white space is any white space."""
    parts = re.split(r"(\{\}|\{_\}|\s*\.\.\.\s*|\s+)", words.strip())
    regex = {"{}": f"({PLAIN})", "{_}": PLAIN, "...": r".*?"}
    return re.compile("".join(regex.get(p.strip()) or (r"\s+" if p.isspace() else re.escape(p)) for p in parts), re.DOTALL)


def section(text, heading):
    """Start and end of the text below a heading, up to the next heading outside of code."""
    start, inside, at = None, False, 0
    for line in text.splitlines(keepends=True):
        inside ^= line.startswith("```")
        if line.startswith("#") and not inside:
            if start is not None:
                return start, at
            if line.lstrip("#").strip() == heading:
                start = at + len(line)
        at += len(line)
    if start is None:
        raise Missing(f"no heading `{heading}`")
    return start, len(text)


def cells(line, at):
    """The cells of a line of a table, each with its place."""
    found, start = [], at + 1
    for part in line.strip()[1:-1].split("|"):
        found.append((start, part))
        start += len(part) + 1
    return found


class Table:
    """A table of a section."""

    def __init__(self, lines):
        self.header = [text.strip() for _, text in cells(*lines[0])]
        self.rows = [cells(*line) for line in lines[2:]]
        self.labels = []
        for row in self.rows:
            above = self.labels[-1] if self.labels else [""] * len(row)
            labels, is_leading = [], True
            for k, (_, text) in enumerate(row):
                is_leading &= not text.strip()
                labels.append(above[k] if is_leading and k < len(above) else text.strip())
            self.labels.append(labels)

    def column(self, name):
        return one_of(name, "column", [[h] for h in self.header])

    def row(self, name):
        return one_of(name, "row", self.labels)

    def cell(self, row, column):
        start, text = self.rows[self.row(row)][self.column(column)]
        return start, text


def one_of(name, what, all_labels):
    """The only index whose labels are those of `name`, which are separated by ` | `, or begin with them."""
    wanted = name.split(" | ")

    def those(fits):
        return [k for k, of in enumerate(all_labels) if len(of) >= len(wanted) and all(map(fits, of, wanted))]

    found = those(str.__eq__) or those(str.startswith)
    if len(found) != 1:
        raise Missing(f"{len(found)} of {what} `{name}`")
    return found[0]


def tables(text, start, end):
    found, lines, at = [], [], start
    for line in [*text[start:end].splitlines(keepends=True), ""]:
        if line.startswith("|"):
            lines.append((line, at))
        else:
            found += [Table(lines)] if len(lines) > 2 else []
            lines = []
        at += len(line)
    return found


def table(text, heading, rows, columns, corner=None):
    """The only table below a heading that has all these rows and columns, and this label above its rows."""
    said = "no table"
    found = []
    for one in tables(text, *section(text, heading)):
        try:
            [one.row(row) for row in rows]
            [one.column(column) for column in columns]
            found += [one] if corner in (None, one.header[0]) else []
        except Missing as missing:
            said = missing
    if len(found) != 1:
        raise Missing(f"`{heading}`: {len(found)} tables with these rows and columns ({said})")
    return found[0]


def sentence(text, heading, words):
    """The numbers of a sentence below a heading."""
    start, end = section(text, heading)
    match = pattern(words).search(text, start, end)
    if not match:
        raise Missing(f"`{heading}`: no text `{words}`")
    return [Number(match.start(k), match.end(k), match[k]) for k in range(1, len(match.groups()) + 1)]
