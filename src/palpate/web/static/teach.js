// Teaching: a name, so many touches, undo, learn.

import { OF_ALL, post, url } from "./api.js";
import { chosen, drawn, find, make, pictures, show, step, text, unbroken } from "./dom.js";
import { openStored } from "./editor.js";
import { canPlace, mixed } from "./sensors.js";
import { learnable } from "./steps.js";

let keeping = 0;

export function startTeach() {
  find("lesson").addEventListener("submit", begin);
  find("stop").addEventListener("click", () => post("teach/stop"));
  find("leave").addEventListener("click", () => post("teach/stop"));
  find("resume").addEventListener("click", () => post("teach/resume"));
  find("undo").addEventListener("click", () => post("teach/undo"));
  find("learn").addEventListener("click", () => post("learn"));
  find("wanted").addEventListener("input", sayKept);
  find("name").addEventListener("input", ({ target }) => target.setCustomValidity(""));
}

// The touches just made become the first of the object that is named next, or of `name`.
export function teachThese(count, name = "") {
  keep(count);
  if (count) find("name").focus();
  if (name === "") return;
  find("name").value = name;
  find("name").setCustomValidity("");
  find("lesson").requestSubmit(find("start"));
}

// They are of one episode: more as it goes on, none once it is over.
export function keepOf(count) {
  if (keeping && keeping !== count) keep(count);
}

function keep(count) {
  keeping = count;
  show(find("first-touches"), count > 0);
  sayKept();
}

function sayKept() {
  const kept = Math.min(keeping, Number(find("wanted").value) || keeping);
  const which = kept < keeping ? `the last ${kept} of the ${keeping}` : kept === 1 ? "the one" : `the ${kept}`;
  text(find("first-touches"), `Its first touches are ${which} you just made. Say what it is.`);
}

export function showTeach({ library, lesson, learning, learn_error: error, model, sensor, advice, unlearnt }) {
  const focused = document.activeElement;
  const [began, stopped] = [lesson && find("lesson").contains(focused), !lesson && focused === find("stop")];
  const answered = ["resume", "leave"].includes(focused.id);
  show(find("no-library"), library === null);
  show(find("teaching"), library !== null);
  text(find("learnt"), learning ? "learning…"
    : model ? `${model.objects.length} objects learnt` : "nothing learnt yet");
  find("learnt").className = model && !learning ? "pill on" : "pill";
  const interrupted = lesson === null ? library?.interrupted ?? null : null;
  show(find("resume"), interrupted !== null);
  show(find("learn"), library !== null && lesson === null && interrupted === null);
  show(find("stop"), lesson !== null);
  show(find("progress"), lesson !== null);
  show(find("why-not"), lesson === null);
  document.body.dataset.lesson = String(lesson !== null);
  const shown = lesson ?? interrupted;
  step(2, shown ? `${shown.name}: ${shown.done} of ${shown.wanted}` : learning ? "learning…"
    : unlearnt ? "learn again" : model ? `${model.objects.length} learnt` : "", model !== null && !shown);
  if (library === null) return;
  showInterrupted(library.interrupted);
  show(find("lesson"), sensor !== null && lesson === null);
  if (lesson) showLesson(lesson);
  showButtons(library, model, learning, sensor, error);
  show(find("given"), Boolean(model?.to_keep) && !lesson);
  text(find("given"), model?.to_keep ? `Learn adds what is taught here to what ${model.file} knows, and writes that file anew. As it is now it stays as ${model.to_keep}.` : "");
  show(find("learn-error"), error !== "");
  text(find("learn-error"), error);
  show(find("advice"), advice.length > 0 && !lesson && !learning);
  find("advice").lastElementChild.replaceChildren(...advice.map((one) => make("li", {}, unbroken(one))));
  showKnown(library.objects);
  // A button that goes must not take the focus with it.
  if (began || (answered && lesson)) find("stop").focus();
  else if (stopped || answered) (find("learn").disabled ? find("teach-title") : find("learn")).focus();
}

function showInterrupted(lesson) {
  show(find("interrupted"), lesson !== null);
  if (lesson === null) return;
  const { name, done, wanted } = lesson;
  text(find("interrupted").querySelector("p"), `A lesson was interrupted, ${name}: ${done} of ${wanted}. What was stored is kept.`);
}

const WORDS = {
  taught: ({ object }) => `Undo touch of ${object}`,
  removed: ({ object }) => `Undo removal from ${object}`,
  moved: ({ to }) => `Undo move to ${to}`,
  forgotten: ({ object }) => `Undo forgetting ${object}`,
};

