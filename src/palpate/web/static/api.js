// The API: the same one that robots use.

import { say } from "./dom.js";

export async function post(path, body) {
  const order = { method: "POST", headers: {} };
  if (body !== undefined) {
    order.headers["Content-Type"] = "application/json";
    order.body = JSON.stringify(body);
  }
  return answered(() => fetch(`/api/${path}`, order));
}

export const get = (path) => answered(() => fetch(`/api/${path}`));

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
  if (typeof detail === "string") return detail;
  return Array.isArray(detail) ? detail.map((one) => one.msg).join("; ") : "";
}
