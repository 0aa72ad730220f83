// The live image, the contact indicator, the baseline, frame rate and latency.

import { post } from "./api.js";
import { find, make, say, show, text } from "./dom.js";

let drawing = false;
let waiting = null;
let insist = false;

export function startSensor() {
  find("baseline").addEventListener("click", takeBaseline);
  find("placed").addEventListener("change", ({ target }) =>
    post("place", { object: target.value === "" ? null : target.value }));
}

export async function drawFrame(head, picture) {
  touching(head.touching);
  waiting = picture;
  if (drawing) return;
  drawing = true;
  while (waiting) {
    const next = waiting;
    waiting = null;
    try {
      const bitmap = await createImageBitmap(next);
      paint(bitmap, head.type === "image/png");
      bitmap.close();
    } catch {
      // A picture that cannot be drawn is skipped; the next one is on its way.
    }
  }
  drawing = false;
}

export function showSensor(sensor) {
  show(find("sensor"), sensor !== null);
  if (!sensor) {
    text(find("sensor-name"), "no sensor: touches come through the API");
    return;
  }
  text(find("sensor-name"), `${sensor.name}, ${sensor.shape[0]} × ${sensor.shape[1]}, ${sensor.unit}`);
  if (sensor.lost) lost();
  else touching(sensor.touching);
  note(find("lost"), sensor.lost);
  note(find("offer"), sensor.offer);
  insist = sensor.offer !== "" && sensor.touching;
  text(find("baseline"), insist ? "Take baseline anyway" : "Take baseline");
  showWarnings(sensor.warnings);
  showDesk(sensor.desk);
}

export function showHealth(health) {
  text(find("rate"), health.rate_hz ? `${health.rate_hz.toFixed(0)} Hz` : "–");
  text(find("dropped"), String(health.n_dropped));
  text(find("latency"), health.belief_ms === null ? "–" : `${health.belief_ms.toFixed(0)} ms`);
}

function paint(bitmap, array) {
  const canvas = find("image");
  if (canvas.width !== bitmap.width || canvas.height !== bitmap.height) {
    canvas.width = bitmap.width;
    canvas.height = bitmap.height;
    canvas.classList.toggle("array", array);
    document.body.classList.toggle("array", array);
  }
  canvas.getContext("2d").drawImage(bitmap, 0, 0);
  canvas.dataset.frames = String(Number(canvas.dataset.frames || 0) + 1);
}

function touching(whether) {
  const pill = find("contact");
  text(pill, whether ? "touching" : "no contact");
  pill.className = whether ? "pill on" : "pill";
  find("screen").classList.toggle("touching", whether);
}

function lost() {
  text(find("contact"), "sensor lost");
  find("contact").className = "pill off";
}

function note(element, words) {
  show(element, words !== "");
  text(element, words);
}

function showWarnings(warnings) {
  const list = find("warnings");
  show(list, warnings.length > 0);
  if (list.dataset.shown === warnings.join()) return;
  list.dataset.shown = warnings.join();
  list.replaceChildren(...warnings.map((warning) => make("li", {}, warning)));
}

function showDesk(desk) {
  show(find("desk"), desk !== null);
  if (!desk) return;
  const select = find("placed");
  if (select.dataset.objects !== desk.objects.join("\n")) {
    select.dataset.objects = desk.objects.join("\n");
    select.replaceChildren(
      make("option", { value: "" }, "nothing"),
      ...desk.objects.map((name) => make("option", { value: name }, name)));
  }
  if (document.activeElement !== select) select.value = desk.placed ?? "";
}

async function takeBaseline() {
  const done = await post("baseline", { force: insist });
  if (done) say(done.message);
}