// Each button that cannot be pressed has its reason beside it.
function showButtons(library, model, learning, sensor, error) {
  const enough = learnable(library, model);
  const why = sensor ? [] : ["Start: there is no sensor here. Post touches to /api/teach/touch, or start palpate serve again with --sensor."];
  find("start").disabled = sensor !== null && (!sensor.baseline || sensor.lost !== "");
  if (find("start").disabled) why.push(`Start: ${sensor.lost ? "the sensor gives no frames" : "take the baseline first"}.`);
  find("undo").disabled = library.undo === null;
  text(find("undo"), library.undo === null ? "Undo" : WORDS[library.undo.kind](library.undo));
  find("undo").title = find("undo").textContent;
  if (find("undo").disabled) why.push("Undo: nothing was taught here.");
  find("learn").disabled = learning || (!enough && !model);
  if (learning) why.push("Learn: it is learning.");
  else if (find("learn").disabled && error === "") {
    const one = library.objects.length === 1 && library.objects[0].n_touches > 1;
    why.push(one ? "Teach a second object: name it and press Start. Then comes Learn." : "Learn: two objects need two touches each.");
  }
  text(find("why-not"), why.join(" "));
}

function showLesson({ name, wanted, done, stored, newest, no_contact: silent, map, n_new: differ, prompt }) {
  text(find("progress-text"), `Touch ${name}: ${done} of ${wanted} are stored.` + (silent.length ? ` ${silent.length} more without contact.` : ""));
  find("bar").max = wanted;
  find("bar").value = done;
  show(find("elsewhere"), prompt !== "");
  text(find("elsewhere"), prompt);
  showVariety(map, stored, differ);
  const list = find("lesson-strip");
  const now = `${name} ${newest} ${silent}`;
  if (list.dataset.shown === now) return;
  list.dataset.shown = now;
  const like = new Map(map.map((one) => [one.number, one.like ? `${one.number} ≈ ${one.like}` : String(one.number)]));
  const first = stored - newest.length + 1;
  const about = (number) => silent.includes(number) ? `${number} no contact` : like.get(number);
  pictures(list, newest.map((id, at) => ({ key: id, alt: `Touch ${first + at} of ${name}`,
    label: about(first + at), src: url(`touches/${id}/picture`), open: () => openStored(id, name, find("stop")) })));
}

// A dot for each touch that differs from those before it, with how many are like it.
function showVariety(map, done, differ) {
  const [chart, caption] = find("variety").children;
  show(find("variety"), map.length > 1);
  text(caption, `${differ} of ${done} touches differ. Each dot is one of these, with how often it came; near dots resemble each other.`);
  const dots = map.filter((one) => one.like === null)
    .map(({ number, x, y }) => [1 + map.filter(({ like }) => like === number).length, x, y]).sort(([a], [b]) => b - a);
  chart.replaceChildren(...dots.map(([count, cx, cy]) => drawn("circle", { cx, cy, r: 0.09 * Math.sqrt(count) })),
    ...dots.filter(([count]) => count > 1).map(([count, x, y]) => drawn("text", { x, y }, String(count))));
}

function showKnown(objects) {
  const names = objects.map((one) => one.name).join("\n");
  const list = find("known");
  if (list.dataset.names === names) return;
  list.dataset.names = names;
  list.replaceChildren(...objects.map((one) => make("option", { value: one.name })));
}

async function begin(event) {
  event.preventDefault();
  const order = { object: find("name").value, touches: Number(find("wanted").value), keep_episode: keeping > 0 };
  const different = mixed();
  if (different) {
    const words = `Before the sensor${OF_ALL.count > 1 ? "s lie" : " lies"} ${different}. All touches would be stored as ${order.object}.`;
    const first = canPlace(order.object.trim()) ? `Put ${order.object.trim()} there and start` : "";
    const answer = await chosen("Different things?", words, "Teach all the same", "Cancel", first);
    if (!answer || (answer === "first" && !await post("place", { object: order.object.trim() }))) return;
  }
  const accepted = await post("teach", order);
  // An answer that comes late is not about the name that is typed by then.
  const same = find("name").value === order.object;
  if (!accepted) {
    const refused = find("status").textContent;
    if (!same) return;
    find("name").setCustomValidity(refused.startsWith("The name") ? refused : "");
    find("name").reportValidity();
    return;
  }
  if (same) find("name").value = "";  // how many touches are wanted stays as it was typed
  teachThese(0);
  find("stop").focus();
  find("teach").scrollIntoView({ block: "nearest" });
}
