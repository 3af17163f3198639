// The list of runs, told anew every few seconds.

import {by, clock, get, make} from "./common.js";

async function show() {
  try {
    const runs = await get("/api/runs");
    by("runs").replaceChildren(...runs.map((run) => make("tr", {},
      make("td", {}, make("a", {href: `/runs/${encodeURIComponent(run.id)}`}, run.id), ` ${run.mode}`),
      make("td", {}, run.reason ? `${run.state}: ${run.reason}` : run.state),
      make("td", {}, run.total === null ? String(run.good) : `${run.good} of ${run.total}`),
      make("td", {class: "wide-only"}, run.started ? clock(run.started) : ""))));
    by("said").textContent = runs.length ? "" : "There is no run yet: `scuhand-bt run RECIPE --dry-run` makes one.";
  } catch (error) {
    by("said").textContent = `The dashboard does not answer: ${error.message}`;
  }
}

show();
setInterval(show, 3000);
