// The API: the same one that robots use.

import { find, say } from "./dom.js";

// Which of several sensors the page is about; what a hand does, all of them do.
export const here = Math.max(1, parseInt(new URLSearchParams(location.search).get("sensor"), 10) || 1);
export const OF_ALL = { count: 1, paths: ["teach", "teach/stop", "teach/resume", "learn", "place", "episode/start", "episode/end"], desks: new Map(), interrupted: new Set() };

export const url = (path, number = here) =>
  `/api/${path}${number > 1 ? `${path.includes("?") ? "&" : "?"}sensor=${number}` : ""}`;

const underWay = new Set();

// What is pressed again before it is answered, as on a slow network, is one order.
export async function post(path, body) {
  const order = JSON.stringify([path, body]);
  if (underWay.has(order)) return null;
  underWay.add(order);
  try {
    return await postToAll(path, body);
  } finally {
    underWay.delete(order);
  }
}

async function postToAll(path, body) {
  const all = OF_ALL.paths.includes(path) && find("as-one").checked;
  for (let number = 1; all && number <= OF_ALL.count; number += 1) {
    if (number !== here && takes(number, path, body)) await postTo(url(path, number), body);
  }
  return postTo(url(path), body);
}

// Whether something can be put before a sensor, or a lesson of it can go on: others have
// desks and lessons of their own.
const takes = (number, path, body) => {
  if (path === "teach/resume") return OF_ALL.interrupted.has(number);
  const desk = OF_ALL.desks.get(number);
  return path !== "place" || Boolean(desk && (body.object === null || desk.objects.includes(body.object)));
};

async function postTo(address, body) {
  const order = { method: "POST", headers: {} };
  if (body !== undefined) {
    order.headers["Content-Type"] = "application/json";
    order.body = JSON.stringify(body);
  }
  return answered(() => fetch(address, order));
}

export const get = (path) => answered(() => fetch(url(path)));

async function answered(ask) {
  let answer;
  try {
    answer = await ask();
  } catch {
    say("The server does not answer.");
    return null;
  }
  // Null too where the answer was cut off, as when the page is left meanwhile.
  const body = await answer.json().catch(() => null);
  if (answer.ok) return body;
  say(worded(body?.detail) || `Refused (${answer.status}).`);
  return null;
}

function worded(detail) {
  // What programs are told beside: here a button says it.
  if (typeof detail === "string") return detail.replace("take it anyway (force)", "press “Take baseline anyway”");
  return Array.isArray(detail) ? detail.map((one) => one.msg).join("; ") : "";
}
