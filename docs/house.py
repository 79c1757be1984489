"""Draw docs/house.svg: the floors of the package and who imports whom, from the source itself.

python docs/house.py
"""

import ast
from itertools import pairwise
from pathlib import Path

PACKAGE = Path(__file__).parents[1] / "vibrojax"
PHYSICS = ("beam", "modes", "contact", "contact_laws", "drive")
FLOORS = (
    {
        "shell": ("cli, rig_file, explorer/", "what people call: commands, rig files, sliders"),
    },
    {
        "studies": ("studies/", "many lanes: sweeps, branches, maps, fits, regimes"),
    },
    {
        "response": ("response/", "one lane: steady states, histories"),
        "results": ("results/", "named axes, status, pictures"),
        "measured": ("measured/", "what was measured, read"),
    },
    {
        "stepping": ("stepping/", "one step forward: exact contact, splitting, implicit"),
    },
    {
        "systems": ("systems/", "what moves: beam, matrices, pendulum"),
    },
    {
        "physics": (
            ", ".join(PHYSICS),
            "what the parts are",
        ),
    },
)
"""From the top down; rooms of one floor may use each other."""
WIDTH, HEIGHT, PITCH, MARGIN, GAP = 880, 62, 104, 20, 56
INK, PAPER, EDGE, ARROW = "#1a1a1a", "#f4f6f8", "#37474f", "#808b91"


def room_of(path: Path) -> str | None:
    """Return the room that a file or module of the package belongs to; None for its tools."""
    parts = path.relative_to(PACKAGE).parts
    name = parts[0].removesuffix(".py")
    if name.startswith(("cli", "rig_file", "explore")):
        return "shell"
    if name in PHYSICS:
        return "physics"
    return name if any(name in floor for floor in FLOORS) else None


def imports_at_the_top(tree: ast.Module):
    """Yield the modules that are imported when the file is; not inside functions."""
    for node in tree.body:
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("vibrojax."):
            yield node.module


def edges() -> set[tuple[str, str]]:
    """Return who imports whom, as pairs of rooms."""
    found = set()
    for path in PACKAGE.rglob("*.py"):
        room = room_of(path)
        for module in imports_at_the_top(ast.parse(path.read_text())):
            other = room_of(PACKAGE.joinpath(*module.split(".")[1:]))
            if room and other and room != other:
                found.add((room, other))
    return found


def upward(pairs: set[tuple[str, str]]) -> list[tuple[str, str]]:
    """Return the imports that go up a floor: there must be none."""
    floor = {room: k for k, rooms in enumerate(FLOORS) for room in rooms}
    return sorted(pair for pair in pairs if floor[pair[1]] < floor[pair[0]])


def drawing(pairs: set[tuple[str, str]]) -> str:
    """Return the SVG."""
    boxes, parts = {}, []
    for k, floor in enumerate(FLOORS):
        width = (WIDTH - GAP * (len(floor) - 1)) / len(floor)
        for j, room in enumerate(floor):
            boxes[room] = MARGIN + j * (width + GAP), MARGIN + k * PITCH, width
    for k, floor in enumerate(FLOORS[:-1]):  # arrows between neighbouring floors
        for upper in floor:
            for lower in FLOORS[k + 1]:
                if (upper, lower) in pairs:
                    parts.append(_arrow(boxes, upper, lower))
    for floor in FLOORS:  # and between rooms of one floor
        rooms = list(floor)
        for left, right in pairwise(rooms):
            forth, back = (left, right) in pairs, (right, left) in pairs
            if forth or back:
                parts.append(_sideways(boxes, left, right, forth, back))
    for floor in FLOORS:
        for room, (name, words) in floor.items():
            parts.append(_box(boxes[room], name, words))
    height = MARGIN * 2 + PITCH * (len(FLOORS) - 1) + HEIGHT
    body = "\n".join(parts)
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH + 2 * MARGIN} {height}" '
        'font-family="sans-serif" role="img" aria-label="Floors of the package">\n'
        '<defs><marker id="tip" viewBox="0 0 10 10" refX="9" refY="5" markerWidth="9" '
        f'markerHeight="9" orient="auto-start-reverse"><path d="M0,0 L10,5 L0,10 z" '
        f'fill="{ARROW}"/></marker></defs>\n{body}\n</svg>\n'
    )


def _box(box, name, words):
    x, y, width = box
    middle = x + width / 2
    return (
        f'<rect x="{x:.0f}" y="{y}" width="{width:.0f}" height="{HEIGHT}" rx="6" fill="{PAPER}" '
        f'stroke="{EDGE}" stroke-width="1.5"/>'
        f'<text x="{middle:.0f}" y="{y + 26}" text-anchor="middle" font-size="18" '
        f'font-weight="bold" fill="{INK}">{name}</text>'
        f'<text x="{middle:.0f}" y="{y + 48}" text-anchor="middle" font-size="15" '
        f'fill="{INK}">{words}</text>'
    )


def _line(x1, y1, x2, y2, ends):
    return (
        f'<line x1="{x1:.0f}" y1="{y1:.0f}" x2="{x2:.0f}" y2="{y2:.0f}" stroke="{ARROW}" '
        f'stroke-width="2.5" {ends}/>'
    )


def _arrow(boxes, upper, lower):
    (x1, y1, w1), (x2, y2, w2) = boxes[upper], boxes[lower]
    narrow = (x1, w1) if w1 < w2 else (x2, w2)
    x = narrow[0] + narrow[1] / 2
    return _line(x, y1 + HEIGHT, x, y2 - 2, 'marker-end="url(#tip)"')


def _sideways(boxes, left, right, forth, back):
    (x1, y1, w1), (x2, _, _) = boxes[left], boxes[right]
    ends = ('marker-end="url(#tip)" ' if forth else "") + (
        'marker-start="url(#tip)"' if back else ""
    )
    return _line(x1 + w1 + 1, y1 + HEIGHT / 2, x2 - 1, y1 + HEIGHT / 2, ends)


if __name__ == "__main__":
    found = edges()
    wrong = upward(found)
    if wrong:
        raise SystemExit(f"These imports go upwards: {wrong}.")
    Path(__file__).with_name("house.svg").write_text(drawing(found))
