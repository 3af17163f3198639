"""One motion of the arm to look at: `scuhand-bt show-move A B`.

A self-contained page with the arm moving in 3D among the cell's solids, and the joints' position, speed,
acceleration and jerk and the cone's spill angle over time, each with its limits; or the same as a PNG.
"""

import json
from html import escape
from pathlib import Path

import coal
import numpy as np
import pinocchio as pin

from scuhand_bt.motion.collision import Scene
from scuhand_bt.motion.kinematics import LIMITS_RAD, Floats, apex_positions_m
from scuhand_bt.motion.spill import apex_motion, spill_angles_deg
from scuhand_bt.motion.trajectory import JointTrajectory

FRAMES_PER_S = 40
_COLOURS = ("#d62728", "#1f77b4", "#2ca02c", "#ff7f0e", "#9467bd", "#17a2a8", "#8c564b")


def move_page(motion: JointTrajectory, scene: Scene, apex_offset_m: float, title: str) -> str:
    """The motion as a self-contained HTML page."""
    times_s = np.linspace(0.0, motion.duration_s, max(2, int(motion.duration_s * FRAMES_PER_S)))
    q = motion.at(times_s)
    path_m, _ = apex_positions_m(q, apex_offset_m)
    data = {
        "frames": [_moving(scene, one) for one in q],
        "boxes": _boxes(scene),
        "path": np.round(path_m, 4).tolist(),
        "duration": motion.duration_s,
    }
    plots = "".join(_plot(*panel) for panel in _panels(motion, scene, apex_offset_m))
    return (
        _PAGE.replace("%TITLE%", escape(title))
        .replace("%DURATION%", f"{motion.duration_s:.2f}")
        .replace("%PLOTS%", plots)
        .replace("%DATA%", json.dumps(data, separators=(",", ":")))
    )


def move_png(motion: JointTrajectory, scene: Scene, apex_offset_m: float, title: str, file: Path) -> None:
    """The motion's plots, and the arm at five moments, as a PNG; needs matplotlib (the extra `plot`)."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    panels = _panels(motion, scene, apex_offset_m)
    figure = Figure(figsize=(12, 10), layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.add_gridspec(3, 2)
    view = figure.add_subplot(grid[0, 0], projection="3d")
    for share in np.linspace(0.0, 1.0, 5):
        for kind, radius_m, first, last in _moving(scene, motion.sample(share * motion.duration_s)):
            ends = np.array([first, last])
            colour = "#d9822b" if kind == "cone" else "#4a6fa5"
            view.plot(*ends.T, lw=160 * radius_m, alpha=0.15 + 0.6 * share, color=colour, solid_capstyle="round")
    for corners in _boxes(scene):
        points = np.array(corners)
        for a, b in _EDGES:
            view.plot(*points[[a, b]].T, color="#888", lw=0.6)
    view.plot(*apex_positions_m(motion.at(np.linspace(0, motion.duration_s, 200)), apex_offset_m)[0].T, color="#c62828")
    view.set(xlim=(-0.1, 0.6), ylim=(-0.35, 0.35), zlim=(0, 0.6), title=title)
    for k, (name, times_s, values, limits) in enumerate(panels):
        axes = figure.add_subplot(grid[(k + 1) // 2, (k + 1) % 2])
        for joint, (column, colour) in enumerate(zip(values.T, _COLOURS, strict=False), start=1):
            axes.plot(times_s, column, color=colour, lw=1.2, label=f"j{joint}")
        for limit in limits:
            axes.axhline(limit, color="#555", ls="--", lw=0.8)
        axes.set(title=name, xlabel="time [s]")
        if k == 0:
            axes.legend(ncols=7, fontsize=7, loc="upper center")
    figure.savefig(file, dpi=110)


Panel = tuple[str, Floats, Floats, list[float]]


def _panels(motion: JointTrajectory, scene: Scene, apex_offset_m: float) -> list[Panel]:
    """Name, times (n,), values (n, k) and limits of each plot."""
    times_s = np.linspace(0.0, motion.duration_s, 400)
    q, speed, acceleration, jerk = (motion.at(times_s, k) for k in range(4))
    spill = spill_angles_deg(*apex_motion(q, speed, acceleration, apex_offset_m))[:, None]
    rates = scene.rates
    both = [[float(-x), float(x)] for x in (rates.speed.max(), rates.acceleration.max(), rates.jerk.max())]
    ends = [float(np.degrees(LIMITS_RAD[0].min())), float(np.degrees(LIMITS_RAD[1].max()))]
    return [
        ("joint position [deg]", times_s, np.degrees(q), ends),
        ("joint speed [rad/s]; j2's limit is lower", times_s, speed, [*both[0], float(rates.speed.min())]),
        ("joint acceleration [rad/s²]", times_s, acceleration, both[1]),
        ("joint jerk [rad/s³]", times_s, jerk, both[2]),
        ("spill angle [deg]", times_s, spill, [] if motion.spill_limit_deg is None else [motion.spill_limit_deg]),
    ]


def _moving(scene: Scene, q: Floats) -> list[tuple[str, float, list[float], list[float]]]:
    """The arm's round shapes at a configuration: kind, radius and the two ends of the axis [m]."""
    data, shapes = scene.model.createData(), pin.GeometryData(scene.shapes)
    pin.updateGeometryPlacements(scene.model, data, scene.shapes, shapes, q)
    found = []
    for thing, placement in zip(scene.shapes.geometryObjects, shapes.oMg, strict=True):
        shape = thing.geometry
        if thing.parentJoint == 0 or isinstance(shape, coal.Box):
            continue
        kind = {"Capsule": "capsule", "Cone": "cone"}.get(type(shape).__name__, "cylinder")
        ends = [placement.act(np.array([0.0, 0.0, s * shape.halfLength])) for s in (-1.0, 1.0)]
        found.append((kind, float(shape.radius), *(np.round(end, 4).tolist() for end in ends)))
    return found


