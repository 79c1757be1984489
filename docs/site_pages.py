"""What mkdocs does beyond pages under docs/: a hook (`hooks:` in mkdocs.yml).

Pages that live elsewhere in the repository (experiments, benchmarks, changelog, how to contribute)
join the site under their own paths, with the pictures they show; `validation.md` is generated from
result files; notebooks are listed as they exist; names of the package link to the reference.
"""

import json
import posixpath
import re
import sys
from pathlib import Path

import griffe
from mkdocs.structure.files import File
from mkdocs.structure.toc import get_toc

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
sys.path.insert(0, str(DOCS))

import validation  # noqa: E402

OUTSIDE = ("CHANGELOG.md", "CONTRIBUTING.md", "benchmarks/README.md", "experiments/*/README.md")
"""Pages of the site that are not under docs/, as patterns from the root."""
LINK = re.compile(r"(!?)\[((?:[^\[\]]|\[[^\]]*\]|!\[[^\]]*\]\([^)]*\))*)\]\(([^()\s]+)\)")
FENCE = re.compile(r"^(```.*?^```[ ]*$)", re.MULTILINE | re.DOTALL)
HEADING = re.compile(r'<h([1-6]) id="([^"]+)">(.*?)<a class="anchor-link"', re.DOTALL)
"""Of a notebook."""
NAME = re.compile(r"(?<![\[`])`(?:vj\.|vibrojax\.)?(\w+)((?:\.\w+)?(?:\([^`]*\))?)`(?![\]`])")


def outside_pages() -> list[str]:
    """Return paths from the root of the pages that are not under docs/."""
    return sorted(p.relative_to(ROOT).as_posix() for key in OUTSIDE for p in ROOT.glob(key))


def linked_files(page: str) -> list[str]:
    """Return what a page outside docs/ shows or links to and the site can hold: pictures, tables.

    Paths are from the root; what does not exist is left to the checks of links.
    """
    found = []
    for _, _, target in LINK.findall((ROOT / page).read_text()):
        path = target_of(page, target)
        if path and path.endswith((".png", ".svg", ".md")) and not path.startswith("docs/"):
            found.append(path)
    return found


def target_of(page: str, target: str) -> str | None:
    """Return the path from the root that a link of a page means; None where it is not a file's."""
    if re.match(r"[a-z]+:|#|/", target):
        return None
    return posixpath.normpath(posixpath.join(posixpath.dirname(page), target.split("#")[0]))


def sentences(paths: list[str]) -> dict[str, str]:
    """Return the first line of the docstring of each object, by its path in the package."""
    package = griffe.load("vibrojax", search_paths=[str(ROOT)])
    found = {}
    for path in paths:
        member = package[path.removeprefix("vibrojax.")]
        docstring = (member.final_target if member.is_alias else member).docstring
        found[path] = docstring.value.split("\n")[0] if docstring else ""
    return found


def names_by_page() -> dict[str, list[str]]:
    """Return the public names that each page of the reference documents, as `vibrojax.name`."""
    listed = {}
    for path in sorted((DOCS / "api").glob("*.md")):
        names = re.findall(r"^::: (vibrojax[.\w]+)$", path.read_text(), re.MULTILINE)
        listed[path.relative_to(DOCS).as_posix()] = names
    return listed


def on_config(config):
    """Put the notebooks that exist in the place of the entry `notebooks/`."""
    overview = DOCS / "notebooks" / "README.md"
    entries = [{"Overview": "notebooks/README.md"}] if overview.exists() else []
    for path in sorted((DOCS / "notebooks").glob("[0-9]*.ipynb")):
        cells = json.loads(path.read_text())["cells"]
        titles = (re.match(r"#\s+(.+)", "".join(cell["source"])) for cell in cells)
        title = next((found[1].strip() for found in titles if found), path.stem)
        entries.append({title: path.relative_to(DOCS).as_posix()})
    config.nav = [
        {"Notebooks": entries} if "Notebooks" in item else item
        for item in config.nav
        if "Notebooks" not in item or entries
    ]
    return config


