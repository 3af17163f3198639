// One run: as it goes on, told by the server, or as it was at the slider's time.

import {by, clock, duration, facts, get, make, post, session} from "./common.js";
import {draw} from "./chart.js";

const SIGNS = {done: "✓", failed: "✗", running: "▶", "to come": "·", skipped: "–"};
const HAS_ENDED = ["complete", "stopped", "fault", "interrupted", "altered", "unreadable"];
const id = decodeURIComponent(location.pathname.split("/").pop());
const api = `/api/runs/${encodeURIComponent(id)}`;

const samples = new Map();
let course = [], balance = null, view = null, last = {}, isLive = true, lastOfLive = null, ends_s = 0;

import("./arm.js").then((arm) => arm.show(by("scene"), by("scene-note"), id)).then((shown) => {
  view = shown;
  window.viewer = shown?.viewer;
  if (view && last.state) view.tell(last, !isLive);
}).catch(() => { by("scene-note").textContent = "This browser draws nothing in 3D."; });

function show(told) {
  if (told.run) about(told);
  for (const row of told.rows ?? []) sample(row);
  if (told.course) course = told.course_from === 0 ? told.course : course.concat(told.course);
  last = {...last, move: null, ...told};
  const state = [told.state, told.reason, told.soon].filter(Boolean).join(": ");
  by("state").textContent = isLive ? state : `Played again: ${state}`;
  by("job").textContent = told.job ? told.job.about : "No job yet";
  anew("tree", told.tree ?? [], tree);
  anew("chart", [course.length, course[course.length - 1], told.dose, told.reading], () => { figures(told); draw(by("chart"), course, told.dose); });
  weighed();
  anew("holds", told.holds ?? [], (holds) => facts(by("holds"), holds));
  if (isLive) question(told.question);
  for (const row of by("samples").rows) {
    if (told.job && row.dataset.id === told.job.name) row.setAttribute("aria-current", "true");
    else row.removeAttribute("aria-current");
  }
  forecast(told);
  const judged = [...samples.values()].filter((one) => one.tone && one.verdict !== "not run");
  const left = isLive && told.left_s ? `; about ${duration(told.left_s)} of run time left` : "";
  by("progress").textContent = `Samples: ${judged.length} of ${samples.size}${left}`;
  for (const button of document.querySelectorAll("#control button")) button.disabled = !isLive || HAS_ENDED.includes(told.state);
  if (view) view.tell(last, !isLive);
}

// What has not changed is not made anew: who reads it, or has selected it, is not disturbed.
const shownLast = new Map();
function anew(name, values, make) {
  const key = JSON.stringify(values);
  if (shownLast.get(name) === key) return;
  shownLast.set(name, key);
  make(values);
}

function about(told) {
  const run = told.run;
  samples.clear();
  by("samples").replaceChildren();
  by("banner").className = `banner ${run.banner}`;
  by("banner").replaceChildren(`${run.banner}: `, make("span", {}, run.meaning));
  by("recipe").textContent = run.recipe;
  by("name").textContent = run.id;
  document.title = `${run.banner}: ${run.recipe}`;
  facts(by("about"), run.about.map(([name, value]) => [name, name === "started" ? clock(value) : value]));
}

function sample(row) {
  const before = samples.get(row.id);
  const now = {...before, ...row};
  samples.set(row.id, now);
  const cells = [now.id, now.what ?? "", make("span", {class: now.tone}, now.verdict), now.told].map((cell) => make("td", {}, cell ?? ""));
  const line = make("tr", {"data-id": now.id}, ...cells);
  now.line = line;
  if (before) before.line.replaceWith(line);
  else by("samples").append(line);
}

let forecastAt = 0;
function forecast({pace, time_s, state}) {  // of every sample, when it will be done; seldom, as there may be thousands
  if (!pace || !isLive || performance.now() - forecastAt < 1000) return;
  forecastAt = performance.now();
  for (const one of samples.values()) {
    if (one.tone || !one.done_s || one.told) continue;
    const left_s = Math.max(0, pace.at_s + pace.stretch * (one.done_s - pace.planned_s) - time_s);
    const text = HAS_ENDED.includes(state) ? "" : one.verdict === "under way" ? `about ${duration(left_s)} left` : `in about ${duration(left_s)}`;
    const cell = one.line.cells[3];
    if (cell.textContent !== text) cell.textContent = text;
  }
}

function tree(nodes) {
  by("tree").replaceChildren(...nodes.map((node) => {
    const why = node.why ? `: ${node.why}` : "";
    const line = make("li", {class: node.state.replace(" ", "-")}, `${SIGNS[node.state]} ${node.name}${why}`);
    line.style.paddingInlineStart = `${14 * node.depth}px`;
    line.setAttribute("aria-label", `${node.name}, ${node.state}${why}`);
    return line;
  }));
}