_EDGES = ((0, 1), (2, 3), (4, 5), (6, 7), (0, 2), (1, 3), (4, 6), (5, 7), (0, 4), (1, 5), (2, 6), (3, 7))


def _boxes(scene: Scene) -> list[list[list[float]]]:
    """Eight corners of every fixed solid (a cylinder by the box around it), without the table."""
    boxes = []
    for thing in scene.shapes.geometryObjects:
        if thing.parentJoint != 0 or thing.name == "table":
            continue
        thing.geometry.computeLocalAABB()
        low, high = thing.geometry.aabb_local.min_, thing.geometry.aabb_local.max_
        corners = [[(low, high)[i][0], (low, high)[j][1], (low, high)[k][2]] for i, j, k in np.ndindex(2, 2, 2)]
        boxes.append([np.round(thing.placement.act(np.array(corner)), 4).tolist() for corner in corners])
    return boxes


def _plot(name: str, times_s: Floats, values: Floats, limits: list[float]) -> str:
    """One plot as an SVG."""
    width, height, left, top = 520, 190, 52, 26
    low = min(float(values.min()), *limits, 0.0)
    high = max(float(values.max()), *limits, 1e-9)
    low, high = low - 0.05 * (high - low), high + 0.05 * (high - low)
    end_s = float(times_s[-1])

    def at(time_s: float, value: float) -> str:
        x = left + time_s / end_s * (width - left - 10)
        return f"{x:.1f},{top + (high - value) / (high - low) * (height - top - 24):.1f}"

    lines = [
        f'<polyline points="{" ".join(at(t, v) for t, v in zip(times_s, column, strict=True))}" stroke="{colour}"/>'
        for column, colour in zip(values.T, _COLOURS, strict=False)
    ]
    for limit in limits:
        lines.append(f'<polyline points="{at(0, limit)} {at(end_s, limit)}" stroke="#555" stroke-dasharray="5 4"/>')
        x, y = at(0, limit).split(",")
        lines.append(f'<text x="{float(x) - 5:.0f}" y="{float(y) + 4:.0f}" text-anchor="end">{limit:.3g}</text>')
    joints = "".join(f'<tspan fill="{_COLOURS[k]}"> j{k + 1}</tspan>' for k in range(7)) if values.shape[1] == 7 else ""
    return (
        f'<svg viewBox="0 0 {width} {height}"><text x="{left}" y="16">{name}{joints}</text>'
        f'<rect x="{left}" y="{top}" width="{width - left - 10}" height="{height - top - 24}" class="frame"/>'
        f'{"".join(lines)}<text x="{width - 10}" y="{height - 6}" text-anchor="end">{end_s:.2f} s</text></svg>'
    )


