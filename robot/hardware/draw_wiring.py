"""Draws wiring.svg from wiring.yaml, which stand beside it: `python robot/hardware/draw_wiring.py`."""

from collections import defaultdict
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any

import yaml

HERE = Path(__file__).parent
WIDTH, GAP, PITCH, HEAD, SPACE, MARGIN = 250, 230, 24, 34, 34, 20
"""Of a part and between columns; between pins, above the first one, between parts, around it all."""
STYLE = """
text { font: 13px system-ui, 'DejaVu Sans', sans-serif; fill: #1f2328 } .net { fill: #0b5cad } .end { text-anchor: end }
.paper { fill: #ffffff } .part { fill: #f3f5f8; stroke: #59636e }
.wire { fill: none; stroke: #0b5cad; stroke-width: 1.5 }
@media (prefers-color-scheme: dark) { text { fill: #e6edf3 } .paper { fill: #0d1117 }
.part { fill: #151b23; stroke: #9aa4af } .net { fill: #6cb0ff } .wire { stroke: #6cb0ff } }
"""


@dataclass(frozen=True)
class Pin:
    """Where a pin is, in which column, and to which side its wire leaves."""

    x: float
    y: float
    column: int
    side: int


def place(columns: list[dict[str, Any]]) -> tuple[dict[str, Pin], list[str], float]:
    """Every pin by its name `part.pin`, the parts as SVG, and the height of the drawing."""
    pins, drawn, height = {}, [], 0.0
    for column, parts in enumerate(columns):
        left_x, y = MARGIN + column * (WIDTH + GAP), float(MARGIN)
        for name, part in parts.items():
            left, right = part.get("left", []), part.get("right", [])
            tall = HEAD + PITCH * max(len(left), len(right))
            drawn.append(f'<rect class="part" x="{left_x}" y="{y:g}" width="{WIDTH}" height="{tall:g}" rx="4"/>')
            drawn.append(f'<text x="{left_x + 8}" y="{y + 18:g}" font-weight="600">{escape(part["title"])}</text>')
            for side, names in ((-1, left), (1, right)):
                for index, pin in enumerate(map(str, names)):
                    at = Pin(left_x + WIDTH * (side > 0), y + HEAD + PITCH * (index + 0.4), column, side)
                    pins[f"{name}.{pin}"] = at
                    anchor = ' class="end"' if side > 0 else ""
                    drawn.append(f'<text{anchor} x="{at.x - 8 * side:g}" y="{at.y + 4:g}">{escape(pin)}</text>')
            y += tall + SPACE
        height = max(height, y)
    return pins, drawn, height


def draw(source: dict[str, Any]) -> str:
    """The whole drawing as SVG; KeyError for a net with a pin that no part has, ValueError for one in two nets."""
    pins, drawn, height = place(source["columns"])
    lanes: defaultdict[int, int] = defaultdict(int)
    wired: set[str] = set()
    for net, names in source["nets"].items():
        ends = [pins[name] for name in names]
        if again := wired & set(names):
            raise ValueError(f"{', '.join(again)} is in two nets")
        wired |= set(names)
        first, last = ends[0], ends[-1]
        if len(ends) == 2 and last.column == first.column + 1 and first.side == 1 and last.side == -1:
            lanes[first.column] += 1
            x = first.x + 22 * lanes[first.column]
            drawn.append(f'<path class="wire" d="M{first.x:g} {first.y:g}H{x:g}V{last.y:g}H{last.x:g}"/>')
            continue
        for end in ends:
            to_x = end.x + 14 * end.side
            anchor = " end" if end.side < 0 else ""
            drawn.append(f'<path class="wire" d="M{end.x:g} {end.y:g}H{to_x:g}"/>')
            drawn.append(
                f'<text class="net{anchor}" x="{to_x + 4 * end.side:g}" y="{end.y + 4:g}">{escape(net)}</text>'
            )
    width = 2 * MARGIN + len(source["columns"]) * (WIDTH + GAP) - GAP
    head = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:g} {height:g}">\n<style>{STYLE}</style>\n'
    return "\n".join([f'{head}<rect class="paper" width="100%" height="100%"/>', *drawn, "</svg>", ""])


def drawing() -> str:
    """The drawing of wiring.yaml as it is."""
    return draw(yaml.safe_load((HERE / "wiring.yaml").read_text(encoding="utf-8")))


if __name__ == "__main__":
    (HERE / "wiring.svg").write_text(drawing(), encoding="utf-8")
