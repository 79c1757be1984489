"""A page of HTML in one file: nothing is fetched, and it can be printed."""

import base64
from collections.abc import Sequence
from xml.etree import ElementTree

STYLE = """
body { font: 16px/1.5 system-ui, sans-serif; color: #1a1a1a; max-width: 60rem;
       margin: 2rem auto; padding: 0 1rem; }
h1 { font-size: 1.6rem; line-height: 1.25; } h2 { font-size: 1.25rem; margin-top: 2.2rem; }
h3 { font-size: 1.05rem; }
table { border-collapse: collapse; margin: 0.8rem 0; }
th, td { text-align: left; vertical-align: top; padding: 0.25rem 0.9rem 0.25rem 0;
         border-bottom: 1px solid #d5dadd; }
pre { background: #f4f6f8; padding: 0.7rem 0.9rem; font-size: 0.82rem; line-height: 1.4;
      white-space: pre-wrap; overflow-wrap: anywhere; }
img { max-width: 100%; } .faint { color: #5b666c; }
.warning { border-left: 4px solid #d55e00; padding-left: 0.9rem; }
@media print { body { font-size: 11pt; margin: 0; max-width: none; } h2, h3 { break-after: avoid; }
               img, tr { break-inside: avoid; } }
"""


def element(tag: str, *inside: str | ElementTree.Element, **attributes: str) -> ElementTree.Element:
    """Return an element; texts inside are escaped when it is written. `kind` is its class."""
    if "kind" in attributes:
        attributes["class"] = attributes.pop("kind")
    made = ElementTree.Element(tag, attributes)
    for part in inside:
        if isinstance(part, ElementTree.Element):
            made.append(part)
        elif len(made):
            made[-1].tail = (made[-1].tail or "") + part
        else:
            made.text = (made.text or "") + part
    return made


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> ElementTree.Element:
    """Return a table; with an empty `head` the first column names the rows."""
    top = [element("tr", *(element("th", cell) for cell in head))] if head else []
    first = "td" if head else "th"
    body = [
        element("tr", element(first, row[0]), *(element("td", cell) for cell in row[1:]))
        for row in rows
    ]
    return element("table", *top, *body)


def listed(sentences: Sequence[str]) -> ElementTree.Element:
    """Return sentences one below the other."""
    return element("ul", *(element("li", sentence) for sentence in sentences))


def embedded(content: bytes, kind: str) -> str:
    """Return the address of content that the page itself holds; `kind` is its media type."""
    return f"data:{kind};base64,{base64.b64encode(content).decode()}"


def download(name: str, content: bytes, kind: str) -> ElementTree.Element:
    """Return a link that saves content as a file."""
    return element("a", name, href=embedded(content, kind), download=name)


def page(title: str, *inside: ElementTree.Element) -> str:
    """Return the text of a page."""
    head = element(
        "head",
        element("meta", charset="utf-8"),
        element("meta", name="viewport", content="width=device-width, initial-scale=1"),
        element("title", title),
        element("style", STYLE),
    )
    whole = element("html", head, element("body", *inside), lang="en")
    text = ElementTree.tostring(whole, encoding="unicode", method="html")
    return f"<!DOCTYPE html>\n{text}\n"
