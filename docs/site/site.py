"""Builds the documents of the repository as a static site. docs/site/build calls it and describes it."""

import html
import json
import os
import re
import shutil
import sys
from dataclasses import dataclass, field
from pathlib import Path
from urllib.parse import unquote

from markdown_it import MarkdownIt

ROOT = Path(__file__).resolve().parents[2]
# Document, name of its page, title in the side bar.
PAGES = [
    ("README.md", "index", "Palpate"),
    ("docs/guide.md", "guide", "Guide"),
    ("docs/theory.md", "theory", "Theory"),
    ("docs/devices.md", "devices", "Devices"),
    ("docs/safety.md", "safety", "Safety"),
    ("docs/formats.md", "formats", "Formats"),
    ("docs/c-api.md", "c-api", "C API"),
    ("docs/measurements.md", "measurements", "Measurements"),
    ("assets/README.md", "organ", "Bundled organ"),
    ("CHANGELOG.md", "changelog", "Changelog"),
]
GALLERY = ("gallery", "Gallery")
# Names of the files of the last build, one a line.
WRITTEN = "written.txt"


def anchor(heading):
    """The anchor of a heading, as the repository's host makes it and tests/tests/documents.rs checks it."""
    kept = (c for c in heading.strip().lower() if c.isalnum() or c in " -_")
    return "".join(kept).replace(" ", "-")


@dataclass
class Page:
    document: str
    name: str
    title: str
    tokens: list
    anchors: set = field(default_factory=set)
    # (anchor, title) of the headings below the first.
    sections: list = field(default_factory=list)


@dataclass
class Picture:
    path: str
    caption: str
    page: Page
    # Anchor and title of the section that shows it.
    section: tuple


def plain(inline):
    """Text of a heading without its marks."""
    return "".join(t.content for t in inline.children if t.type in ("text", "code_inline"))


def text(inline):
    """Text of a paragraph, with the captions of its pictures."""
    return "".join(" " if t.type == "softbreak" else t.content for t in inline.children)


def parse(markdown, document, name, title):
    """A page with the anchors of its headings set."""
    page = Page(document, name, title, markdown.parse((ROOT / document).read_text(encoding="utf-8")))
    for token, inline in zip(page.tokens, page.tokens[1:]):
        if token.type != "heading_open":
            continue
        heading = plain(inline)
        first = identifier = anchor(heading)
        count = 0
        while identifier in page.anchors:
            count += 1
            identifier = f"{first}-{count}"
        page.anchors.add(identifier)
        token.attrSet("id", identifier)
        if token.tag == "h2":
            page.sections.append((identifier, heading))
    return page


class Folder:
    """The folder of the site, and the files that this build writes there."""

    def __init__(self, path):
        self.path = path
        self.names = set()

    def file(self, name):
        """The path of a file to write."""
        self.names.add(name)
        to = self.path / name
        to.parent.mkdir(parents=True, exist_ok=True)
        return to

    def tidy(self):
        """Removes the files that only an earlier build has written."""
        written = self.path / WRITTEN
        earlier = written.read_text(encoding="utf-8").splitlines() if written.is_file() else []
        for name in set(earlier) - self.names:
            file = self.path / name
            if file.is_file() and file.resolve().is_relative_to(self.path.resolve()):
                file.unlink()
        written.write_text("".join(f"{name}\n" for name in sorted(self.names)), encoding="utf-8")


class Links:
    """Replaces the links of documents by those of the site, copies what they name, and collects the broken ones."""

    def __init__(self, pages, out):
        self.pages = {page.document: page for page in pages}
        self.out = out
        self.broken = []

    def target(self, page, link, line):
        """The address on the site of a link in a document."""
        if re.match(r"[a-z]+:", link):
            return link
        path, _, heading = link.partition("#")
        file = (ROOT / page.document).parent / unquote(path) if path else ROOT / page.document
        document = os.path.relpath(file, ROOT)
        if document.startswith("..") or not file.is_file():
            self.broken.append(f"{page.document}:{line}: a link to {link}, which is not there")
            return link
        other = self.pages.get(document)
        if other is None:
            return self.copied(document)
        if heading and heading not in other.anchors:
            self.broken.append(f"{page.document}:{line}: {link}: no such heading in {document}")
        there = "" if other is page and heading else f"{other.name}.html"
        return there + (f"#{heading}" if heading else "")

    def copied(self, document):
        """The copy of a file of the repository; a source as text, which a browser shows."""
        is_picture = document.endswith((".png", ".svg"))
        name = f"images/{Path(document).name}" if is_picture else f"sources/{document}.txt"
        shutil.copyfile(ROOT / document, self.out.file(name))
        return name

    def replace(self, page):
        """Replaces all links of a page; returns its pictures."""
        pictures, section = [], (None, page.title)
        for token, following in zip(page.tokens, page.tokens[1:] + [None]):
            if token.type == "heading_open":
                section = (token.attrGet("id"), plain(following))
            line = (token.map or [0])[0] + 1
            for child in token.children or []:
                if child.type == "link_open":
                    child.attrSet("href", self.target(page, child.attrGet("href"), line))
                elif child.type == "image":
                    path = self.target(page, child.attrGet("src"), line)
                    child.attrSet("src", path)
                    child.attrSet("loading", "lazy")
                    pictures.append(Picture(path, child.content, page, section))
        return pictures


