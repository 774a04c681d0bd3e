"""records.md, records.csv and the summary."""

import csv
import datetime
import os
import platform

import records_published

# Errors of the same interpolant in single and double precision differ by less.
EQUAL = 1.002
PART_TITLES = {
    "solver": "Solver, ms",
    "interpolation": "Interpolation",
    "certified": "Time to a certified force",
}


def number(value):
    """Three significant digits."""
    if value is None:
        return ""
    text = f"{value:.3g}"
    return f"{value:,.0f}" if "e+" in text else text


def cell(figure):
    ratio = figure.ratio()
    return number(figure.value) if ratio is None else f"{number(figure.value)} ({number(ratio)}x)"


def losses(rows):
    """Figures beside a peer's, and those in which the peer is better. Estimates do not count: nobody measured them."""
    compared = [row for row in rows if row.ours is not None and row.part != "certified"]
    return compared, [row for row in compared if row.ratio() < 1 / EQUAL]


def summary(rows):
    compared, lost = losses(rows)
    lines = [f"{len(compared)} measured figures beside peers, {len(lost)} of them worse than a peer's"]
    for row in lost:
        lines.append(
            f"  {row.against}, {row.case}, {row.quantity}: {number(row.ours)} {row.unit}, "
            f"{row.system} {number(row.value)} ({number(1 / row.ratio())}x)"
        )
    return "\n".join(lines)


def grid(header, body):
    lines = ["| " + " | ".join(header) + " |", "|" + "---|" * len(header)]
    return lines + ["| " + " | ".join(line) + " |" for line in body]


def pivot(rows, key, first):
    """One line a key of `key`, one column a system or quantity in order of appearance."""
    lines, columns = {}, {}
    for row in rows:
        line, column = key(row)
        columns[column] = True
        lines.setdefault(line, {})[column] = cell(row)
    header = [*first, *columns]
    return grid(header, [[*line, *(cells.get(column, "") for column in columns)] for line, cells in lines.items()])


def part_lines(part, rows):
    lines = [f"## {PART_TITLES[part]}", ""]
    if part == "solver":
        lines += pivot(rows, lambda row: ((row.case, row.quantity), row.system), ("body", "quantity"))
        apart = max(float(row.note.split()[1]) for row in rows if row.note)
        lines += ["", f"The forces at 15 mm agree with Palpate's to {apart:.0e}."]
    elif part == "interpolation":
        header = ("table", "system", "beside")
        lines += pivot(
            rows, lambda row: ((row.case, row.system, row.against), f"{row.quantity}, {row.unit}"), header
        )
    else:
        body = [[row.system, cell(row), row.note] for row in rows]
        lines += grid(("system", "s", ""), body)
    return [*lines, ""]


def write(run, rows, seconds):
    machine = next(
        (line.split(":")[1].strip() for line in open("/proc/cpuinfo", encoding="utf-8") if "model name" in line),
        platform.machine(),
    )
    lines = [
        "# Palpate beside other programs",
        "",
        f"{datetime.date.today()}, {machine}, {len(os.sched_getaffinity(0))} cores of which one is used, in "
        f"{seconds:.0f} s{', --quick' if run.quick else ''}. In parentheses: the figure over Palpate's.",
        "",
    ]
    for part in PART_TITLES:
        of_part = [row for row in rows if row.part == part]
        if of_part:
            lines += part_lines(part, of_part)
    lines += ["## Published", ""]
    published = records_published.rows(run)
    lines += grid(records_published.COLUMNS, [[row[name] for name in records_published.COLUMNS] for row in published])
    if rows:
        lines += ["", "## Where a peer is better", "", "```text", summary(rows), "```"]
    (run.out / "records.md").write_text("\n".join(lines) + "\n", encoding="utf-8")
    with open(run.out / "records.csv", "w", encoding="ascii") as file:
        writer = csv.writer(file, lineterminator="\n")
        names = ("part", "case", "quantity", "unit", "system", "value", "ours", "against", "note")
        writer.writerow([*names, "ratio"])
        for row in rows:
            values = [getattr(row, name) for name in names]
            ratio = row.ratio()
            writer.writerow(["" if value is None else value for value in (*values, ratio)])