function figures(told) {
  const point = course.length ? course[course.length - 1] : null;
  const set = (name, text) => { by(name).textContent = text; };
  set("net", point ? `${point[1].toFixed(1)} mg` : "–");
  set("estimate", point ? `${point[5].toFixed(1)} mg` : "–");
  set("target", told.dose ? told.dose.words : "–");
  set("opening", point ? `${point[2].toFixed(2)} mm` : "–");
  set("vibration", point ? `${Math.round(100 * point[3])} %` : "–");
}

function weighed() {  // what it shows now, or what was written down of it
  const [, gross_mg, is_stable] = (isLive && balance) || last.reading || [];
  by("reading").textContent = gross_mg === undefined ? "–" : `${(gross_mg / 1000).toFixed(4)} g, ${is_stable ? "stable" : "moving"}`;
}

let shownQuestion = "";
function question(asked) {
  const key = asked ? `${asked.number} ${asked.since}` : "";
  if (key === shownQuestion) return;
  shownQuestion = key;
  by("question").hidden = !asked;
  if (!asked) return;
  by("asked").textContent = `${asked.text} (since ${clock(asked.since)})`;
  by("answers").replaceChildren(...asked.choices.map((choice) => {
    const button = make("button", {type: "button"}, choice.answer);
    button.addEventListener("click", () => ask(`${api}/answer`, {number: asked.number, answer: choice.answer}));
    session.then((own) => { button.disabled = !own.may_control || asked.number === null; });
    return make("li", {}, button, make("span", {}, choice.meaning));
  }));
}

async function ask(path, body) {
  const name = by("who").value.trim(), pin = by("pin").value;
  try {
    await post(path, {...body, name: name || null, pin: pin || null});
    by("said").textContent = "The run has received it.";
  } catch (error) {
    by("said").textContent = `Not done: ${error.message}.`;
  }
  by("pin").value = "";
}

for (const button of document.querySelectorAll("[data-wish]")) {
  button.addEventListener("click", () => {
    const wish = button.dataset.wish;
    if (wish === "stop_now" && !confirm("Stop the run now? Running actions are halted.")) return;
    ask(`${api}/wish`, {wish});
  });
}
by("control").addEventListener("submit", (event) => event.preventDefault());
session.then((own) => {
  by("control").hidden = !own.may_control;
  by("who").placeholder = own.user;
});

// --- time

const slider = by("slider");
let wanted = null, isAsking = false, playing = null;

function tick(time_s) {
  if (time_s > ends_s) ends_s = time_s;
  slider.max = String(ends_s);
  if (isLive) slider.value = slider.max;
  by("clock").textContent = `${duration(isLive ? time_s : Number(slider.value))} of ${duration(ends_s)}`;
}

async function replay() {
  if (isAsking) return;
  isAsking = true;
  while (wanted !== null) {
    const time_s = wanted;
    wanted = null;
    try {
      const told = await get(`${api}?time_s=${time_s}`);
      if (isLive) break;
      course = [];
      ends_s = told.ends_s;
      told.time_s = time_s;
      last = {};
      show(told);
      tick(time_s);
      window.shownAt = time_s;
    } catch (error) {
      by("said").textContent = error.message;
    }
  }
  isAsking = false;
}

function goTo(time_s) {
  isLive = false;
  by("question").hidden = true;
  shownQuestion = "";
  slider.value = String(time_s);
  wanted = Number(slider.value);
  replay();
}

function stopPlaying() {
  clearInterval(playing);
  playing = null;
  by("play").setAttribute("aria-pressed", "false");
  by("play").textContent = "Play";
}

slider.addEventListener("input", () => { stopPlaying(); goTo(Number(slider.value)); });
by("play").addEventListener("click", () => {
  if (playing !== null) { stopPlaying(); return; }
  let time_s = isLive || Number(slider.value) >= ends_s ? 0 : Number(slider.value), before = performance.now();
  by("play").setAttribute("aria-pressed", "true");
  by("play").textContent = "Halt";
  playing = setInterval(() => {
    const now = performance.now();
    time_s += (now - before) / 1000 * Number(by("speed").value);
    before = now;
    if (time_s >= ends_s) { time_s = ends_s; stopPlaying(); }
    goTo(time_s);
  }, 200);
});
by("live").addEventListener("click", () => {
  stopPlaying();
  isLive = true;
  wanted = null;
  follow();
});

let events = null;
function follow() {
  if (events) events.close();
  events = new EventSource(`${api}/news`);
  events.addEventListener("message", (event) => {
    const told = JSON.parse(event.data);
    if (isLive) { if (told.run) { last = {}; course = []; } show(told); }
    tick(told.time_s ?? 0);
  });
  events.addEventListener("balance", (event) => { balance = JSON.parse(event.data); weighed(); });
  events.addEventListener("error", () => {
    by("said").textContent = HAS_ENDED.includes(last.state)
      ? "The dashboard has ended; `scuhand-bt serve` shows the run again."
      : "The dashboard does not answer: what is shown is old. The run goes on without it.";
  });
}
follow();
