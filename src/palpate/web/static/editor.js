// One touch, large: look at it, remove it, or move it to another object.

import { get, post, url } from "./api.js";
import { find, say, show, text } from "./dom.js";

const SIDE = 480;
const MOST = 200;
let touches = [];
let at = 0;
let object = "";
let after = null;

export function startEditor() {
  find("editor-close").addEventListener("click", () => find("editor").close());
  find("editor-name").addEventListener("input", allowMove);
  find("editor-newer").addEventListener("click", () => turn(-1));
  find("editor-older").addEventListener("click", () => turn(1));
  find("editor-remove").addEventListener("click", () => change("touches/remove", {}));
  find("editor-move").addEventListener("submit", (event) => {
    event.preventDefault();
    change("touches/move", { object: find("editor-name").value });
  });
  find("editor").addEventListener("close", () => {
    find("bar-top").append(find("status"));
    // The picture that was pressed has the focus again, unless it is gone.
    const focused = document.activeElement;
    if (focused === document.body || find("editor").contains(focused)) (after ?? find("objects-title")).focus();
  });
}

// A stored touch; `home` has the focus afterwards where the picture that was pressed is gone.
export async function openStored(id, name, home = null) {
  const stored = await get(`objects/touches?object=${encodeURIComponent(name)}&limit=${MOST}`);
  if (!stored) return;
  touches = stored.some((one) => one.id === id) ? stored : [{ id, session: "", added_s: null }];
  at = touches.findIndex((one) => one.id === id);
  object = name;
  after = home;
  find("editor-name").value = "";
  draw();
  find("editor").showModal();
}

// A touch of the episode, which is not stored: to be looked at.
export function openPicture(src, title) {
  touches = [];
  after = find("belief");
  text(find("editor-title"), title);
  find("editor-picture").src = src;
  find("editor-picture").alt = title;
  text(find("editor-about"), "");
  for (const part of ["editor-turn", "editor-move"]) show(find(part), false);
  find("editor").showModal();
}

// Without a name there is nowhere to move it.
function allowMove() {
  find("editor-there").disabled = find("editor-name").value.trim() === "";
}

function draw() {
  allowMove();
  const { id, session, added_s: added } = touches[at];
  for (const part of ["editor-turn", "editor-move"]) show(find(part), true);
  text(find("editor-title"), `A touch of ${object}`);
  find("editor-picture").src = url(`touches/${id}/picture?side=${SIDE}`);
  find("editor-picture").alt = `A touch of ${object}`;
  const when = added === null ? "" : `stored ${dated(new Date(1000 * added))}`;
  const place = touches.length > 1 ? `${at + 1} of ${touches.length}, newest first` : "";
  text(find("editor-about"), [place, when, session && `session ${session}`].filter(Boolean).join("; "));
  find("editor-newer").disabled = at === 0;
  find("editor-older").disabled = at === touches.length - 1;
}

// As sessions are called: 2026-01-31 09:05:00, in the time of this place.
function dated(day) {
  const two = (number) => String(number).padStart(2, "0");
  const date = [day.getFullYear(), two(day.getMonth() + 1), two(day.getDate())].join("-");
  return `${date} ${[day.getHours(), day.getMinutes(), day.getSeconds()].map(two).join(":")}`;
}

function turn(step) {
  at += step;
  draw();
}

async function change(path, order) {
  const done = await post(path, { ids: [touches[at].id], ...order });
  if (!done) return;
  say(`${done.message} Undo takes it back.`);
  touches.splice(at, 1);
  find("editor-name").value = "";
  if (!touches.length) {
    find("editor").close();
    return;
  }
  at = Math.min(at, touches.length - 1);
  draw();
  find("editor-title").focus();
}