_PAGE = """<!doctype html><html lang="en"><meta charset="utf-8"><title>%TITLE%</title>
<style>body{font:15px system-ui,sans-serif;margin:20px;color:#222;max-width:1120px}
canvas{width:100%;background:linear-gradient(#f4f7fa,#fff);border:1px solid #ddd;border-radius:6px;cursor:grab}
.plots{display:grid;grid-template-columns:1fr 1fr;gap:8px}svg text{font-size:12px}polyline{fill:none;stroke-width:1.4}
.frame{fill:none;stroke:#ccc}input{width:70%;vertical-align:middle}</style>
<h1>%TITLE%</h1><p>%DURATION% s. Drag to turn, wheel to zoom.
<button id="play">pause</button> <input id="at" type="range" min="0" max="1" step="0.001" value="0"></p>
<canvas id="view" width="1100" height="560"></canvas><div class="plots">%PLOTS%</div>
<script>
const D=%DATA%,c=document.getElementById("view"),g=c.getContext("2d"),slider=document.getElementById("at");
let yaw=-2.25,pitch=0.42,zoom=900,share=0,playing=true,last=null;
const EDGES=[[0,1],[2,3],[4,5],[6,7],[0,2],[1,3],[4,6],[5,7],[0,4],[1,5],[2,6],[3,7]];
function project(p){const x=p[0]-.2,y=p[1],z=p[2]-.22,a=Math.cos(yaw)*x-Math.sin(yaw)*y,
b=Math.sin(yaw)*x+Math.cos(yaw)*y,
d=Math.cos(pitch)*b-Math.sin(pitch)*z,h=Math.sin(pitch)*b+Math.cos(pitch)*z,s=zoom*1.6/(1.6+d);
return [c.width/2+a*s,c.height/2-h*s,d,s]}
function line(points,style,width){g.strokeStyle=style;g.lineWidth=width;g.beginPath();
points.forEach((p,i)=>{const q=project(p);i?g.lineTo(q[0],q[1]):g.moveTo(q[0],q[1])});g.stroke()}
function cone(base,tip,r){const n=[tip[0]-base[0],tip[1]-base[1],tip[2]-base[2]],l=Math.hypot(...n);
const u=Math.abs(n[2])<.9*l?[0,0,1]:[1,0,0];
const cross=(a,b)=>[a[1]*b[2]-a[2]*b[1],a[2]*b[0]-a[0]*b[2],a[0]*b[1]-a[1]*b[0]];
let e=cross(n,u);const m=Math.hypot(...e);e=e.map(v=>v/m*r);const f=cross(n,e).map(v=>v/l);
const rim=[...Array(25).keys()].map(k=>{const t=k*Math.PI/12;
return base.map((v,i)=>v+e[i]*Math.cos(t)+f[i]*Math.sin(t))});
g.fillStyle="#e8a04dcc";for(let k=0;k<24;k++){g.beginPath();[rim[k],rim[k+1],tip].forEach((p,i)=>{const q=project(p);
i?g.lineTo(q[0],q[1]):g.moveTo(q[0],q[1])});g.fill()}line(rim,"#9c5a12",1.5)}
function draw(){g.clearRect(0,0,c.width,c.height);g.lineCap="round";
for(let k=-4;k<=4;k++){line([[k*.1+.2,-.5,0],[k*.1+.2,.5,0]],"#e3e8ec",1);
line([[-.2,k*.12,0],[.6,k*.12,0]],"#e3e8ec",1)}
D.boxes.forEach(b=>EDGES.forEach(([i,j])=>line([b[i],b[j]],"#7d8a96",1)));
line(D.path,"#c62828",2);
const frame=D.frames[Math.min(D.frames.length-1,Math.round(share*(D.frames.length-1)))];
frame.map(s=>[project(s[2].map((v,i)=>(v+s[3][i])/2)),s]).sort((a,b)=>b[0][2]-a[0][2]).forEach(([m,s])=>{
if(s[0]=="cone"){cone(s[2],s[3],s[1]);return}
g.lineCap=s[0]=="capsule"?"round":"butt";line([s[2],s[3]],"#3d5f8f",2*s[1]*m[3]);
line([s[2],s[3]],"#6d93c6",1.7*s[1]*m[3])});}
function tick(now){if(playing&&last!==null){share=(share+(now-last)/1000/D.duration)%1.15;
slider.value=Math.min(share,1)}
last=now;draw();requestAnimationFrame(tick)}
slider.oninput=()=>{playing=false;share=+slider.value;document.getElementById("play").textContent="play"};
document.getElementById("play").onclick=e=>{playing=!playing;e.target.textContent=playing?"pause":"play"};
c.onmousedown=()=>{c.onmousemove=e=>{yaw+=e.movementX*.008;pitch=Math.max(-.2,Math.min(1.5,pitch+e.movementY*.006))}};
window.onmouseup=()=>{c.onmousemove=null};c.onwheel=e=>{e.preventDefault();zoom*=Math.exp(-e.deltaY*.001)};
requestAnimationFrame(tick);
</script></html>
"""
