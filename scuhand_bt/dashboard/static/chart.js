// The course of a dose: reading and estimate against the tolerance, and what the hand did.

const SVG = "http://www.w3.org/2000/svg";
const WIDTH = 640, HEIGHT = 300, LEFT = 52, RIGHT = 10, TOP = 12, SPLIT = 205, LOWER = 225, BOTTOM = 278;

function part(name, attributes, text) {
  const element = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
  if (text !== undefined) element.textContent = text;
  return element;
}

// points: [time_s, net_mg, opening_mm, vibration, stable, estimate_mg]; dose: {target_mg, tolerance_mg} or null.
export function draw(holder, points, dose) {
  const svg = part("svg", {viewBox: `0 0 ${WIDTH} ${HEIGHT}`, role: "img"});
  const first = points.length ? points[0][0] : 0, last = points.length ? points[points.length - 1][0] : 1;
  const most = Math.max(1, ...points.map((p) => Math.max(p[1], p[5])), dose ? 1.15 * (dose.target_mg + dose.tolerance_mg) : 0);
  const least = Math.min(0, ...points.map((p) => p[1]));
  const widest = Math.max(0.5, ...points.map((p) => p[2]));
  const x = (s) => LEFT + (WIDTH - LEFT - RIGHT) * (s - first) / Math.max(1e-6, last - first);
  const y = (mg) => SPLIT - (SPLIT - TOP) * (mg - least) / (most - least);
  const z = (share) => BOTTOM - (BOTTOM - LOWER) * share;
  const line = (kind, value) => svg.append(part("polyline",
    {class: kind, points: points.map((p) => `${x(p[0]).toFixed(1)},${value(p).toFixed(1)}`).join(" ")}));
  if (dose) {
    const high = y(dose.target_mg + dose.tolerance_mg), low = y(dose.target_mg - dose.tolerance_mg);
    svg.append(part("rect", {class: "band", x: LEFT, y: high, width: WIDTH - LEFT - RIGHT, height: Math.max(1.5, low - high)}));
    svg.append(part("text", {x: LEFT - 4, y: y(dose.target_mg) + 4, "text-anchor": "end"}, dose.target_mg.toPrecision(3)));
  }
  svg.append(part("path", {class: "axis", d: `M${LEFT},${TOP}V${SPLIT}H${WIDTH - RIGHT}M${LEFT},${LOWER}V${BOTTOM}H${WIDTH - RIGHT}`}));
  svg.append(part("text", {x: LEFT - 4, y: y(0) + 4, "text-anchor": "end"}, "0 mg"));
  svg.append(part("text", {x: LEFT - 4, y: LOWER + 5, "text-anchor": "end"}, `${widest.toFixed(1)} mm`));
  line("estimate", (p) => y(p[5]));
  line("reading", (p) => y(p[1]));
  for (const p of points) if (p[4]) svg.append(part("circle", {class: "stable", cx: x(p[0]), cy: y(p[1]), r: 3}));
  line("opening", (p) => z(p[2] / widest));
  line("vibration", (p) => z(p[3]));
  svg.append(part("text", {x: LEFT, y: HEIGHT - 4}, `${first.toFixed(0)} s`));
  svg.append(part("text", {x: WIDTH - RIGHT, y: HEIGHT - 4, "text-anchor": "end"}, `${last.toFixed(0)} s`));
  const now = points.length ? `${points[points.length - 1][1].toFixed(1)} mg dispensed` : "nothing dispensed yet";
  svg.setAttribute("aria-label", `Course of the dose: ${now}${dose ? ` of ${dose.target_mg} mg` : ""}`);
  holder.replaceChildren(svg);
}
