"""Draws the rooms of `scuhand_bt`: the layers of pyproject.toml's contract, and what really imports what.

    python docs/draw_rooms.py             # docs/rooms.svg
    python docs/draw_rooms.py -o FILE     # elsewhere

A line says that the upper room imports the lower one. What follows from other lines is left out (the transitive
reduction). A line over several layers passes each of them beside its rooms. Rooms are ordered for few crossings, by
swaps of neighbours, and stand as near to the mean of what they are linked with as their order and widths allow.
`tests/test_docs.py` fails when docs/rooms.svg is stale.
"""

import argparse
import sys
import tomllib
from dataclasses import dataclass, field
from html import escape
from itertools import pairwise
from pathlib import Path

import grimp

ROOT = Path(__file__).parent.parent
PACKAGE = "scuhand_bt"
ROW, BOX, GAP, LINE_GAP, MARGIN, LEFT = 62, 32, 22, 16, 16, 44
"""Heights of a layer and of a room, the least gaps between rooms and beside a line, the margin, the layers' numbers."""
CHARACTER = 8.45
SWEEPS = 200
STRAIGHT = 8.0
"""How much more a line's course counts between two layers that it only passes."""
STYLE = """
text { font: 14px ui-monospace, 'DejaVu Sans Mono', Menlo, Consolas, monospace; text-anchor: middle; fill: #1f2328 }
.small { font: 12px system-ui, 'DejaVu Sans', sans-serif; text-anchor: start; fill: #59636e }
.paper { fill: #ffffff } .band { fill: #f3f5f8 } .room { fill: #d9e8f8; stroke: #2f6fb2 }
.module { fill: #ffffff; stroke: #818b98 } .pure { fill: #dcf2df; stroke: #2c8a43 }
.line { fill: none; stroke: #6b7683; stroke-width: 1.3 } .tip { fill: #6b7683 }
@media (prefers-color-scheme: dark) {
text { fill: #e6edf3 } .small { fill: #9aa4af } .paper { fill: #0d1117 } .band { fill: #151b23 }
.room { fill: #14304f; stroke: #4d8fd6 } .module { fill: #0d1117; stroke: #6e7681 }
.pure { fill: #12351c; stroke: #46a35c } .line { stroke: #8b949e } .tip { fill: #8b949e }
}
"""


@dataclass
class House:
    """Rooms by layer from the top, the imports between them, which are packages, and which are kept pure."""

    layers: list[list[str]]
    imports: set[tuple[str, str]]
    packages: set[str]
    pure: set[str]


@dataclass(eq=False)
class Spot:
    """A room in its layer, or (without a name) where a line passes a layer."""

    name: str
    width: float
    x: float = 0.0
    above: list["Spot"] = field(default_factory=list)
    below: list["Spot"] = field(default_factory=list)


def read_house(root: Path) -> House:
    """The house in a working tree; its package must not have been imported from elsewhere."""
    project = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))
    contracts = project["tool"]["importlinter"]["contracts"]
    lines = next(contract["layers"] for contract in contracts if contract["type"] == "layers")
    layers = [[name.strip(" ()") for name in line.replace("|", ":").split(":")] for line in lines]
    forbidden = [one for one in contracts if one["type"] == "forbidden" and not one.get("allow_indirect_imports")]
    pure = {name.removeprefix(f"{PACKAGE}.") for contract in forbidden for name in contract["source_modules"]}
    sys.path.insert(0, str(root))
    graph = grimp.build_graph(PACKAGE, cache_dir=None)
    rooms = {name for layer in layers for name in layer}

    def room_of(module: str) -> str:
        return module.removeprefix(f"{PACKAGE}.").partition(".")[0]

    imports = {
        (room_of(module), room_of(imported))
        for module in graph.modules
        for imported in graph.find_modules_directly_imported_by(module)
        if {room_of(module), room_of(imported)} <= rooms and room_of(module) != room_of(imported)
    }
    packages = {name for name in rooms if (root / PACKAGE / name).is_dir()}
    return House(layers, imports, packages, pure & rooms)


def reduced(imports: set[tuple[str, str]]) -> list[tuple[str, str]]:
    """The imports from which all others follow."""
    direct: dict[str, set[str]] = {}
    for room, imported in imports:
        direct.setdefault(room, set()).add(imported)

    def reached(room: str) -> set[str]:
        return direct.get(room, set()).union(*(reached(other) for other in direct.get(room, ())))

    return sorted(
        (room, imported)
        for room, imported in imports
        if not any(imported in reached(other) for other in direct[room] if other != imported)
    )


