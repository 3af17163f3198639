// Motions of the arm, one job's after another's, to be played in a page of its own.
//
// motions: [{job, at_s, step_s, joints_rad, cone_mm, rims_mm, pan}], in their order; each job's are played as if nothing lay between.

import {lasts, view} from "./viewer.js";

export function play(root, scene, motions, text) {
  const part = (name) => root.querySelector(`[data-part=${name}]`);
  const viewer = view(part("scene"), scene, text);
  const select = part("job"), slider = part("slider"), button = part("play"), label = part("time");
  const jobs = new Map();
  for (const motion of motions) jobs.set(motion.job, [...(jobs.get(motion.job) ?? []), motion]);
  for (const name of jobs.keys()) select.append(new Option(name, name));
  part("controls").hidden = motions.length === 0;
  part("jobs").hidden = jobs.size < 2;
  let row = [], total_s = 1, playing = 0, before = 0, moved = null;

  function show() {
    const time_s = Number(slider.value);
    let from_s = 0, k = 0;
    while (k < row.length - 1 && time_s > from_s + lasts(row[k])) { from_s += lasts(row[k]); k += 1; }
    const one = row[k];
    if (one !== moved) { moved = one; viewer.path(one.joints_rad); viewer.pan(one.pan); }
    viewer.at({...one, at_s: from_s}, time_s);
    label.textContent = `${time_s.toFixed(1)} of ${total_s.toFixed(1)} s`;
    document.documentElement.style.setProperty("--now", String(time_s / total_s));
  }
  function choose() {
    row = jobs.get(select.value);
    total_s = row.reduce((sum, one) => sum + lasts(one), 0);
    slider.max = String(total_s);
    slider.value = "0";
    show();
  }
  function step(now) {
    slider.value = String(Math.min(total_s, Number(slider.value) + (now - before) / 1000));
    before = now;
    show();
    if (Number(slider.value) >= total_s) halt();
    else playing = requestAnimationFrame(step);
  }
  function halt() {
    cancelAnimationFrame(playing);
    playing = 0;
    button.textContent = "Play";
  }
  viewer.cone(scene.usual_mm ?? scene.cones[0].mm);
  select.addEventListener("change", () => { halt(); choose(); });
  slider.addEventListener("input", () => { halt(); show(); });
  button.addEventListener("click", () => {
    if (playing) { halt(); return; }
    if (Number(slider.value) >= total_s) slider.value = "0";
    button.textContent = "Halt";
    before = performance.now();
    playing = requestAnimationFrame(step);
  });
  if (jobs.size) choose();
  else viewer.pose(scene.home);
  root.viewer = viewer;
}
