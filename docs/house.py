"""Draw docs/house.svg, the rooms of the package, and refuse imports that run up or in a circle.

python docs/house.py
"""

import ast
import graphlib
from pathlib import Path

PACKAGE = Path(__file__).parents[1] / "vibrojax"
FLOORS = (
    {"cli": "commands", "explorer": "sliders"},
    {"design": "which rig is best"},
    {
        "resolution": "how fine is enough",
        "maps": "over many numbers",
        "identification": "from measurements",
    },
    {"regime": "kinds of motion, basins", "branches": "followed, with folds"},
    {
        "io": "rig files",
        "sweep": "up and down the frequency",
        "steady": "one periodic motion",
    },
    {"history": "a motion in time", "measured": "what was measured"},
    {"stepping": "one step forward, exact contact"},
    {"ensemble": "numbers become lanes", "model": "beams, stops, drives, equations"},
    {"plot": "pictures, in one style", "results": "units, axes, files"},
)
"""From the top down. A room may import those below, and those to its right."""
ORDER = [room for floor in FLOORS for room in floor] + ["_tools"]
MOST_LINES = 400
WIDTH, HEIGHT, PITCH, MARGIN, GAP = 880, 56, 84, 20, 36
INK, PAPER, EDGE, ARROW = "#1a1a1a", "#f4f6f8", "#37474f", "#808b91"


def modules() -> dict[str, Path]:
    """Return the files of the package by module, without `vibrojax` itself."""
    found = {}
    for path in sorted(PACKAGE.rglob("*.py")):
        parts = path.relative_to(PACKAGE.parent).with_suffix("").parts
        found[".".join(part for part in parts if part != "__init__")] = path
    return {name: path for name, path in found.items() if name != PACKAGE.name}


def imports() -> dict[str, set[str]]:
    """Return what every module imports of the package, wherever the import stands.

    Those inside of functions and those for the type checker count too.
    """
    known, found = modules(), {}
    for name, path in known.items():
        nodes = [n for n in ast.walk(ast.parse(path.read_text())) if isinstance(n, ast.ImportFrom)]
        wanted = {(n.module or "", part.name) for n in nodes for part in n.names}
        named = {f"{m}.{part}" if f"{m}.{part}" in known else m for m, part in wanted}
        found[name] = {other for other in named if other in known}
    return found


def room_of(module: str) -> str:
    """Return the room of a module."""
    return module.split(".")[1]


def upward(found: dict[str, set[str]]) -> list[tuple[str, str]]:
    """Return the imports that go up: there must be none."""
    place = {room: k for k, room in enumerate(ORDER)}
    pairs = [(a, b) for a, others in found.items() for b in others]
    return sorted((a, b) for a, b in pairs if place[room_of(a)] > place[room_of(b)])


def circle(found: dict[str, set[str]]) -> list[str]:
    """Return modules that import each other in a circle, if there are any."""
    try:
        graphlib.TopologicalSorter(found).prepare()
    except graphlib.CycleError as error:
        return error.args[1]
    return []


def too_long() -> list[str]:
    """Return the modules that are about more than one thing, by their length."""
    lines = {name: len(path.read_text().splitlines()) for name, path in modules().items()}
    return [f"{name} ({count} lines)" for name, count in lines.items() if count > MOST_LINES]


def drawing(found: dict[str, set[str]]) -> str:
    """Return the SVG: rooms on their floors, and who imports whom on the next floor down."""
    pairs = {(room_of(a), room_of(b)) for a, others in found.items() for b in others}
    boxes, parts = {}, []
    for k, floor in enumerate(FLOORS):
        width = (WIDTH - GAP * (len(floor) - 1)) / len(floor)
        for j, room in enumerate(floor):
            boxes[room] = MARGIN + j * (width + GAP), MARGIN + k * PITCH, width
    for upper, (x1, y1, w1) in boxes.items():
        for lower, (x2, y2, w2) in boxes.items():
            if (upper, lower) not in pairs:
                continue
            if y2 == y1 + PITCH:
                left, right = max(x1, x2), min(x1 + w1, x2 + w2)
                if left < right:
                    start = end = (left + right) / 2
                elif left == x1:  # aslant, between the corners that are nearest
                    start, end = left + 40, right - 40
                else:
                    start, end = right - 40, left + 40
                parts.append(_arrow(start, y1 + HEIGHT, end, y2 - 2))
            elif y2 == y1 and x2 == x1 + w1 + GAP:
                parts.append(_arrow(x1 + w1 + 1, y1 + HEIGHT / 2, x2 - 2, y1 + HEIGHT / 2))
    for floor in FLOORS:
        parts += [_box(boxes[room], room, words) for room, words in floor.items()]
    height = MARGIN * 2 + PITCH * (len(FLOORS) - 1) + HEIGHT
    body = "\n".join(parts)
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH + 2 * MARGIN} {height}" '
        'font-family="sans-serif" role="img" aria-label="Rooms of the package">\n'
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
        f'<text x="{middle:.0f}" y="{y + 24}" text-anchor="middle" font-size="18" '
        f'font-weight="bold" fill="{INK}">{name}/</text>'
        f'<text x="{middle:.0f}" y="{y + 44}" text-anchor="middle" font-size="15" '
        f'fill="{INK}">{words}</text>'
    )


def _arrow(x1, y1, x2, y2):
    return (
        f'<line x1="{x1:.0f}" y1="{y1:.0f}" x2="{x2:.0f}" y2="{y2:.0f}" stroke="{ARROW}" '
        'stroke-width="2.5" marker-end="url(#tip)"/>'
    )


if __name__ == "__main__":
    found = imports()
    faults = [f"{a} imports {b}, which is above it." for a, b in upward(found)]
    if round_trip := circle(found):
        faults.append(f"These import each other in a circle: {', '.join(round_trip)}.")
    faults += [f"{name} is too long: at most {MOST_LINES}." for name in too_long()]
    if faults:
        raise SystemExit("\n".join(faults))
    Path(__file__).with_name("house.svg").write_text(drawing(found))
