// The arm of a run in 3D: as its last motion goes, or as it was at the slider's time.

import {get} from "./common.js";

export async function show(holder, note, id) {
  let scene;
  try {
    scene = await get(`/api/runs/${encodeURIComponent(id)}/scene`);
  } catch (error) {
    note.textContent = `Not drawn: ${error.message}`;
    return null;
  }
  note.textContent = scene.note;
  const {view, lasts} = await import("/static/viewer/viewer.js");
  const viewer = view(holder, scene, "The arm, the cone and what stands in the cell");
  let told = null, move = null, is_replay = false, received = 0, frame = 0;
  viewer.cone(scene.usual_mm);

  const speed = () => told.run?.speed === null ? Infinity : told.run?.speed ?? 1;
  function step() {
    frame = 0;
    const passed = is_replay ? 0 : (performance.now() - received) / 1000 * speed();
    const time_s = told.time_s + (Number.isNaN(passed) ? 0 : passed);
    if (move) viewer.at(move, time_s);
    if (told.joints_rad && !(move?.at_s >= told.rest_s)) { viewer.pose(told.joints_rad); return; }
    if (!is_replay && time_s < move.at_s + lasts(move) && told.state === "running") frame = requestAnimationFrame(step);
  }
  return {
    viewer,
    tell(now, replays) {
      is_replay = replays;
      if (now.move) {
        move = now.move;
        viewer.path(move.joints_rad);
      } else if (replays) {
        move = null;
      }
      if (!told || told.time_s !== now.time_s) received = performance.now();
      told = {...now, run: now.run ?? told?.run};
      viewer.pan(now.pan);
      if (!frame) step();
    },
  };
}
