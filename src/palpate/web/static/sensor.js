// The live image, the contact indicator, the baseline, frame rate and latency.

import { get, here, post, url } from "./api.js";
import { find, make, say, show, step, text } from "./dom.js";

const waiting = new Map();
let drawing = false;
let insist = false;
let refused_ms = 0;
const INSIST_MS = 30000; // so long after a refusal the baseline can be taken anyway
let known = false;
let readings = null;
const MOST = 32; // taxels a side whose numbers can be shown
const NUMBERS_MS = 200;
const UNITS = { "colour level": "in colour", "grey level": "in grey" };

export function startSensor() {
  find("baseline").addEventListener("click", takeBaseline);
  find("press-keep").addEventListener("click", () => post("baseline/keep"));
  find("press-undo").addEventListener("click", () => post("baseline/undo"));
  find("numbers").addEventListener("change", showNumbers);
  find("placed").addEventListener("change", async ({ target }) => {
    if (!await post("place", { object: target.value === "" ? null : target.value })) target.value = target.dataset.placed;
  });
}

// The newest picture of each sensor; `shown` is called with what is drawn of any.
export async function drawFrame(head, picture, shown) {
  if (head.sensor_number === here) touching(head.touching);
  waiting.set(head.sensor_number, [head, picture]);
  if (drawing) return;
  drawing = true;
  while (waiting.size) {
    const [[number, [about, next]]] = waiting;
    waiting.delete(number);
    try {
      const bitmap = await createImageBitmap(next);
      const array = about.type === "image/png";
      if (number === here) paint(bitmap, array);
      shown(about, bitmap, array);
      bitmap.close();
    } catch {
      // A picture that cannot be drawn is skipped; the next one is on its way.
    }
  }
  drawing = false;
}

export function showSensor(sensor) {
  show(find("sensor"), sensor !== null);
  show(find("step-1"), sensor !== null);
  if (!sensor) {
    text(find("sensor-name"), "no sensor: touches come through the API");
    return;
  }
  text(find("sensor-name"), `${sensor.name}, ${sensor.shape[0]} × ${sensor.shape[1]}, ${UNITS[sensor.unit] ?? sensor.unit}`);
  known = sensor.baseline;
  show(find("numbered"), Math.max(sensor.shape[0], sensor.shape[1]) <= MOST);
  if (sensor.lost) off("sensor lost");
  else touching(sensor.touching);
  note(find("lost"), sensor.lost);
  note(find("offer"), sensor.lost ? "" : sensor.offer);
  find("baseline").disabled = sensor.lost !== "";
  insist = sensor.offer !== "" && sensor.touching;
  if (Date.now() - refused_ms > INSIST_MS || (sensor.baseline && !sensor.touching)) refused_ms = 0;
  text(find("baseline"), insist || refused_ms ? "Take baseline anyway"
    : sensor.baseline ? "Take baseline" : "Nothing touches it: take baseline");
  showPress(sensor.press);
  step(1, sensor.press ? "try it" : sensor.baseline ? "taken" : "to be taken", sensor.baseline && !sensor.press);
  showWarnings(sensor.warnings);
  showDesk(sensor.desk);
}

export function showHealth(health) {
  text(find("rate"), health.rate_hz ? `${health.rate_hz.toFixed(0)} Hz` : "–");
  text(find("dropped"), String(health.n_dropped));
  text(find("latency"), health.belief_ms === null ? "–" : `${health.belief_ms.toFixed(0)} ms`);
}

export function draw(canvas, bitmap, array, cell = 1) {
  const [width, height] = [bitmap.width * cell, bitmap.height * cell];
  if (canvas.width !== width || canvas.height !== height) {
    canvas.width = width;
    canvas.height = height;
    canvas.classList.toggle("array", array);
  }
  const pen = canvas.getContext("2d");
  pen.imageSmoothingEnabled = false;
  pen.drawImage(bitmap, 0, 0, width, height);
  return pen;
}