def draw(house: House) -> str:
    """The picture, as SVG that follows the reader's light or dark theme."""
    rows, lines, level = _laid_out(house)
    width = max(spot.x + spot.width / 2 for row in rows for spot in row) + MARGIN
    height = ROW * len(rows) + 2 * MARGIN + 40

    def y(row: int) -> float:
        return MARGIN + ROW * (row + 0.5)

    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:.0f} {height:.0f}" role="img">',
        f"<title>The rooms of {PACKAGE}, in {len(rows)} layers</title><style>{STYLE}</style>",
        f'<rect class="paper" width="{width:.0f}" height="{height:.0f}"/>',
    ]
    for i in range(len(rows)):
        if i % 2 == 0:
            parts.append(f'<rect class="band" x="0" y="{y(i) - ROW / 2:.0f}" width="{width:.0f}" height="{ROW}"/>')
        parts.append(f'<text class="small" x="{MARGIN}" y="{y(i) + 4:.0f}">{len(rows) - i}</text>')
    for stops in lines:
        parts.append(_line([(spot.x, y(i)) for i, spot in stops]))
    for room, imported in level:
        parts.append(_arc(room, imported, next(y(i) for i, row in enumerate(rows) if room in row)))
    for i, row in enumerate(rows):
        for spot in row:
            if spot.name:
                kind = "pure" if spot.name in house.pure else "room" if spot.name in house.packages else "module"
                box = f'x="{spot.x - spot.width / 2:.1f}" y="{y(i) - BOX / 2:.1f}" width="{spot.width:.1f}"'
                parts.append(f'<rect class="{kind}" {box} height="{BOX}" rx="5"/>')
                parts.append(f'<text x="{spot.x:.1f}" y="{y(i) + 5:.1f}">{escape(spot.name)}</text>')
    parts += _legend(height - 34, house, sum(map(len, house.layers)), len(rows))
    return "\n".join([*parts, "</svg>"]) + "\n"


def _laid_out(house: House) -> tuple[list[list[Spot]], list[list[tuple[int, Spot]]], list[tuple[Spot, Spot]]]:
    """The spots of each row, each line's stops from row to row, and the imports within a row."""
    rows = [[Spot(name, CHARACTER * len(name) + 22) for name in layer] for layer in house.layers]
    at = {spot.name: (i, spot) for i, row in enumerate(rows) for spot in row}
    lines: list[list[tuple[int, Spot]]] = []
    level: list[tuple[Spot, Spot]] = []
    for room, imported in reduced(house.imports):
        (top, upper), (bottom, lower) = at[room], at[imported]
        if top == bottom:
            level.append((upper, lower))
            continue
        stops = [(top, upper), *((i, Spot("", 0.0)) for i in range(top + 1, bottom)), (bottom, lower)]
        for i, spot in stops[1:-1]:
            rows[i].append(spot)
        for (_, one), (_, next_one) in pairwise(stops):
            one.below.append(next_one)
            next_one.above.append(one)
        lines.append(stops)
    for row in rows:
        _stand_apart(row, [0.0] * len(row))
    for _ in range(SWEEPS):
        for row in (*rows, *reversed(rows)):
            _reorder(row, level)
            _stand_apart(row, [_wanted(spot) for spot in row])
    left = min(spot.x - spot.width / 2 for row in rows for spot in row)
    for row in rows:
        for spot in row:
            spot.x += LEFT + MARGIN - left
    return rows, lines, level


def _wanted(spot: Spot) -> float:
    """The mean of what it is linked with; a line would rather go on straight."""
    linked = spot.above + spot.below
    weights = [1.0 if spot.name or other.name else STRAIGHT for other in linked]
    return sum(w * other.x for w, other in zip(weights, linked, strict=True)) / sum(weights) if linked else spot.x


