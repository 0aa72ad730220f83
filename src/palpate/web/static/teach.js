// Teaching: a name, so many touches, undo, learn.

import { post } from "./api.js";
import { find, make, show, text } from "./dom.js";

export function startTeach() {
  find("lesson").addEventListener("submit", begin);
  find("stop").addEventListener("click", () => post("teach/stop"));
  find("undo").addEventListener("click", () => post("teach/undo"));
  find("learn").addEventListener("click", () => post("learn"));
}

export function showTeach({ library, lesson, learning, learn_error: error, model, sensor }) {
  show(find("no-library"), library === null);
  show(find("teaching"), library !== null);
  text(find("learnt"), learning ? "learning…"
    : model ? `${model.objects.length} objects learnt` : "nothing learnt yet");
  find("learnt").className = model && !learning ? "pill on" : "pill";
  if (library === null) return;
  show(find("progress"), lesson !== null);
  show(find("stop"), lesson !== null);
  show(find("lesson"), sensor !== null);
  if (lesson) showLesson(lesson);
  const enough = library.objects.filter((one) => one.n_touches > 1).length > 1;
  find("undo").disabled = library.undoable === 0;
  find("learn").disabled = learning || (!enough && !model);
  find("learn").classList.toggle("primary", stale(library, model) && !learning);
  show(find("learn-error"), error !== "");
  text(find("learn-error"), error);
  showKnown(library.objects);
}

function showLesson({ name, wanted, done }) {
  text(find("progress-text"), `Touch ${name}: ${done} of ${wanted} are stored.`);
  find("bar").max = wanted;
  find("bar").value = done;
}

// Whether the library holds an object that the model does not know.
function stale(library, model) {
  const enough = library.objects.filter((one) => one.n_touches > 1);
  return enough.length > 1 && enough.some((one) => !model || !model.objects.includes(one.name));
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
  const order = { object: find("name").value, touches: Number(find("wanted").value) };
  if (await post("teach", order)) find("lesson").reset();
}