function paint(bitmap, array) {
  const canvas = find("image");
  const cell = readings?.length === bitmap.height ? cellOf(readings) : 1;
  const pen = draw(canvas, bitmap, array, cell);
  document.body.classList.toggle("array", array);
  if (cell > 1) write(pen, cell);
  canvas.dataset.frames = String(Number(canvas.dataset.frames || 0) + 1);
}

const LINE = 13;
const lines = (taxel) => [taxel].flat().map((value) => value === null ? ""
  : Number.isInteger(value) ? String(value) : String(Number(Math.abs(value) < 1000 ? value.toPrecision(3) : Math.round(value))));

// How wide a taxel must be for its numbers, in pixels; all of the screen where there is room.
function cellOf(rows) {
  const written = rows.flat().map(lines);
  const longest = Math.max(...written.flat().map((words) => words.length));
  return Math.ceil(Math.max(7 * longest + 6, LINE * written[0].length + 6, find("screen").clientWidth / rows[0].length - 1));
}

function write(pen, cell) {
  Object.assign(pen, { font: `${LINE - 2}px ui-monospace, monospace`, textAlign: "center", textBaseline: "middle",
    lineWidth: 3, lineJoin: "round", strokeStyle: "#0b0e10", fillStyle: "#fff" });
  readings.forEach((row, y) => row.forEach((taxel, x) => {
    const words = lines(taxel);
    words.forEach((word, at) => {
      const place = [word, (x + 0.5) * cell, (y + 0.5) * cell + (at - (words.length - 1) / 2) * LINE];
      pen.strokeText(...place);
      pen.fillText(...place);
    });
  }));
}

// Numbers of the newest frame, a few times a second: more could not be read.
async function showNumbers() {
  const on = find("numbers").checked && !find("numbered").hidden;
  find("screen").classList.toggle("numbers", on);
  readings = on ? (await get("frame"))?.image ?? null : null;
  if (on) setTimeout(showNumbers, NUMBERS_MS);
}

function touching(whether) {
  const pill = find("contact");
  text(pill, whether ? "touching" : known ? "no contact" : "no baseline");
  pill.className = whether ? "pill on" : "pill";
  find("screen").classList.toggle("touching", whether);
}

export function showOffline() {
  off("no connection");
  text(find("rate"), "–");
}

function off(words) {
  touching(false);
  text(find("contact"), words);
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
  const placed = desk.placed ?? "";
  if (select.dataset.objects !== desk.objects.join("\n")) {
    delete select.dataset.placed;
    select.dataset.objects = desk.objects.join("\n");
    select.replaceChildren(
      make("option", { value: "" }, "nothing"),
      ...desk.objects.map((name) => make("option", { value: name }, name)));
  }
  if (select.dataset.placed === placed) return; // what is being chosen stays
  select.dataset.placed = select.value = placed;
}

function showPress(press) {
  show(find("press"), press !== null);
  if (!press) return;
  text(find("press-text"), !press.found
    ? "Now press the sensor once and let go. If it says “touching” while nothing does, something pressed it before: undo the baseline."
    : press.lower ? "The press reads lower than the baseline: something seems to have pressed the sensor when it was taken. Undo it."
      : "This is what changed. Does it look like your press?");
  const picture = find("press-picture");
  show(picture, press.found);
  if (!press.found) delete picture.dataset.number;
  if (press.found && picture.dataset.number !== String(press.number)) {
    picture.dataset.number = String(press.number);
    picture.src = url(`baseline/press?time_ms=${Date.now()}`);
  }
  show(find("press-keep"), press.found && !press.lower);
  text(find("press-undo"), press.found ? "No, undo it" : "Undo the baseline");
}

async function takeBaseline() {
  const done = await post("baseline", { force: insist || refused_ms > 0, ask_press: true });
  refused_ms = done === null ? Date.now() : 0;
  if (done) say(done.message);
  else text(find("baseline"), "Take baseline anyway");
}
