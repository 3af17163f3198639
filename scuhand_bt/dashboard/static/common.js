// What all pages of the dashboard share. Texts go into a page as text alone, and never as markup.

export const by = (id) => document.getElementById(id);

export const session = fetch("/api/session").then((answer) => answer.json());

export async function get(path) {
  const answer = await fetch(path);
  const told = await answer.json();
  if (!answer.ok) throw new Error(told.detail);
  return told;
}

export async function post(path, body) {
  const headers = {"Content-Type": "application/json", "X-Dashboard": (await session).word};
  const answer = await fetch(path, {method: "POST", headers, body: JSON.stringify(body)});
  const told = await answer.json();
  if (!answer.ok) throw new Error(typeof told.detail === "string" ? told.detail : "this request is not possible");
  return told;
}

export function make(name, attributes = {}, ...children) {
  const element = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
  element.append(...children);
  return element;
}

export function facts(list, pairs) {
  list.replaceChildren(...pairs.flatMap(([name, value]) => [make("dt", {}, name), make("dd", {}, value)]));
}

export function duration(seconds) {
  if (seconds === null || seconds === undefined) return "–";
  const s = Math.round(seconds), minutes = Math.floor(s / 60), hours = Math.floor(minutes / 60);
  if (hours) return `${hours} h ${String(minutes % 60).padStart(2, "0")} min`;
  return minutes ? `${minutes} min ${String(s % 60).padStart(2, "0")} s` : `${s} s`;
}

export const clock = (iso) => new Date(iso).toLocaleString([], {dateStyle: "medium", timeStyle: "short"});