def on_files(files, config):
    """Add the pages and pictures from outside docs/, and the generated page."""
    pages = outside_pages()
    taken = dict.fromkeys(pages)
    for page in pages:
        taken |= dict.fromkeys(linked_files(page))
    for path in taken:
        if (ROOT / path).is_file() and path != "README.md":
            files.append(File.generated(config, path, abs_src_path=str(ROOT / path)))
    files.append(File.generated(config, "validation.md", content=validation.page()))
    return files


def on_page_markdown(markdown, page, config, files):
    """Turn links of the repository into those of the site and names into links."""
    uri = page.file.src_uri
    if uri == "api/index.md":
        markdown = markdown.replace("<!-- names -->", _table_of_names(config.nav))
    if not uri.endswith(".md"):
        return markdown
    inside = (DOCS / uri).is_file() or uri == "validation.md"
    path = f"docs/{uri}" if inside else uri
    known = {
        name.split(".")[-1]: f"{place}#{name}"
        for place, names in names_by_page().items()
        for name in names
    }
    parts = FENCE.split(markdown)
    for k, part in enumerate(parts):
        if k % 2 == 0:
            part = LINK.sub(lambda found: _on_the_site(found, path, uri, files), part)
            if not uri.startswith("api/"):
                part = NAME.sub(lambda found: _to_reference(found, known, uri), part)
            parts[k] = part
    return "".join(parts)


def on_page_content(html, page, config, files):
    """Make the contents of a notebook from its headings: mkdocs-jupyter leaves out code in them."""
    if page.file.src_uri.endswith(".ipynb"):
        found, above = [], []
        for level, anchor, text in HEADING.findall(html):
            name = re.sub(r"<[^>]+>", "", text)
            token = {"level": int(level), "id": anchor, "name": name, "children": []}
            while above and above[-1]["level"] >= token["level"]:
                above.pop()
            (above[-1]["children"] if above else found).append(token)
            above.append(token)
        page.toc = get_toc(found)
    return html


def _on_the_site(found, path, uri, files, inner=False):
    picture, text, target = found.groups()
    text = LINK.sub(lambda inner: _on_the_site(inner, path, uri, files, inner=True), text)
    meant = target_of(path, target)
    if meant is None:
        return f"{picture}[{text}]({target})"
    on_site = "index.md" if meant == "README.md" else meant.removeprefix("docs/")
    if files.get_file_from_path(on_site) is None and (ROOT / meant).exists():
        return text  # a file of the repository that is no page: its name has to do
    start = posixpath.dirname(uri) or "."
    anchor = "#" + target.split("#")[1] if "#" in target else ""
    link = f"{picture}[{text}]({posixpath.relpath(on_site, start)}{anchor})"
    if picture and not inner:  # a click shows the picture in its full size
        return f"[{link}]({posixpath.relpath(on_site, start)})"
    return link


def _to_reference(found, known, uri):
    name = found[1]
    explicit = found[0].startswith(("`vj.", "`vibrojax."))
    says_much = name[0].isupper() or "_" in name or "(" in found[2]
    if name not in known or not (explicit or says_much):
        return found[0]
    start = posixpath.dirname(uri) or "."
    return f"[{found[0]}]({posixpath.relpath(known[name], start)})"


def _table_of_names(nav):
    listed = names_by_page()
    entries = next(item["API"] for item in nav if "API" in item)
    listed = {place: listed[place] for entry in entries for place in entry.values()}
    first, rows = sentences([name for names in listed.values() for name in names]), []
    for place, names in listed.items():
        if not names:
            continue
        title = (DOCS / place).read_text().split("\n")[0].removeprefix("# ")
        rows += ["", f"## {title}", "", "| name | what it is |", "|---|---|"]
        page = place.removeprefix("api/")
        for name in names:
            sentence = first[name].replace("|", "\\|")
            rows.append(f"| [`{name.removeprefix('vibrojax.')}`]({page}#{name}) | {sentence} |")
    return "\n".join(rows)