def _reorder(row: list[Spot], level: list[tuple[Spot, Spot]]) -> None:
    """Swap neighbours as long as that saves crossings, or brings together what is linked within the row."""

    def cost() -> float:
        place = {id(spot): i for i, spot in enumerate(row)}
        crossings = sum(
            right.x < left.x
            for i, a in enumerate(row)
            for b in row[:i]
            for ends, others in ((a.above, b.above), (a.below, b.below))
            for right in ends
            for left in others
        )
        apart = sum(abs(place[id(a)] - place[id(b)]) for a, b in level if id(a) in place)
        return crossings + 1.5 * apart

    best, better = cost(), True
    while better:
        better = False
        for i in range(len(row) - 1):
            row[i], row[i + 1] = row[i + 1], row[i]
            if (now := cost()) < best - 1e-9:
                best, better = now, True
            else:
                row[i], row[i + 1] = row[i + 1], row[i]


def _stand_apart(row: list[Spot], wanted: list[float]) -> None:
    """Nearest to what is wanted, by least squares, in this order and with the gaps (pool adjacent violators)."""
    offsets = [0.0]
    for one, other in pairwise(row):
        offsets.append(offsets[-1] + (one.width + other.width) / 2 + (GAP if one.name and other.name else LINE_GAP))
    pools: list[list[float]] = []  # sum, weight and count
    for spot, x, offset in zip(row, wanted, offsets, strict=True):
        weight = 1.0 if spot.name else STRAIGHT
        pools.append([weight * (x - offset), weight, 1])
        while len(pools) > 1 and pools[-2][0] / pools[-2][1] > pools[-1][0] / pools[-1][1]:
            last = pools.pop()
            pools[-1] = [a + b for a, b in zip(pools[-1], last, strict=True)]
    means = [total / weight for total, weight, count in pools for _ in range(int(count))]
    for spot, mean, offset in zip(row, means, offsets, strict=True):
        spot.x = mean + offset


def _line(stops: list[tuple[float, float]]) -> str:
    """Down from a room, through the layers between, onto the next room."""
    x, y = stops[0]
    path = f"M{x:.1f} {y + BOX / 2:.1f}"
    for number, (next_x, next_y) in enumerate(stops[1:], start=1):
        last = number == len(stops) - 1
        top, bottom = y + BOX / 2, next_y - BOX / 2 - (5 if last else 0)
        bend = (top + bottom) / 2
        path += f" C{x:.1f} {bend:.1f} {next_x:.1f} {bend:.1f} {next_x:.1f} {bottom:.1f}"
        if not last:
            path += f" V{next_y + BOX / 2:.1f}"
        x, y = next_x, next_y
    return f'<path class="line" d="{path}"/>{_tip(x, y - BOX / 2)}'


def _arc(room: Spot, imported: Spot, y: float) -> str:
    """Below the row, from a room to another one of its layer."""
    below = y + BOX / 2
    x, end = room.x + (12 if imported.x > room.x else -12), imported.x + (-12 if imported.x > room.x else 12)
    path = f"M{x:.1f} {below:.1f} C{x:.1f} {below + 13:.1f} {end:.1f} {below + 13:.1f} {end:.1f} {below + 5:.1f}"
    return f'<path class="line" d="{path}"/><path class="tip" d="M{end:.1f} {below:.1f} l-3.5 6 h7 z"/>'


def _tip(x: float, y: float) -> str:
    return f'<path class="tip" d="M{x:.1f} {y:.1f} l-3.5 -6 h7 z"/>'


def _legend(y: float, house: House, rooms: int, layers: int) -> list[str]:
    parts, x = [], MARGIN
    kinds = [("room", "a package"), ("module", "one module")]
    kinds += [("pure", "kept pure: no clock, no device, no file")] if house.pure else []
    for kind, text in kinds:
        parts.append(f'<rect class="{kind}" x="{x}" y="{y:.0f}" width="16" height="12" rx="3"/>')
        parts.append(f'<text class="small" x="{x + 22}" y="{y + 10:.0f}">{text}</text>')
        x += 44 + round(6.6 * len(text))
    counts = f"{rooms} rooms, {layers} layers, {len(house.imports)} imports between rooms"
    where = f'x="{MARGIN}" y="{y + 28:.0f}"'
    parts.append(f'<text class="small" {where}>{counts}, all of them down or within a layer.</text>')
    return parts


def main() -> None:
    """Draw this tree."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", 1)[0])
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "docs" / "rooms.svg")
    parser.parse_args().output.write_text(draw(read_house(ROOT)), encoding="utf-8")


if __name__ == "__main__":
    main()
