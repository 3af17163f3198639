"""Draws docs/scoop_*.svg from the planned strokes themselves: `python docs/draw_scoop.py`."""

import math
from pathlib import Path

import numpy as np

from scuhand_bt.dosing.jars import along_floor
from scuhand_bt.dosing.ladle import Ladle, Stroke
from scuhand_bt.dosing.swing import StrokePath, stroke_path
from scuhand_bt.dosing.vessel import Vessel
from scuhand_bt.specs import Mortar

DOCS = Path(__file__).parent
SCALE = 4.0
STYLE = """
text { font: 13px system-ui, 'DejaVu Sans', sans-serif; fill: #1f2328 }
.it { font-style: italic } .large { font-size: 30px }
.paper { fill: #ffffff } .vessel { fill: #d5d9df } .powder { fill: #e8cf9a }
.cone { stroke: #2f6fb2; stroke-width: 2.2 }
.handle { stroke: #59636e; stroke-width: 5; stroke-linecap: round } .thin { stroke: #8b949e; stroke-width: 1 }
.axis { stroke: #c2410c; stroke-width: 1.3; stroke-dasharray: 5 3 } .lip { fill: #2f6fb2 } .apex { fill: #c2410c }
.cone, .handle, .thin, .axis { fill: none }
@media (prefers-color-scheme: dark) {
text { fill: #e6edf3 } .paper { fill: #0d1117 } .vessel { fill: #30363d } .powder { fill: #7d6a3c }
.cone { stroke: #6cb6ff } .lip { fill: #6cb6ff } .handle { stroke: #9aa4af }
.axis { stroke: #f0883e } .apex { fill: #f0883e }
}
"""
MORTAR = Vessel.bowl(90.0, 30.0, 115.0)
SMALL = Vessel.bowl(65.0, 22.0, 85.0)
JAR = Mortar(name="jar", bore_mm=95.0, depth_mm=40.0, height_mm=55.0, outer_diameter_mm=103.0, corner_mm=5.0)
LADLE = Ladle()
HANDLE_MM = 95.0
"""From the apex, as far as it is drawn."""


class Drawing:
    """An SVG in millimetres, x to the right and z up, the origin in the middle of the bottom line."""

    def __init__(self, half_width_mm: float, height_mm: float, below_mm: float = 14.0) -> None:
        self._half, self._height, self._below = half_width_mm, height_mm, below_mm
        self.parts: list[str] = []

    def point(self, x: float, z: float) -> str:
        return f"{(x + self._half) * SCALE:.1f},{(self._height - z) * SCALE:.1f}"

    def line(self, kind: str, *points: tuple[float, float]) -> None:
        self.parts.append(f'<polyline class="{kind}" points="{" ".join(self.point(x, z) for x, z in points)}"/>')

    def area(self, kind: str, points: list[tuple[float, float]]) -> None:
        self.parts.append(f'<polygon class="{kind}" points="{" ".join(self.point(x, z) for x, z in points)}"/>')

    def dot(self, kind: str, x: float, z: float) -> None:
        px, pz = self.point(x, z).split(",")
        self.parts.append(f'<circle class="{kind}" cx="{px}" cy="{pz}" r="4"/>')

    def text(self, x: float, z: float, words: str, kind: str = "", anchor: str = "middle") -> None:
        px, pz = self.point(x, z).split(",")
        self.parts.append(f'<text class="{kind}" x="{px}" y="{pz}" text-anchor="{anchor}">{words}</text>')

    def arc(self, x: float, z: float, radius: float, first: float, last: float) -> None:
        """About (x, z), between angles [rad] from the x axis upwards."""
        turns = np.linspace(first, last, 24).tolist()
        self.line("thin", *((x + radius * math.cos(turn), z + radius * math.sin(turn)) for turn in turns))

    def written(self) -> str:
        width, height = 2 * self._half * SCALE, (self._height + self._below) * SCALE
        head = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:.0f} {height:.0f}"><style>{STYLE}</style>'
        paper = f'<rect class="paper" width="{width:.0f}" height="{height:.0f}"/>'
        return "\n".join([head, paper, *self.parts, "</svg>\n"])


def vessel(drawing: Drawing, one: Vessel, shift_mm: float = 0.0) -> None:
    """Cut through the middle."""
    out, high, _ = one.wall(np.linspace(-one.to_edge_mm, one.to_edge_mm, 160))
    inside = [(x + shift_mm, z) for x, z in zip(out.tolist(), high.tolist(), strict=True)]
    half = one.outer_mm / 2
    outside = [(half, one.depth_mm), (half, -10.0), (-half, -10.0), (-half, one.depth_mm)]
    drawing.area("vessel", inside + [(x + shift_mm, z) for x, z in outside])


def bed(drawing: Drawing, one: Vessel, height_mm: float, shift_mm: float = 0.0) -> None:
    """Levelled powder so high."""
    half = math.sqrt(height_mm * (2 * one.corner_mm - height_mm)) if one.floor_mm == 0 else one.bore_mm / 2
    out, high, _ = one.wall(np.linspace(-one.to_edge_mm, one.to_edge_mm, 400))
    below = [(x + shift_mm, z) for x, z in zip(out.tolist(), high.tolist(), strict=True) if z <= height_mm]
    drawing.area("powder", [(-half + shift_mm, height_mm), *below, (half + shift_mm, height_mm)])