def sections(page):
    """Address, title of the page, heading and text of each section of a page, for the search."""
    found = []
    for before, token in zip([None, *page.tokens], page.tokens):
        if token.type == "heading_open":
            found.append([f"{page.name}.html#{token.attrGet('id')}", page.title, "", ""])
        elif before is not None and before.type == "heading_open":
            found[-1][2] = plain(token)
        elif token.type in ("inline", "fence", "code_block"):
            part = text(token) if token.type == "inline" else token.content
            found[-1][3] += " ".join(part.split()) + " "
    return found


def side_bar(pages, current):
    """The list of pages; the current one with its sections."""
    items = []
    for name, title, below_it in [*((p.name, p.title, p.sections) for p in pages), (*GALLERY, [])]:
        here = ' aria-current="page"' if name == current else ""
        below = ""
        if here and len(below_it) > 1:
            links = (f'<li><a href="#{a}">{html.escape(heading)}</a></li>' for a, heading in below_it)
            below = f"<ul>{''.join(links)}</ul>"
        items.append(f'<li><a href="{name}.html"{here}>{html.escape(title)}</a>{below}</li>')
    return f"<nav aria-label=\"Pages\"><ul>{''.join(items)}</ul></nav>"


def around(pages, current):
    """Links to the page before and the page after."""
    order = [*((p.name, p.title) for p in pages), GALLERY]
    at = [name for name, _ in order].index(current)
    before = f'<a rel="prev" href="{order[at - 1][0]}.html">&larr; {order[at - 1][1]}</a>' if at else "<span></span>"
    after = ""
    if at + 1 < len(order):
        after = f'<a rel="next" href="{order[at + 1][0]}.html">{order[at + 1][1]} &rarr;</a>'
    return f'<footer class="around">{before}{after}</footer>'


def whole(pages, name, title, body):
    """A page of HTML."""
    head = "Palpate" if name == "index" else f"{html.escape(title)} - Palpate"
    bar = side_bar(pages, name)
    return f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="color-scheme" content="light dark">
<title>{head}</title>
<link rel="stylesheet" href="style.css">
<script src="search.js" defer></script>
</head>
<body>
<div class="search" role="search">
<input type="search" placeholder="Search (key /)" aria-label="Search all pages" autocomplete="off" hidden>
<ol aria-label="Results" hidden></ol>
</div>
<aside class="wide">{bar}</aside>
<details class="narrow"><summary>Palpate: {html.escape(title)}</summary>{bar}</details>
<main>
{body}
{around(pages, name)}
</main>
</body>
</html>
"""


def gallery(pictures):
    """The pictures of all documents in the order of the documents, each once with the caption of its first place."""
    figures, seen = [], set()
    for picture in pictures:
        if picture.path in seen:
            continue
        seen.add(picture.path)
        caption = html.escape(picture.caption)
        identifier, section = picture.section
        to = f"{picture.page.name}.html#{identifier}"
        place = html.escape(picture.page.title if picture.page.name == "index" else f"{picture.page.title}, {section}")
        figures.append(
            f'<figure><a href="{picture.path}"><img src="{picture.path}" alt="{caption}" loading="lazy"></a>'
            f'<figcaption>{caption}. <a href="{to}">{place}</a></figcaption></figure>'
        )
    return f'<h1 id="gallery">Gallery</h1>\n<div class="gallery">{"".join(figures)}</div>'


def build(out):
    """Writes the site into a folder; returns the broken links."""
    markdown = MarkdownIt("commonmark").enable("table")
    # A wide table scrolls by itself, not the page.
    markdown.renderer.rules["table_open"] = lambda *_: '<div class="table"><table>\n'
    markdown.renderer.rules["table_close"] = lambda *_: "</table></div>\n"
    pages = [parse(markdown, *entry) for entry in PAGES]
    links = Links(pages, out)
    pictures = [picture for page in pages for picture in links.replace(page)]
    for file in sorted((ROOT / "docs").glob("*.md")):
        if str(file.relative_to(ROOT)) not in links.pages:
            links.broken.append(f"docs/{file.name}: not a page; add it to PAGES in docs/site/site.py")
    shown = {picture.path for picture in pictures}
    for file in sorted((ROOT / "docs/images").iterdir()):
        if f"images/{file.name}" not in shown:
            links.broken.append(f"docs/images/{file.name}: in no document, so without a caption for the gallery")
    for page in pages:
        body = markdown.renderer.render(page.tokens, markdown.options, {})
        out.file(f"{page.name}.html").write_text(whole(pages, page.name, page.title, body), encoding="utf-8")
    name, title = GALLERY
    out.file(f"{name}.html").write_text(whole(pages, name, title, gallery(pictures)), encoding="utf-8")
    index = [section for page in pages for section in sections(page)]
    lines = ",\n".join(json.dumps(section, ensure_ascii=False) for section in index)
    out.file("search-index.js").write_text(f"window.searchIndex = [\n{lines}\n];\n", encoding="utf-8")
    for name in ["style.css", "search.js"]:
        shutil.copyfile(Path(__file__).with_name(name), out.file(name))
    out.tidy()
    print(f"{len(pages) + 1} pages, {len(shown)} pictures: {out.path}/index.html")
    return links.broken


def main():
    if len(sys.argv) != 2 or sys.argv[1].startswith("-"):
        sys.exit("site: give the folder for the site: docs/site/build FOLDER")
    out = Path(sys.argv[1])
    out.mkdir(parents=True, exist_ok=True)
    broken = build(Folder(out))
    for line in broken:
        print(line, file=sys.stderr)
    if broken:
        sys.exit(f"site: {len(broken)} broken links or pictures; correct the documents")


if __name__ == "__main__":
    main()