def hand(drawing: Drawing, path: StrokePath, k: int, shift_mm: float = 0.0) -> None:
    """Cone and handle at the k-th pose."""
    (ax, _, az), (sx, _, sz), (lx, _, lz) = path.apex_mm[k], path.seam[k], path.lip_mm[k]
    ax, lx = ax + shift_mm, lx + shift_mm
    top = (ax + LADLE.slant_mm * sx, az + LADLE.slant_mm * sz)
    drawing.line("handle", top, (ax + HANDLE_MM * sx, az + HANDLE_MM * sz))
    drawing.line("cone", (lx, lz), (ax, az), top)
    drawing.dot("lip", lx, lz)
    drawing.dot("apex", ax, az)


def along(path: StrokePath, shares: tuple[float, ...]) -> list[int]:
    """The poses at these shares of the way along the wall."""
    on_wall = np.flatnonzero(path.on_wall)
    return [int(on_wall[round(share * (len(on_wall) - 1))]) for share in shares]


def angles() -> Drawing:
    """The angles at one moment of the swing."""
    drawing = Drawing(75.0, 95.0)
    vessel(drawing, MORTAR)
    path = stroke_path(MORTAR, Stroke(82.0, 70.0, -28.0), LADLE)
    k = along(path, (0.62,))[0]
    centre = (0.0, MORTAR.corner_mm)
    (ax, _, az), (lx, _, lz), (ux, _, uz) = path.apex_mm[k], path.lip_mm[k], path.axis[k]
    phi = math.atan2(lx, centre[1] - lz)
    drawing.line("thin", centre, (lx, lz))
    drawing.line("thin", centre, (0.0, 0.0))
    drawing.arc(*centre, 16.0, -math.pi / 2, -math.pi / 2 + phi)
    drawing.text(3.5, centre[1] - 21.5, "φ", "it")
    drawing.text(-4.0, centre[1] + 1.0, "C", "it")
    drawing.text(lx / 2 + 7.0, (centre[1] + lz) / 2 + 4.0, "R", "it")
    tangent = (math.cos(phi), math.sin(phi))
    drawing.line("thin", (lx - 34 * tangent[0], lz - 34 * tangent[1]), (lx + 26 * tangent[0], lz + 26 * tangent[1]))
    hand(drawing, path, k)
    drawing.line("axis", (ax, az), (ax + 62 * ux, az + 62 * uz))
    drawing.line("thin", (ax, az), (ax, az + 40))
    tilt = math.atan2(ux, uz)
    drawing.arc(ax, az, 30.0, math.pi / 2, math.pi / 2 - tilt)
    drawing.text(ax + 33 * math.sin(tilt / 2), az + 33 * math.cos(tilt / 2), "θ", "it")
    generator = math.atan2(lz - az, lx - ax)
    drawing.arc(ax, az, 21.0, math.pi / 2 - tilt, generator)
    middle = (math.pi / 2 - tilt + generator) / 2
    drawing.text(ax + 25 * math.cos(middle), az + 25 * math.sin(middle) - 1.0, "α", "it")
    drawing.arc(lx, lz, 24.0, math.pi + generator, math.pi + phi)
    middle = math.pi + (generator + phi) / 2
    drawing.text(lx + 28 * math.cos(middle), lz + 28 * math.sin(middle) - 1.0, "β", "it")
    drawing.text(ax - 4.0, az - 1.0, "A", "it")
    drawing.text((ax + lx) / 2, (az + lz) / 2 - 5.0, "L", "it")
    drawing.text(lx + 4.5, lz - 4.0, "P", "it")
    return drawing


def swing(one: Vessel, stroke: Stroke, bed_mm: float, shares: tuple[float, ...], half_mm: float) -> Drawing:
    """A stroke, pose by pose beside each other."""
    path = stroke_path(one, stroke, LADLE)
    looks = [*along(path, shares), len(path.times_s) - 1]
    step_mm = 2 * half_mm
    drawing = Drawing(step_mm * len(looks) / 2, 132.0, 24.0)
    for n, k in enumerate(looks):
        shift_mm = (n - (len(looks) - 1) / 2) * step_mm
        vessel(drawing, one, shift_mm)
        if n == 0:
            bed(drawing, one, bed_mm, shift_mm)
        hand(drawing, path, k, shift_mm)
        tilt_deg = math.degrees(math.atan2(path.axis[k, 0], path.axis[k, 2]))
        words = f"θ {tilt_deg:.0f}°, rim {path.rim_mm[k]:.0f} mm"
        if path.on_wall[k]:
            words += f", β {path.attack_deg[k]:.0f}°"
        drawing.text(shift_mm, -19.0, words, "large")
    return drawing


def main() -> None:
    """All drawings."""
    drawings = {
        "scoop_angles": angles(),
        "scoop_swing": swing(MORTAR, Stroke(82.0, 70.0, -28.0), 7.4, (0.0, 0.35, 0.7, 1.0), 78.0),
        "scoop_small": swing(SMALL, Stroke(58.0, 46.0, -18.0), 6.0, (0.0, 0.35, 0.7, 1.0), 72.0),
        "scoop_jar": swing(Vessel.of(JAR), along_floor(JAR, LADLE.slant_mm), 2.5, (0.0, 0.4, 1.0), 88.0),
    }
    for name, drawing in drawings.items():
        (DOCS / f"{name}.svg").write_text(drawing.written(), encoding="utf-8")


if __name__ == "__main__":
    main()
